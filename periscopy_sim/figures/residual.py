"""The residual of a reconstruction, as a map beside the photograph."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from periscopy_sim.figures.panels import show_light, show_signed
from periscopy_sim.scenario import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from periscopy_sim.model.residual import Residual

LEAST_RANGE = 4.0
"""Standard deviations of noise that the colours reach at least: noise alone then looks pale."""


def draw_residual(
    path: Path,
    photograph: Array,
    residual: Residual,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw a photograph, (rows, columns, 3), linear, beside its residual; see `Residual`."""
    residual_figure(photograph, residual, caption).savefig(
        path, dpi=200, metadata=dict(metadata or {})
    )


def residual_map(residual: Residual) -> tuple[Array, float, str]:
    """Return the map of a residual, (rows, columns), the bound of its colours, and its unit.

    The map is the mean over the channels, divided by the standard deviation of its noise, or, if
    noise is not known, in percent of the photograph's root mean square. Masked pixels are NaN.
    """
    mean = residual.light.mean(axis=2)
    if not residual.noise_alone:
        level = float(np.sqrt(np.nanmean(residual.light**2))) / (residual.unexplained or 1)
        mean, unit = 100 * mean / (level or 1), "% of the photograph's root mean square"
        least = 0.0
    else:
        level = float(np.sqrt(np.nanmean(residual.light**2))) / (residual.unexplained or 1)
        mean = mean / (residual.noise_alone * level / np.sqrt(3))
        least, unit = LEAST_RANGE, "standard deviations of noise"
    return mean, max(least, float(np.nanpercentile(np.abs(mean), 99))) or 1.0, unit


def residual_figure(photograph: Array, residual: Residual, caption: str = "") -> Figure:
    """Return the figure that `draw_residual` saves."""
    from matplotlib.figure import Figure

    mean, bound, unit = residual_map(residual)
    aspect = mean.shape[1] / mean.shape[0]
    figure = Figure(figsize=(6.4 * aspect + 1.3, 3.6), layout="constrained")
    axes = figure.subplots(1, 2)
    show_light(axes[0], "photograph", photograph)
    show_signed(axes[1:], {"unexplained": mean}, bound, unit)
    figure.supxlabel(caption, fontsize=8)
    return figure
