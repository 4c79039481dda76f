"""A video on one sheet: chosen frames from left to right, what belongs together beneath."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from periscopy_sim.figures.panels import Image
from periscopy_sim.storage.formats.srgb import srgb_encode


def evenly_chosen(count: int, most: int) -> list[int]:
    """Return at most so many of the numbers below `count`, the first and the last among them.

    Parameters
    ----------
    count
        At least 1.
    most
        At least 2.

    Returns
    -------
    list of int
        In ascending order, no two gaps more than 1 apart.
    """
    if count <= most:
        return list(range(count))
    return [round(k * (count - 1) / (most - 1)) for k in range(most)]


def draw_contact_sheet(
    path: Path,
    rows: Sequence[tuple[str, Sequence[Image]]],
    *,
    titles: Sequence[str],
    notes: Sequence[str],
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw rows of linear images, as in the paper's Fig. 7.

    Parameters
    ----------
    path
        A PNG or PDF file.
    rows
        The name of each row and its (rows, columns, 3) linear images in [0, 1].
    titles
        What stands above each column.
    notes
        What stands beneath each column.
    metadata
        Text chunks of a PNG, such as provenance.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    aspects = [images[0].shape[0] / images[0].shape[1] for _, images in rows]
    width = 1.35
    size = (width * len(titles) + 0.35, 1.06 * width * sum(aspects) + 0.6)
    layout = ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02, wspace=0.01, hspace=0.01)
    figure = Figure(figsize=size, layout=layout)
    axes = figure.subplots(len(rows), len(titles), height_ratios=aspects, squeeze=False)
    for line, (name, images) in zip(axes, rows, strict=True):
        for ax, image in zip(line, images, strict=True):
            ax.imshow(srgb_encode(image), interpolation="nearest", aspect="equal")
            ax.set_xticks([])
            ax.set_yticks([])
            ax.spines[:].set_visible(False)
        line[0].set_ylabel(name, fontsize=9)
    for ax, title in zip(axes[0], titles, strict=True):
        ax.set_title(title, fontsize=9)
    for ax, note in zip(axes[-1], notes, strict=True):
        ax.set_xlabel(note, fontsize=9)
    figure.savefig(path, dpi=200, metadata=dict(metadata or {}))
