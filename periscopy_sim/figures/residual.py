"""The residual of a reconstruction, as a map beside the photograph."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from periscopy_sim.figures.panels import show_light, show_signed
from periscopy_sim.figures.style import drawn
from periscopy_sim.scenario import Array

if TYPE_CHECKING:
    from periscopy_sim.model.residual import Residual


def draw_residual(
    path: Path,
    photograph: Array,
    residual: Residual,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw a photograph, (rows, columns, 3), linear, beside its residual; see `Residual`."""
    values, bound, unit = residual_map(residual)
    with drawn(path, metadata) as figure:
        figure.set_size_inches(6.4 * values.shape[1] / values.shape[0] + 1.3, 3.6)
        axes = figure.subplots(1, 2)
        show_light(axes[0], "photograph", photograph)
        show_signed(axes[1:], {"unexplained": values}, bound, unit)
        figure.supxlabel(caption)


def residual_map(residual: Residual, least: float = 4.0) -> tuple[Array, float, str]:
    """Return the map of a residual, (rows, columns), the bound of its colours, and its unit.

    The map is the mean over the channels, divided by the standard deviation of its noise, or, if
    noise is not known, in percent of the photograph's root mean square. Masked pixels are NaN. The
    colours reach at least so many deviations: noise alone then looks pale.
    """
    level = float(np.sqrt(np.nanmean(residual.light**2))) / (residual.unexplained or 1) or 1.0
    mean = residual.light.mean(axis=2) / level
    if residual.noise_alone:
        values, unit = mean * np.sqrt(3) / residual.noise_alone, "standard deviations of noise"
    else:
        values, unit, least = 100 * mean, "% of the photograph's root mean square", 0.0
    return values, max(least, float(np.nanpercentile(np.abs(values), 99))) or 1.0, unit
