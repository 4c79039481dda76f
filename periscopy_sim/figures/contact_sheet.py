"""A video on one sheet: chosen frames from left to right, what belongs together beneath."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from periscopy_sim.figures.panels import Image
from periscopy_sim.figures.style import drawn
from periscopy_sim.storage.formats.decoding import srgb_encode


def evenly_chosen(count: int, most: int) -> list[int]:
    """Return at most so many of the numbers below `count`, the first and the last among them."""
    return [int(k) for k in np.linspace(0, count - 1, min(count, most)).round()]


def draw_contact_sheet(
    path: Path,
    rows: Sequence[tuple[str, Sequence[Image]]],
    *,
    titles: Sequence[str],
    notes: Sequence[str] | None = None,
    columns: int | None = None,
    fontsize: float = 9,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw rows of linear images, (rows, columns, 3) in [0, 1], as in the paper's Fig. 7.

    The titles stand above the columns, the notes beneath. Of more than `columns` columns, the
    others follow below. The text is `fontsize` points high.
    """
    columns = min(columns or len(titles), len(titles))
    lines = -(-len(titles) // columns)
    aspects = [images[0].shape[0] / images[0].shape[1] for _, images in rows]
    with drawn(path, metadata) as figure:
        figure.set_size_inches(1.35 * columns + 0.35, lines * (1.43 * sum(aspects) + 0.6))
        figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02, wspace=0.01, hspace=0.01)
        shape = lines * len(rows), columns
        axes = figure.subplots(*shape, height_ratios=aspects * lines, squeeze=False)
        for ax in axes.flat:
            ax.set(xticks=[], yticks=[])
            ax.spines[:].set_visible(False)
        for k, title in enumerate(titles):
            line, column = divmod(k, columns)
            below = axes[line * len(rows) : (line + 1) * len(rows), column]
            for ax, (name, images) in zip(below, rows, strict=True):
                ax.imshow(srgb_encode(images[k]))
                if column == 0:
                    ax.set_ylabel(name, fontsize=fontsize)
            below[0].set_title(title, fontsize=fontsize)
            if notes is not None:
                below[-1].set_xlabel(notes[k], fontsize=fontsize)
