"""What a reconstruction leaves of its photograph, as a map."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from periscopy_sim.figures.panels import displayable, show
from periscopy_sim.scenario import Array
from periscopy_sim.storage.formats.srgb import srgb_encode

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from periscopy_sim.model.residual import Residual

LEAST_RANGE = 4.0
"""Standard deviations of noise that the colours reach at least: noise alone then looks pale."""


def draw_residual(
    path: Path, photograph: Array, residual: Residual, metadata: Mapping[str, str] | None = None
) -> None:
    """Draw a photograph, (rows, columns, 3), linear, beside what is left of it; see `Residual`."""
    residual_figure(photograph, residual).savefig(path, dpi=200, metadata=dict(metadata or {}))


def residual_map(residual: Residual) -> tuple[Array, float, str]:
    """Return what is left, (rows, columns), by which value either way colours end, and its unit.

    It is the mean over the channels, over the standard deviation that noise gives it; where noise
    is not known, in percent of the photograph's root mean square. Pixels left out are NaN.
    """
    left = residual.light.mean(axis=2)
    if residual.noise is None or not residual.noise.σ.any():
        level = float(np.sqrt(np.nanmean(residual.light**2))) / (residual.unexplained or 1)
        left, unit = 100 * left / (level or 1), "% of the photograph's root mean square"
        least = 0.0
    else:
        left = left / (np.sqrt(np.sum(residual.noise.σ**2)) / 3)
        least, unit = LEAST_RANGE, "standard deviations of noise"
    return left, max(least, float(np.nanpercentile(np.abs(left), 99))) or 1.0, unit


def residual_figure(photograph: Array, residual: Residual) -> Figure:
    """Return the figure that `draw_residual` saves: the map in false colours, grey for no value."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    left, bound, unit = residual_map(residual)
    colours = colormaps["RdBu_r"].with_extremes(bad="0.6")
    aspect = left.shape[1] / left.shape[0]
    figure = Figure(figsize=(6.4 * aspect + 1.3, 3.6), layout="constrained")
    axes = figure.subplots(1, 2)
    show(axes[0], "photograph", srgb_encode(displayable(photograph)))
    picture = show(axes[1], "unexplained", left, cmap=colours, vmin=-bound, vmax=bound)
    bar = figure.colorbar(picture, ax=axes[1], shrink=0.85)
    bar.set_label(unit, fontsize=8)
    bar.ax.tick_params(labelsize=7)
    figure.supxlabel(residual.remark, fontsize=8)
    return figure
