import re

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from experiments.published import ambient, recovered, repeats, single_pixels, stills, video
from experiments.published.__main__ import main
from experiments.published.setting import AMBIENT, CHAIR, PLATE, REPEATS, VIDEOS, PublishedSetting
from experiments.report import Verdict
from tests.scenes.published import LIT, NOISE, PAINT, SBRS

pytestmark = pytest.mark.thorough  # to render the stand-in takes 20 s


def table(section, start):
    (found,) = (table for table in section.tables if table.caption.startswith(start))
    return [dict(zip(found.header, row, strict=True)) for row in found.rows]


def first_number(text):
    return float(re.match(r"-?[\d.]+", text)[0])


def test_stills_are_recovered_and_a_damaged_one_is_named(setting, monkeypatch):
    fewer = {**stills.STILLS, PLATE: ("*_mushroom", "*_bur")}
    monkeypatch.setattr(stills, "STILLS", fewer)
    section = stills.run(setting)
    for name, count in ((CHAIR, 5), (AMBIENT, 1), (PLATE, 1)):
        rows = table(section, f"{name}: PSNR")
        assert len(rows) == count
        assert all(first_number(row[recovered.OURS]) > 20 for row in rows)
    (damaged,) = table(section, "Not read")
    assert damaged["captures"] == "TestPosD11/image_test_bur.mat"
    assert all(picture.file.is_file() for picture in section.pictures)


def test_a_set_may_have_a_scene_of_yours(data, tmp_path):
    fitted = PublishedSetting(tmp_path, data.root, {PLATE: "chair"}).scene(PLATE)
    assert fitted.scene.endswith("chair.xml") and not fitted.parameters


def test_frames_are_in_the_order_of_their_numbers(setting):
    section = video.run(setting)
    for name in VIDEOS:
        rows = table(section, f"{name}: PSNR")
        numbers = [int(row["capture"].removeprefix("frame_")) for row in rows]
        assert len(numbers) == 3 and numbers == sorted(numbers)
        assert all(first_number(row["noise-aware video"]) > 15 for row in rows)


def test_noise_in_time_is_that_of_the_repeats(setting):
    """Of 4 repeats at exposures of 20 to 30: its estimate has 1764 x 3 x 3 degrees of freedom."""
    section = repeats.run(setting)
    assert len(section.claims) == 2
    for number, pattern in enumerate(repeats.IMAGES.values()):
        claim, taken = section.claims[number], setting.captures(REPEATS, pattern)
        assert len(taken) == 4
        levels = np.array([capture.photograph.mean() for capture in taken])
        exposures = 20 + 5 * (np.arange(4 * number, 4 * number + 4) % 3)
        noise = (NOISE**2 * 20 / exposures).mean()
        energy = np.mean([(c.photograph**2).mean() for c in taken]) / levels.mean() ** 2
        expected = 10 * np.log10(energy / (noise * (1 + 0.5 + 1) / 3))
        assert first_number(claim.measured) == pytest.approx(expected, abs=0.3)
    for row in table(section, "Drift"):
        if row["over reported"]:
            assert 0.05 < float(row["over reported"]) < 1.2


def test_real_ambient_light_is_measured_and_cancelled(setting, monkeypatch):
    monkeypatch.setattr(ambient, "LEVELS", {AMBIENT: ambient.LEVELS[AMBIENT]})
    section = ambient.run(setting)
    light = table(section, f"{AMBIENT}: ambient light alone")
    paint = 100 * PAINT
    for row in light:  # what lies outside is the paint, and alike in all
        assert float(row["outside range(B), %"]) == pytest.approx(paint, rel=0.15)
        assert all(float(text) > 0.85 for text in row["alike with the others"].split())
    brightest, *others = table(section, f"{AMBIENT}: PSNR")
    for row, sbr in zip(others, SBRS, strict=True):
        assert float(row["SBR"]) == pytest.approx(sbr, abs=0.011)
    lowest = others[-1]
    # A background photograph shows the paint, also to a photograph without ambient light.
    for row in (brightest, lowest):
        assert first_number(row[ambient.OURS_WITH]) > first_number(row[recovered.OURS]) + 1
    nature = recovered.NATURE
    assert first_number(lowest[nature]) < first_number(brightest[nature]) - 3
    assert len(section.claims) == 3 and section.claims[1].verdict is Verdict.AGREES


def test_a_lit_block_is_its_column_of_the_transport_matrix(setting):
    section = single_pixels.run(setting)
    rows = table(section, "Patches are")
    assert len(rows) == 4
    for row in rows:
        row_, column = LIT[row["capture"]]
        assert row["lit patch"] == f"{row_}.0, {column}.0"
        assert row["most like"] == f"{row_}, {column}"
        assert row["down, right of it"] == "+0.0, +0.0"
        assert float(row["correlation"]) > 0.97
        assert all(
            float(gain) == pytest.approx(1, abs=0.05) for gain in row["gain over mean"].split()
        )


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
        ({"--scene": f"{CHAIR}=nowhere.xml"}, "nowhere.xml"),
    ],
)
def test_what_a_user_can_fix_is_said_in_one_line(tmp_path, data, change, offender):
    options = {"--data": data.root, "--out": tmp_path / "out", "--only": "stills", **change}
    result = run(*(word for pair in options.items() for word in pair))
    assert result.exit_code == 2
    assert offender in result.stderr and result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
