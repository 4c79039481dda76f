"""Pictures of a design: a curve over one parameter, maps over two, a ranking over more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.evaluation.design.table import AS_IT_STANDS, Row
from periscopy_sim.evaluation.design.variation import Variation, as_text
from periscopy_sim.figures.panels import OKABE_ITO

Array = NDArray[np.float64]

DRAWN = (
    ("bound", "bound, without prior knowledge", 100.0),
    ("told_error", "told error, noise-aware", 100.0),
    ("error", "actual error, noise-aware", 100.0),
    ("exposure_time", "exposure time for an equal bound", 1.0),
)
"""Numbers of a merit that are drawn, their names, and their factors."""

FAILED = "0.85"
MARKS = (
    "circle: as it stands; star: best by what was asked; "
    "grey: no scene, or some patches are not told"
)
MOST_DRAWN = 300.0
"""Percent of white: of errors beyond, nothing is to be seen in an image."""

STANDS: dict[str, Any] = {"marker": "o", "mfc": "none", "mec": "black", "ms": 7, "mew": 1.4}
BEST: dict[str, Any] = {"marker": "*", "mfc": "white", "mec": "black", "ms": 13, "mew": 1.0}


def draw_design(
    path: Path,
    variation: Variation,
    rows: Sequence[Row],
    best: Row | None,
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw what points of a variation are worth, the scene as it stands and the best marked.

    Errors are in percent of white. Rows are `run_design`'s; points that failed are grey.
    """
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained")
    shown = [each for each in DRAWN if any(row.figure(each[0]) is not None for row in rows)]
    if len(variation.names) == 1:
        _draw_curves(figure, variation, rows, best, shown)
    elif len(variation.names) == 2 and variation.is_grid and (variation.grid or 0) > 1:
        _draw_maps(figure, variation, rows, best, shown)
    else:
        _draw_ranking(figure, variation, rows, best, shown)
    figure.supxlabel("\n".join(filter(None, (caption, MARKS))), fontsize=8)
    figure.savefig(path, dpi=200, metadata=dict(metadata or {}))


def _draw_curves(
    figure: Any,
    variation: Variation,
    rows: Sequence[Row],
    best: Row | None,
    shown: Sequence[tuple[str, str, float]],
) -> None:
    (name,) = variation.names
    figure.set_size_inches(5.6, 5.2)
    errors, time = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    tried = sorted(rows, key=lambda row: float(row.values[name]))
    x = np.array([float(row.values[name]) for row in tried])
    cells = np.unique([float(row.values[name]) for row in rows[1:]])
    for (number, label, factor), colour in zip(shown, OKABE_ITO, strict=False):
        ax = time if number == "exposure_time" else errors
        y = factor * _figures(tried, number)
        ax.plot(x, y, "-o", color=colour, ms=3, lw=1.3, label=label)
        for row, mark in _marked(rows, best):
            value = row.figure(number)
            if value is not None and np.isfinite(value):
                ax.plot(float(row.values[name]), factor * value, ls="", **mark)
    for ax in (errors, time):
        for row in (row for row in tried if row.merit is None):
            ax.axvspan(*_cell(cells, float(row.values[name])), color=FAILED, lw=0, zorder=0)
        _plain_log(ax.yaxis, most=MOST_DRAWN if ax is errors else np.inf)
        ax.grid(True, which="major", color="0.9", lw=0.5)
        ax.tick_params(labelsize=8, which="both")
    errors.set_ylabel("standard error of a patch,\n% of white", fontsize=9)
    errors.legend(fontsize=8, frameon=False)
    time.set_ylabel("exposure time for an\nequal bound, relative", fontsize=9)
    time.set_xlabel(name, fontsize=9)


