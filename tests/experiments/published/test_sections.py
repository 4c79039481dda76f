import re

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from experiments.published import ambient, layout, repeats, single_pixels, stills
from experiments.published.__main__ import main
from experiments.report import Verdict
from tests.scenes.published import LIT, NOISE, PAINT, SBRS

pytestmark = pytest.mark.thorough  # to render the stand-in takes 20 s


def table(section, start):
    (found,) = (table for table in section.tables if table.caption.startswith(start))
    return [dict(zip(found.header, row, strict=True)) for row in found.rows]


def first_number(text):
    return float(re.match(r"-?[\d.]+", text)[0])


def test_the_placement_that_was_rendered_is_found(every_placement):
    for place in (layout.CHAIR, layout.AMBIENT):
        first, *others = every_placement.tried(place)
        assert first.placement is layout.PLACEMENTS[place][0]
        assert all(other.unexplained > 1.1 * first.unexplained for other in others)


def test_stills_are_recovered_and_lie_as_stored(setting, monkeypatch):
    fewer = {**layout.STILLS, layout.PLATE: layout.STILLS[layout.PLATE][:3]}
    monkeypatch.setattr(stills, "STILLS", fewer)
    section = stills.run(setting)
    assert section.claims[0].verdict is Verdict.AGREES
    for folder, names in fewer.items():
        rows = table(section, f"{folder}: unexplained")
        assert len(rows) == len(names) - (folder == layout.PLATE)
        assert all(first_number(row[stills.OURS]) > 20 for row in rows)
    assert all(picture.file.is_file() for picture in section.pictures)


def test_noise_in_time_is_that_of_the_repeats(setting):
    """Of 4 repeats at exposures of 20 to 30: its estimate has 1764 x 3 x 3 degrees of freedom."""
    section = repeats.run(setting)
    assert len(section.claims) == 2
    for claim in section.claims:
        folder = claim.what.partition("(")[2].rstrip(")")
        taken = setting.readable(folder, layout.REPEATS[folder])
        assert len(taken) == 4
        levels = np.array([capture.photograph.mean() for capture in taken])
        noise = np.array([NOISE**2 * 20 / capture.exposure for capture in taken]).mean()
        energy = np.mean([(c.photograph**2).mean() for c in taken]) / levels.mean() ** 2
        expected = 10 * np.log10(energy / (noise * (1 + 0.5 + 1) / 3))
        assert first_number(claim.measured) == pytest.approx(expected, abs=0.3)
    for row in table(section, "Drift"):
        if row["over reported"]:
            assert 0.05 < float(row["over reported"]) < 1.2


def test_real_ambient_light_is_measured_and_cancelled(setting, monkeypatch):
    dark = {layout.AMBIENT: layout.WITHOUT_AMBIENT[layout.AMBIENT]}
    monkeypatch.setattr(ambient, "WITHOUT_AMBIENT", dark)
    section = ambient.run(setting)
    light = table(section, f"{layout.AMBIENT}: ambient light alone")
    paint = 100 * PAINT
    for row in light:  # what lies outside is the paint, and alike in all
        assert float(row["outside range(B), %"]) == pytest.approx(paint, rel=0.15)
        assert all(float(text) > 0.85 for text in row["alike with the others"].split())
    levels = table(section, f"{layout.AMBIENT}: signal-to-background")
    for row, sbr in zip(levels[1:], SBRS, strict=True):
        assert float(row["SBR"]) == pytest.approx(sbr, abs=0.011)
        assert float(row["SBR by the dark room's"]) == pytest.approx(sbr, abs=0.011)
        assert float(row["left over noise"]) == pytest.approx(1, abs=0.1)
        for factor in row["factors"].split(", "):
            assert float(factor) == pytest.approx(1, abs=0.01)
    images = table(section, f"{layout.AMBIENT}: PSNR")
    lowest, brightest = images[-1], images[0]
    # A background photograph shows the paint, also to a photograph without ambient light.
    assert first_number(brightest[ambient.OURS_WITH]) > first_number(brightest[ambient.OURS]) + 1
    assert first_number(lowest[ambient.OURS_WITH]) > first_number(lowest[ambient.OURS]) + 1
    assert first_number(lowest[ambient.NATURE]) < first_number(brightest[ambient.NATURE]) - 3
    assert {claim.verdict for claim in section.claims} <= set(Verdict)
    assert len(section.claims) == 3 and section.claims[1].verdict is Verdict.AGREES


def test_a_lit_block_is_its_column_of_the_transport_matrix(setting):
    section = single_pixels.run(setting)
    rows = table(section, "Patches are")
    assert len(rows) == 4
    for row in rows:
        row_, column = LIT[row["capture"].replace(" ", "_")]
        assert row["lit patch"] == f"{row_}.0, {column}.0"
        assert row["most like"] == f"{row_}, {column}"
        assert row["down, right of it"] == "+0.0, +0.0"
        assert float(row["correlation"]) > 0.97
        assert all(
            float(gain) == pytest.approx(1, abs=0.05) for gain in row["gain over mean"].split()
        )
    laws = table(section, "Laws")
    spreads = [float(row["its spread"]) for row in laws]
    assert spreads[0] == min(spreads) and spreads[2] > 5 * spreads[0]


def run(*arguments):
    app = Typer()
    app.command()(main)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.mark.parametrize(
    ("change", "offender"),
    [
        ({"--data": "nowhere"}, "nowhere"),
        ({"--only": "fig4"}, "fig4"),
        ({"--scene": "chair"}, "chair"),
        ({"--scene": "Desk=chair"}, "Desk"),
        ({"--scene": f"{layout.CHAIR}=nowhere.xml"}, "nowhere.xml"),
    ],
)
def test_what_a_user_can_fix_is_said_in_one_line(tmp_path, data, change, offender):
    options = {"--data": data.root, "--out": tmp_path / "out", "--only": "captures", **change}
    result = run(*(word for pair in options.items() for word in pair))
    assert result.exit_code == 2
    assert offender in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
