"""The silhouette of an occluder nobody measured, beside the image that was found with it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from periscopy_sim.figures.panels import displayable, show
from periscopy_sim.scenario import Array
from periscopy_sim.storage.formats.srgb import srgb_encode

if TYPE_CHECKING:
    from periscopy_sim.calibration.silhouette.result import Silhouette

OPAQUE, OPEN, UNSEEN = (0.1, 0.1, 0.1), (1.0, 1.0, 1.0), (0.8, 0.8, 0.8)
"""Colours of cells; the last is of those that the photograph does not show."""


def draw_silhouette(
    path: Path,
    photograph: Array,
    found: Silhouette,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the photograph, the mask as one sees it who faces the wall, the image, what is left.

    Each answer has a row. The photograph is (rows, columns, 3), linear.
    """
    from matplotlib.figure import Figure

    answers = (found, *found.others)
    figure = Figure(figsize=(12, 3.4 * len(answers)), layout="constrained")
    axes = figure.subplots(len(answers), 4, squeeze=False)
    bound = 100 * float(np.percentile(np.abs(found.residual.mean(axis=2)), 99)) or 1.0
    for row, answer in zip(axes, answers, strict=True):
        show(row[0], "photograph", srgb_encode(displayable(photograph)))
        cells = np.where(answer.seen[..., None], OPEN, UNSEEN)
        cells = np.where(answer.opaque[..., None], OPAQUE, cells)
        height, width = answer.plane.sides
        title = "silhouette of {}, {} x {}".format(answer.name, *answer.opaque.shape)
        show(row[1], title, cells, extent=(0, width, 0, height))
        row[1].set_axis_on()
        row[1].tick_params(labelsize=7)
        row[1].set_xlabel("metres, facing the wall; grey: no shadow in view", fontsize=8)
        show(row[2], "image found with it", srgb_encode(displayable(answer.image)))
        left = 100 * answer.residual.mean(axis=2)
        title = f"unexplained: {100 * answer.unexplained:.2f} %"
        picture = show(row[3], title, left, cmap="RdBu_r", vmin=-bound, vmax=bound)
        bar = figure.colorbar(picture, ax=row[3], shrink=0.8)
        bar.set_label("% of the photograph's rms", fontsize=8)
        bar.ax.tick_params(labelsize=8)
    if found.doubts:
        figure.suptitle("\n".join(found.doubts), color="#cb181d", fontsize=9)
    figure.savefig(path, dpi=150, metadata=dict(metadata or {}))
