"""The figure: each case's masks and images, found beside true."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, drawn, show_light
from experiments.studies.silhouettes.outcome import Outcome
from periscopy_sim.figures.silhouette import OPAQUE, OPEN, UNSEEN

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

TITLES = (
    "true silhouette",
    "found silhouette\n(line: the true one)",
    "hidden image",
    "image by the\nfound mask",
    "by the true\none's cells",
    "by the\ntrue one",
)

ROW = 1.16
"""Inches that a case takes."""

LETTERS = 16
"""Of a line of a case's name."""

OUTLINE = COLORS["differencing"]


def draw_cases(out: Path, name: str, outcomes: Sequence[Outcome]) -> Path:
    """Draw a row for each case: true and found mask, the hidden image, and what each recovers."""
    with drawn(out, name, PAGE, 0.4 + ROW * len(outcomes)) as figure:
        figure.get_layout_engine().set(w_pad=0.02, h_pad=0.03)
        grid = figure.subplots(
            len(outcomes), len(TITLES), squeeze=False, width_ratios=[1, 1, *[1.1] * 4]
        )
        for row, outcome in zip(grid, outcomes, strict=True):
            _draw_masks(row[:2], outcome)
            _draw_images(row[2:], outcome)
            row[0].text(
                -0.12, 0.5, label_of(outcome), transform=row[0].transAxes, fontsize=7,
                ha="right", va="center", multialignment="right",
            )  # fmt: skip
        for ax, title in zip(grid[0], TITLES, strict=True):
            ax.set_title(title)
    return out / f"{name}.png"


def label_of(outcome: Outcome) -> str:
    """Return a case's name in short lines, and its signal-to-background ratio."""
    lines = textwrap.wrap(outcome.name, LETTERS)
    if outcome.sbr is not None:
        lines.append(f"SBR {outcome.sbr:g}")
    return "\n".join(lines)


def _draw_masks(axes: Sequence[Any], outcome: Outcome) -> None:
    """Draw the true mask, and the found one with the other's outline."""
    true, found = axes
    colours = np.where(outcome.seen[..., None], OPEN, UNSEEN)
    colours = np.where(outcome.opaque[..., None], OPAQUE, colours)
    height, width = (1e3 * side for side in outcome.sides)
    whole = (0.0, width, height, 0.0)
    true.imshow(np.where(outcome.outline[..., None], OPAQUE, OPEN), extent=whole)
    found.imshow(colours, extent=whole, interpolation="nearest")
    rows, columns = outcome.outline.shape
    # A ring of open points, so that what reaches the border has an outline there too.
    x, y = (
        (np.arange(-1, count + 1) + 0.5) * size / count
        for count, size in ((columns, width), (rows, height))
    )
    found.contour(
        x, y, np.pad(outcome.outline, 1).astype(float), [0.5], colors=OUTLINE, linewidths=0.9
    )
    found.set(xlim=(0, width), ylim=(height, 0))
    for ax in axes:
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set(visible=True, color="0.6")
    _note(true, f"{width:.0f} mm × {height:.0f} mm")
    agreed = outcome.shared
    shares = f"{agreed.standing:.2f} shared"
    if agreed.shifted > agreed.standing:
        shares += f" ({agreed.shifted:.2f} shifted)"
    _note(found, f"{shares},\n{'trusted' if outcome.trusted else 'not trusted'}")


def _draw_images(axes: Sequence[Any], outcome: Outcome) -> None:
    """Draw the hidden image, and it as recovered, with dB where there is a truth in place."""
    shown, *recovered = axes
    show_light(shown, outcome.truth, 1)
    _note(shown, "{}\n{} × {} patches".format(outcome.image, *outcome.found_image.shape[:2]))
    images = outcome.found_image, outcome.flat_image, outcome.true_image
    for ax, image in zip(recovered, images, strict=True):
        decibels = outcome.decibels(image)
        if decibels is None:
            show_light(ax, image)
            continue
        show_light(ax, ps.registered(image, outcome.truth).image, 1)
        _note(ax, "{:.1f} dB,\n{:.1f} dB registered".format(*decibels))


def _note(ax: Any, text: str) -> None:
    """Write a few words below a picture."""
    ax.text(0.5, -0.05, text, transform=ax.transAxes, fontsize=6.5, ha="center", va="top")
