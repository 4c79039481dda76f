"""How figures look: sizes and colours that suit a paper's column and every reader's eyes."""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure

OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours that the colour-blind distinguish, after Okabe and Ito, the darker first."""

STYLE: Any = {
    "font.size": 8, "figure.titlesize": 9, "figure.labelsize": 8,
    "axes.titlesize": 9, "axes.labelsize": 8, "axes.linewidth": 0.6, "axes.axisbelow": True,
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
def drawn(path: Path, metadata: Mapping[str, str] | None = None) -> "Iterator[Figure]":
    """Yield a figure to draw on; save it with text chunks of a PNG, such as provenance."""
    with mpl.rc_context(STYLE):
        figure = mpl.figure.Figure(layout="constrained")
        yield figure
        figure.savefig(path, metadata=dict(metadata or {}))


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
