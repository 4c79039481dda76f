"""The silhouette of an unmeasured occluder, beside the image recovered with it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from periscopy_sim.figures.panels import show, show_light, show_signed
from periscopy_sim.scenario import Array

if TYPE_CHECKING:
    from periscopy_sim.calibration.silhouette.result import Silhouette

OPAQUE, OPEN, UNSEEN = (0.1, 0.1, 0.1), (1.0, 1.0, 1.0), (0.8, 0.8, 0.8)
"""Colours of cells; the last is of those that the photograph does not show."""


def draw_silhouette(
    path: Path,
    photograph: Array,
    solution: Silhouette,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the photograph, the mask as seen facing the wall, the image, and the residual.

    The photograph is (rows, columns, 3), linear.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 3.4), layout="constrained")
    axes = figure.subplots(1, 4)
    show_light(axes[0], "photograph", photograph)
    cells = np.where(solution.seen[..., None], OPEN, UNSEEN)
    cells = np.where(solution.opaque[..., None], OPAQUE, cells)
    height, width = solution.plane.sides
    title = "silhouette of {}, {} x {}".format(solution.name, *solution.opaque.shape)
    show(axes[1], title, cells, extent=(0, width, 0, height))
    axes[1].set_axis_on()
    axes[1].tick_params(labelsize=7)
    axes[1].set_xlabel("metres, facing the wall; grey: no shadow in view", fontsize=8)
    show_light(axes[2], "image with this silhouette", solution.image)
    residual = 100 * solution.residual.mean(axis=2)
    bound = float(np.percentile(np.abs(residual), 99)) or 1.0
    title = f"unexplained: {100 * solution.unexplained:.2f} %"
    show_signed(axes[3:], {title: residual}, bound, "% of the photograph's rms")
    if solution.doubts:
        figure.suptitle("\n".join(solution.doubts), color="#cb181d", fontsize=9)
    figure.savefig(path, dpi=150, metadata=dict(metadata or {}))
