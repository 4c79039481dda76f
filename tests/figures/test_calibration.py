from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from periscopy_sim.calibration.result import Calibration, DeterminedBy, Parameter
from periscopy_sim.cli.calibrate import say_calibration
from periscopy_sim.figures.calibration import draw_calibration
from tests.scenes.calibration import calibration
from tests.scenes.pictures import read

Draw = Callable[[Calibration], Figure]
PHOTOGRAPH = np.full((32, 36, 3), 0.5)


@pytest.fixture
def draw(tmp_path: Path, saved: list[Figure]) -> Draw:
    def figure(shown: Calibration) -> Figure:
        path = tmp_path / "calibration.png"
        draw_calibration(path, PHOTOGRAPH, shown, {"dx": "m"}, {"Source": "s"})
        assert read(path)[0]["Source"] == "s"
        return saved[-1]

    return figure


def test_each_residual_has_its_title_and_is_in_percent(draw: Draw) -> None:
    shown = calibration()
    panels: dict[str, Any] = {ax.get_title(): ax for ax in draw(shown).axes}
    titles = "unexplained at the start: 2.89 %", "unexplained after calibration: 1.00 %"
    for title, residual in zip(titles, (shown.residual_before, shown.residual), strict=True):
        (picture,) = panels[title].images
        np.testing.assert_allclose(picture.get_array(), 100 * residual.mean(axis=2))
        low, high = picture.get_clim()
        bound = np.percentile(np.abs(shown.residual_before.mean(axis=2)), 99)
        assert -low == high == pytest.approx(100 * bound)


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
    sources = [DeterminedBy.PHOTOGRAPH, DeterminedBy.PHOTOGRAPH_ALONE, DeterminedBy.RULER]
    path = (np.zeros((1, 4)),)
    shown = replace(calibration(), parameters=measured, path=path, correlation=np.eye(3))
    assert [parameter.determined_by for parameter in measured] == sources
    labels = draw(shown).axes[-1].get_legend_handles_labels()[1]
    say_calibration(shown, {})
    lines = [line for line in capsys.readouterr().out.splitlines() if "measured" in line]
    for source, line in zip(sources, lines[-3:], strict=True):
        assert any(label.endswith(source) for label in labels) and source in line
    doubted = replace(measured[0], trusted=False)
    assert doubted.determined_by is DeterminedBy.NOTHING and not doubted.determined