def _draw_maps(
    figure: Any,
    variation: Variation,
    rows: Sequence[Row],
    best: Row | None,
    shown: Sequence[tuple[str, str, float]],
) -> None:
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import MaxNLocator

    across, up = variation.names
    size = len(variation.values(across))
    lines = -(-len(shown) // 2)
    figure.set_size_inches(7.6, 0.5 + 3.1 * lines)
    axes = figure.subplots(lines, 2, sharex=True, sharey=True, squeeze=False)
    x, y = (_edges(variation.values(name)) for name in (across, up))
    for ax, (number, label, factor) in zip(axes.ravel(), shown, strict=True):
        values = factor * _figures(rows[1:], number)
        grid = np.full(variation.count, np.nan)
        grid[: len(values)] = values
        finite = grid[np.isfinite(grid)]
        ax.set_facecolor(FAILED)
        ax.set_title(label, fontsize=9)
        ax.tick_params(labelsize=8)
        ax.xaxis.set_major_locator(MaxNLocator(5))
        if not finite.size:
            continue
        norm = LogNorm(finite.min(), max(finite.max(), 1.001 * finite.min()))
        masked = np.ma.masked_invalid(grid.reshape(size, size).T)
        picture = ax.pcolormesh(x, y, masked, norm=norm, cmap="viridis_r", shading="flat")
        unit = "relative" if number == "exposure_time" else "% of white"
        bar = figure.colorbar(picture, ax=ax, shrink=0.92)
        bar.set_label(unit, fontsize=8)
        _plain_log(bar.ax.yaxis, scale=False)
        bar.ax.tick_params(labelsize=8, which="both")
        for row, mark in _marked(rows, best):
            place = [float(row.values[name]) for name in (across, up)]
            if x[0] <= place[0] <= x[-1] and y[0] <= place[1] <= y[-1]:
                ax.plot(*place, ls="", clip_on=False, **mark)
    for ax in axes[-1]:
        ax.set_xlabel(across, fontsize=9)
    for ax in axes[:, 0]:
        ax.set_ylabel(up, fontsize=9)


def _draw_ranking(
    figure: Any,
    variation: Variation,
    rows: Sequence[Row],
    best: Row | None,
    shown: Sequence[tuple[str, str, float]],
) -> None:
    errors = [each for each in shown if each[0] != "exposure_time"]
    from matplotlib.ticker import MaxNLocator

    names, columns = variation.names, 3
    lines = -(-(len(names) + 1) // columns)
    figure.set_size_inches(3.2 * columns, 0.4 + 2.5 * lines)
    axes = figure.subplots(lines, columns, squeeze=False).ravel()
    order = np.argsort(np.where(np.isfinite(v := _figures(rows, "bound")), v, np.inf))
    for (number, label, factor), colour in zip(errors, OKABE_ITO, strict=False):
        values = factor * _figures(rows, number)
        axes[0].plot(1 + np.arange(len(rows)), values[order], ".", color=colour, label=label, ms=5)
        for ax, name in zip(axes[1:], names, strict=False):
            ax.plot([float(row.values[name]) for row in rows], values, ".", color=colour, ms=5)
            for row, mark in _marked(rows, best):
                value = row.figure(number)
                if value is not None and np.isfinite(value):
                    ax.plot(float(row.values[name]), factor * value, ls="", **mark)
            ax.set_xlabel(name, fontsize=9)
            ax.xaxis.set_major_locator(MaxNLocator(5))
    axes[0].set_xlabel("rank by the bound", fontsize=9)
    for ax in axes[: len(names) + 1]:
        _plain_log(ax.yaxis, most=MOST_DRAWN)
        ax.grid(True, which="major", color="0.9", lw=0.5)
        ax.tick_params(labelsize=8, which="both")
    for ax in axes[::columns]:
        ax.set_ylabel("% of white", fontsize=9)
    for ax in axes[len(names) + 1 :]:
        ax.set_axis_off()
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", fontsize=8,
        frameon=False, ncols=3,
    )  # fmt: skip


def _marked(rows: Sequence[Row], best: Row | None) -> list[tuple[Row, dict[str, Any]]]:
    marked = [(row, STANDS) for row in rows if row.number == AS_IT_STANDS]
    return [*marked, *([] if best is None else [(best, BEST)])]


def _figures(rows: Sequence[Row], number: str) -> Array:
    """Return a number of each row, NaN where there is none."""
    found = [row.figure(number) for row in rows]
    values = np.array([np.nan if each is None else each for each in found], float)
    return np.where(np.isfinite(values), values, np.nan)


def _edges(values: Array) -> Array:
    half = np.diff(values) / 2
    middles = values[:-1] + half
    return np.concatenate([[values[0] - half[0]], middles, [values[-1] + half[-1]]])


def _cell(values: Array, value: float) -> tuple[float, float]:
    if len(values) < 2:
        return value, value
    known = [as_text(each) for each in values]
    low, high = list(pairwise(_edges(values)))[known.index(as_text(value))]
    return float(low), float(high)


def _plain_log(axis: Any, *, scale: bool = True, most: float = np.inf) -> None:
    """Tick a logarithmic axis, up to `most`, with plain numbers, as many as there is room for."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if scale:
        axis.axes.set_yscale("log")
        low, high = axis.get_view_interval()
        axis.axes.set_ylim(low, min(high, max(most, 2 * low)))
    low, high = axis.get_view_interval()
    span = np.log10(max(high, 1e-300) / max(low, 1e-300))
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    if span < 0.7:
        from matplotlib.ticker import MaxNLocator

        axis.set_major_locator(MaxNLocator(4))
        axis.set_minor_locator(LogLocator(subs=()))
    else:
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if span < 2.5 else (1,)))
    axis.set_major_formatter(plain)
    axis.set_minor_formatter(NullFormatter())
