"""A calibration: its residuals of the photograph, and the path of its search."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures.panels import show_light, show_signed
from periscopy_sim.figures.style import drawn
from periscopy_sim.numerics.percentages import percentages
from periscopy_sim.scenario import Array

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration


def draw_calibration(
    path: Path,
    photograph: Array,
    calibration: Calibration,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the photograph, its residual before and after, and each parameter's path.

    The photograph is (rows, columns, 3), linear.
    """
    count = len(calibration.parameters)
    rows = -(-count // 4)
    columns = -(-count // rows)
    warned = 0.2 * (1 + 2 * len(calibration.doubts)) if calibration.doubts else 0.0
    heights = [3.0 + warned, 0.4 + 2.3 * rows]
    with drawn(path, metadata) as figure:
        figure.set_size_inches(3.1 * max(3, columns), sum(heights))
        above, beneath = figure.subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_residuals(above, photograph, calibration)
        if calibration.doubts:
            reasons = "\n".join(textwrap.fill(doubt, 100) for doubt in calibration.doubts)
            above.suptitle(f"NOT TO BE TRUSTED\n{reasons}", color="#cb181d")
        axes = beneath.subplots(rows, columns, squeeze=False)
        for k, ax in enumerate(axes.flat[:count]):
            _draw_path(ax, calibration, k)
        for ax in axes.flat[count:]:
            ax.set_axis_off()
        beneath.supylabel("value, in the scene's units")
        beneath.supxlabel("pixels of the photograph at each level")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        beneath.legend(handles, labels, loc="outside upper center", ncols=len(labels))


def _draw_residuals(figure: Any, photograph: Array, calibration: Calibration) -> None:
    """Show the photograph and the mean residual over its channels, in percent, twice."""
    times = "at the start", "after calibration"
    residuals = calibration.residual_before, calibration.residual
    parts = percentages(*calibration.unexplained)
    maps = {
        f"unexplained {when}: {part} %": 100 * residual.mean(axis=2)
        for when, part, residual in zip(times, parts, residuals, strict=True)
    }
    bound = 100 * float(np.percentile(np.abs(residuals[0].mean(axis=2)), 99)) or 1.0
    axes = figure.subplots(1, 3)
    show_light(axes[0], "photograph", photograph)
    show_signed(axes[1:], maps, bound, "% of the photograph's root mean square")


def _draw_path(ax: Any, calibration: Calibration, k: int) -> None:
    """Show a parameter at all points that were visited, level by level, and where it ended."""
    parameter = calibration.parameters[k]
    looks = ("looked at, low resolution", "#a0a0a0"), ("looked at", "#6baed6")
    for level, (visited, (label, color)) in enumerate(zip(calibration.path, looks, strict=True)):
        # A level's points take equal room, however many they are.
        place = level + (np.arange(len(visited.values)) + 0.5) / len(visited.values)
        values = visited.values[:, k]
        ax.plot(place, values, ".", color=color, markersize=3, label=label)
    best = _best_so_far(visited.evidence)
    ax.plot(place, values[best], color="#08519c", linewidth=0.9, label="best so far")
    ax.set_ylim(*_range(calibration, k))
    ax.axhline(parameter.start, color="black", linewidth=0.8, linestyle=":", label="start")
    ax.axhline(parameter.value, color="#d94801", linewidth=0.8, label="found")
    low, high = parameter.value + parameter.standard_error * np.array([-1, 1])
    ax.axhspan(low, high, color="#fd8d3c", alpha=0.35, linewidth=0, label="± standard error")
    ax.set_title(f"{parameter.name}: {parameter.value:.4g} ± {parameter.standard_error:.2g}")
    ax.set_xticks(np.arange(len(calibration.path)) + 0.5)
    ax.set_xticklabels(["{} x {}".format(*each.photograph_shape) for each in calibration.path])


def _best_so_far(evidence: Array) -> NDArray[np.intp]:
    """Return for each point visited, (n,), which one has the least evidence until then."""
    least = np.minimum.accumulate(evidence)
    is_best = np.arange(len(evidence)) * (evidence <= least)
    return np.asarray(np.maximum.accumulate(is_best))


def _range(calibration: Calibration, k: int) -> tuple[float, float]:
    """Return the range of a parameter's start, end and descent; the search is wider."""
    parameter = calibration.parameters[k]
    ends = parameter.value + parameter.standard_error * np.array([-1, 1])
    shown = np.concatenate([[parameter.start], ends, calibration.path[-1].values[:, k]])
    margin = 0.08 * float(np.ptp(shown)) or 1.0
    return float(shown.min()) - margin, float(shown.max()) + margin
