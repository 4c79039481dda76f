"""How figures look: sizes and colours that suit a paper's column and every reader's eyes."""

import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from textwrap import fill
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.numerics import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure

COLUMN, PAGE = 3.5, 7.2
"""Inches of a journal's column and of its page, at which figures print at their own size."""

LETTERS = 16.0
"""Letters of 8 points in an inch, about."""

NO_BREAK = "\N{NO-BREAK SPACE}"

LINE, MARGIN = 0.135, 0.04
"""Inches of a line of text; about a figure, and between its caption and the rest."""

OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours that the colour-blind distinguish, after Okabe and Ito, the darker first."""

STYLE: Any = {
    "font.size": 8, "figure.titlesize": 8, "figure.labelsize": 8,
    "axes.titlesize": 8, "axes.labelsize": 8, "axes.linewidth": 0.6, "axes.axisbelow": True,
    "axes.spines.top": False, "axes.spines.right": False,
    "grid.color": "0.88", "grid.linewidth": 0.5, "lines.linewidth": 1.3,
    "xtick.labelsize": 7, "ytick.labelsize": 7, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
    "legend.fontsize": 7, "legend.frameon": False,
    "text.parse_math": False, "text.usetex": False,  # names come from files
    "image.interpolation": "nearest", "pdf.fonttype": 42, "savefig.dpi": 300,
}  # fmt: skip
"""Matplotlib's settings, which it takes when a thing is drawn, not when it is saved."""


class _Matplotlib(ModuleType):
    """Matplotlib and its modules, imported at their first use, even if `MPLBACKEND` is wrong.

    Files need no backend, and a notebook's own, which its processes inherit, may not exist here.
    """

    def __getattr__(self, name: str) -> Any:
        backend = None if "matplotlib" in sys.modules else os.environ.pop("MPLBACKEND", None)
        import matplotlib.backends.backend_agg  # which draws files

        if backend is not None:
            os.environ["MPLBACKEND"] = backend
            with suppress(ValueError):
                matplotlib.rcParams["backend"] = backend
        return getattr(matplotlib, name, None) or import_module(f"matplotlib.{name}")


mpl = _Matplotlib("matplotlib")


@contextmanager
def drawn(
    path: Path, metadata: Mapping[str, str] | None = None, caption: str = ""
) -> "Iterator[Figure]":
    """Yield a figure to draw on; save it with its caption, and text chunks of a PNG.

    The file has the figure's width. What is empty above and below is cut off.
    """
    with mpl.rc_context(STYLE):
        figure = mpl.figure.Figure(layout="constrained")
        yield figure
        figure.savefig(path, metadata=dict(metadata or {}), bbox_inches=_frame(figure, caption))


def wrapped(text: str, inches: float) -> str:
    """Return text in lines that fit into a width; a number keeps its unit."""
    bound = re.sub(r" (?=%|dB)", NO_BREAK, text)
    whole: Any = {"break_long_words": False, "break_on_hyphens": False}
    lines = (fill(each, int(LETTERS * inches), **whole) for each in bound.split("\n"))
    return "\n".join(lines).replace(NO_BREAK, " ")


def _frame(figure: "Figure", caption: str) -> Any:
    """Write the caption beneath everything; return the box that holds all, in inches."""
    figure.draw_without_rendering()
    width, height = figure.get_size_inches()
    box = figure.get_tightbbox()
    bottom = box.y0 - MARGIN
    if caption:
        label = figure.supxlabel(wrapped(caption, width), y=bottom / height, va="top")
        label.set_in_layout(False)  # the rest stays where it is
        bottom = label.get_window_extent().y0 / figure.dpi - MARGIN
    sides = min(0.0, box.x0), max(width, box.x1)
    return mpl.transforms.Bbox([[sides[0], bottom], [sides[1], box.y1 + MARGIN]])


def positive(values: Array) -> Array:
    """Return what a logarithmic scale shows of values; NaN elsewhere."""
    return np.where(np.isfinite(values) & (values > 0), values, np.nan)


def log_norm(values: Array) -> Any:
    """Return a logarithmic scale from the least to the largest value above 0; else of 1 to 10."""
    shown = values[~np.isnan(positive(values))]
    return mpl.colors.LogNorm(*((shown.min(), shown.max()) if shown.size else (1.0, 10.0)))


def plain_ticks(axis: Any) -> None:
    """Tick a logarithmic axis with plain numbers, as many as there is room for."""
    ticker = mpl.ticker
    low, high = axis.get_view_interval()
    decades = np.log10(max(high, 1e-300) / max(low, 1e-300))
    if decades < 0.9:
        axis.set_major_locator(ticker.MaxNLocator(4))
        axis.set_minor_locator(ticker.LogLocator(subs=()))
    else:
        axis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5) if decades < 2.5 else (1,)))
    axis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(ticker.NullFormatter())
