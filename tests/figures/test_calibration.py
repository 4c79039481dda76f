from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from periscopy_sim.calibration.mask_depth import Depth
from periscopy_sim.calibration.masks import MaskPlane
from periscopy_sim.calibration.result import Calibration, Parameter, ParameterSource, Rival
from periscopy_sim.calibration.silhouette import Silhouette
from periscopy_sim.cli.calibrate import show_calibration
from periscopy_sim.cli.output import outcome, outcome_of
from periscopy_sim.figures.calibration import draw_calibration, draw_silhouette
from periscopy_sim.photograph import Photograph
from tests.scenes.calibration import calibration
from tests.scenes.pictures import read

Draw = Callable[[Calibration], Figure]
PHOTOGRAPH = Photograph.of(np.full((32, 36, 3), 0.5))


@pytest.fixture
def draw(tmp_path: Path, saved: list[Figure]) -> Draw:
    def figure(shown: Calibration) -> Figure:
        path = tmp_path / "calibration.png"
        draw_calibration(path, PHOTOGRAPH, shown, {"dx": "m"}, {"ParameterSource": "s"})
        assert read(path)[0]["ParameterSource"] == "s"
        return saved[-1]

    return figure


def test_each_residual_has_its_title_and_is_in_percent(draw: Draw) -> None:
    shown = calibration()
    panels: dict[str, Any] = {ax.get_title(): ax for ax in draw(shown).axes}
    titles = "start\n2.89 %", "calibrated\n1 %"
    for title, residual in zip(titles, (shown.residual_before, shown.residual), strict=True):
        (picture,) = panels[title].images
        np.testing.assert_allclose(picture.get_array(), 100 * residual.mean(axis=2))
        low, high = picture.get_clim()
        bound = np.percentile(np.abs(shown.residual_before.mean(axis=2)), 99)
        assert -low == high == pytest.approx(100 * bound)


def test_images_that_photographs_do_not_tell_from_each_other_are_shown(draw: Draw) -> None:
    images = tuple(np.full((4, 5, 3), level) for level in (0.25, 0.5))
    shown = replace(calibration(), images=images, rivals=(Rival({"dx": 0.2, "turn": 1.5}, 0.3),))
    panels: dict[str, Any] = {ax.get_title(): ax for ax in draw(shown).axes}
    for title in ("image calibrated (70 %)", "image aside (30 %)"):
        assert panels[title].images[0].get_array().shape == (4, 5, 3)
    assert not any("aside" in ax.get_title() for ax in draw(calibration()).axes)


def test_parameters_are_shown_over_the_errors_of_their_measured_values(draw: Draw) -> None:
    *_, ax = draw(calibration()).axes
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        "dx = 0.100 ± 0.010 m",
        "turn = 1.60 ± 0.50",
    ]
    path = next(line for line in ax.get_lines() if line.get_label() == "search")
    np.testing.assert_allclose(path.get_xdata()[:2], [0.11 / 0.05, -0.2 / 0.5])
    for (row, value, error), bars in zip([(0, 2, 0.2), (1, -0.8, 1)], ax.containers, strict=True):
        points, _, (lines,) = bars.lines
        np.testing.assert_allclose(points.get_xydata(), [[value, row]])
        np.testing.assert_allclose(lines.get_segments()[0][:, 0], [value - error, value + error])


def test_a_parameter_has_one_source_in_the_table_and_in_the_figure(
    draw: Draw, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = (
        Parameter("dx", 0.0, 0.1, 0.01, 0.01, 0.05),
        Parameter("dy", 0.0, 0.1, 0.01, 0.05, 0.05),
        Parameter("dz", 0.0, 0.1, 0.05, 0.05, 0.05),
    )
    sources = [ParameterSource.PHOTOGRAPH, ParameterSource.PHOTOGRAPH_ALONE, ParameterSource.RULER]
    path = (np.zeros((1, 4)),)
    shown = replace(calibration(), parameters=measured, path=path, correlation=np.eye(3))
    assert [parameter.source for parameter in measured] == sources
    labels = draw(shown).axes[-1].get_legend_handles_labels()[1]
    show_calibration(shown, {})
    header, *lines = capsys.readouterr().out.splitlines()
    assert header.split() == ["parameter", "calibrated", "measured", "source"]
    for source, line in zip(sources, lines[:3], strict=True):
        assert any(label.endswith(source) for label in labels) and source in line
    far = replace(measured[0], value=0.16, trusted=False)
    with outcome_of(quiet=False, as_json=False):
        show_calibration(replace(shown, parameters=(far, *measured[1:]), doubts=("far",)), {})
        ((line, colour),) = outcome().verdicts
    assert line.endswith("Measure dx again.") and colour == "red"
    doubted = replace(measured[0], trusted=False)
    assert doubted.source is ParameterSource.NOTHING and not doubted.determined


def test_a_silhouette_s_figure_shows_the_image_of_each_surface(
    tmp_path: Path, saved: list[Figure]
) -> None:
    plane = MaskPlane(np.zeros(3), np.array([0.1, 0, 0]), np.array([0, 0, -0.05]))
    cells, image = np.eye(2), np.full((3, 2, 3), 0.5)
    depth = Depth(plane, np.zeros(3), 0.5, np.zeros(3), {}, {}, 0.0)
    residual = np.random.default_rng(0).standard_normal((32, 36, 3))
    images = {"monitor": image, "hidden_card": 2 * image}
    for shown, titles in ((image, ["image"]), (images, [*images])):
        found = Silhouette("card", plane, depth, cells, cells > 0, shown, 0.1, 1.0, residual, 0.0)
        draw_silhouette(tmp_path / "mask.png", PHOTOGRAPH, found)
        panels = [ax.get_title() for ax in saved[-1].axes]
        shows = [f"{name} with\nthis silhouette" for name in titles]
        assert [title for title in panels if title.endswith("silhouette")] == shows
