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

GREYS = {"opaque": 0.1, "open": 1.0, "unseen": 0.8}
"""Brightness of cells; the last of those that the photograph does not show."""


def draw_silhouette(
    path: Path,
    photograph: Array,
    found: Silhouette,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the photograph, the mask as seen facing the wall, the image, and the residual.

    Each answer has a row. The photograph is (rows, columns, 3), linear.
    """
    answers = (found, *found.others)
    bound = 100 * float(np.percentile(np.abs(found.residual.mean(axis=2)), 99)) or 1.0
    with drawn(path, metadata) as figure:
        figure.set_size_inches(12, 3.4 * len(answers))
        for row, answer in zip(
            figure.subplots(len(answers), 4, squeeze=False), answers, strict=True
        ):
            show_light(row[0], "photograph", photograph)
            cells = np.where(answer.seen, GREYS["open"], GREYS["unseen"])
            cells = np.where(answer.opaque, GREYS["opaque"], cells)
            height, width = answer.plane.sides
            title = "silhouette of {}, {} x {}".format(answer.name, *answer.opaque.shape)
            show(row[1], title, cells, cmap="gray", vmin=0, vmax=1, extent=(0, width, 0, height))
            row[1].set_axis_on()
            row[1].set_xlabel("metres, facing the wall; grey: no shadow in view")
            show_light(row[2], "image with this silhouette", answer.image)
            title = f"unexplained: {100 * answer.unexplained:.2f} %"
            maps = {title: 100 * answer.residual.mean(axis=2)}
            show_signed(row[3:], maps, bound, "% of the photograph's rms")
        figure.suptitle("\n".join(found.doubts), color="#cb181d")
