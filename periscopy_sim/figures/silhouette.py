"""The silhouette of an unmeasured occluder, beside the image recovered with it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from periscopy_sim.figures.panels import show, show_light, show_signed
from periscopy_sim.figures.style import drawn
from periscopy_sim.scenario import Array

if TYPE_CHECKING:
    from periscopy_sim.calibration.silhouette.result import Silhouette


def draw_silhouette(
    path: Path,
    photograph: Array,
    solution: Silhouette,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the photograph, the mask as seen facing the wall, the image, and the residual.

    The photograph is (rows, columns, 3), linear.
    """
    residual = 100 * solution.residual.mean(axis=2)
    bound = float(np.percentile(np.abs(residual), 99)) or 1.0
    with drawn(path, metadata) as figure:
        figure.set_size_inches(12, 3.4)
        axes = figure.subplots(1, 4)
        show_light(axes[0], "photograph", photograph)
        cells = np.where(solution.opaque, 0.1, np.where(solution.seen, 1.0, 0.8))
        height, width = solution.plane.sides
        title = "silhouette of {}, {} x {}".format(solution.name, *solution.opaque.shape)
        show(axes[1], title, cells, cmap="gray", vmin=0, vmax=1, extent=(0, width, 0, height))
        axes[1].set_axis_on()
        axes[1].set_xlabel("metres, facing the wall; grey: no shadow in view")
        show_light(axes[2], "image with this silhouette", solution.image)
        title = f"unexplained: {100 * solution.unexplained:.2f} %"
        show_signed(axes[3:], {title: residual}, bound, "% of the photograph's rms")
        figure.suptitle("\n".join(solution.doubts), color="#cb181d")
