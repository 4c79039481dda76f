"""Pictures of a design: curves over one parameter, maps over two, points over more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.evaluation.design import Row
from periscopy_sim.figures.style import OKABE_ITO, drawn, plain_ticks

Array = NDArray[np.float64]
Marked = Sequence[tuple[Row, Mapping[str, Any]]]

DRAWN = {
    "bound": ("bound, without prior knowledge", 100.0),
    "told_error": ("reported error, noise-aware", 100.0),
    "error": ("actual error, noise-aware", 100.0),
    "exposure_time": ("exposure time for an equal bound", 1.0),
}
"""Numbers of a merit that are drawn, their titles, and their factors."""

FAILED = "0.85"
MARKS = (
    "circle: as it stands; star: best by what was asked; grey: no scene, or undetermined patches"
)
MARKERS: dict[str, dict[str, Any]] = {
    "as it stands": {"ls": "", "marker": "o", "mfc": "none", "mec": "black", "ms": 7, "mew": 1.4},
    "best": {"ls": "", "marker": "*", "mfc": "white", "mec": "black", "ms": 13, "mew": 1.0},
}


def draw_design(
    path: Path,
    rows: Sequence[Row],
    best: Row | None,
    grid: int | None,
    *,
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the merits of a design's points, the scene as it stands and the best marked.

    Errors are in percent of white. Rows are `run_design`'s, failed points are grey; `grid` is the
    number of values of each parameter, None for draws.
    """
    shown = [name for name in DRAWN if any(row[name] is not None for row in rows)]
    marked = [(rows[0], MARKERS["as it stands"])]
    if best is not None:
        marked.append((best, MARKERS["best"]))
    with drawn(path, metadata) as figure:
        if len(rows[0]["values"]) == 2 and grid is not None and grid > 1:
            _draw_maps(figure, rows, marked, shown, grid)
        else:
            _draw_curves(figure, rows, marked, shown)
        figure.supxlabel("\n".join(filter(None, (caption, MARKS))))


def _draw_curves(figure: Any, rows: Sequence[Row], marked: Marked, shown: Sequence[str]) -> None:
    """Draw the errors over each parameter, and below them the exposure time if there is one."""
    names = list(rows[0]["values"])
    is_curve, columns = len(names) == 1, min(len(names), 3)
    lines = 2 if is_curve else -(-len(names) // columns)
    figure.set_size_inches(5.6 if is_curve else 3.4 * columns, 0.6 + 2.5 * lines)
    grid = {"height_ratios": (2, 1), "sharex": True} if is_curve else {}
    axes = figure.subplots(lines, columns, squeeze=False, **grid).ravel()
    errors = [number for number in shown if number != "exposure_time"]
    panels = [(ax, name, errors) for ax, name in zip(axes, names, strict=False)]
    if is_curve:
        panels.append((axes[1], names[0], ["exposure_time"]))
    colours = dict(zip(DRAWN, OKABE_ITO, strict=False))
    for ax, name, numbers in panels:
        order = sorted(rows, key=lambda row: float(row["values"][name]))
        for number in numbers:
            look = {"color": colours[number], "label": DRAWN[number][0]}
            ax.plot(
                _values(order, name), _percent(order, number), "-o" if is_curve else ".", **look
            )
            for row, mark in marked:  # matplotlib leaves out NaN
                ax.plot(_values([row], name), _percent([row], number), **mark)
        if is_curve:
            edges = _edges(np.unique(_values(rows[1:], name)))
            for x in _values([row for row in rows if row["failure"]], name):
                cell = max(1, int(np.searchsorted(edges, x)))
                ax.axvspan(*edges[cell - 1 : cell + 1], color=FAILED, lw=0, zorder=0)
        ax.set_yscale("log")
        low, high = ax.get_ylim()
        if numbers == errors:  # above 300 % of white an image shows nothing
            ax.set_ylim(low, min(high, max(300.0, 2 * low)))
        ax.grid(True, which="major")
        plain_ticks(ax.yaxis)
        ax.locator_params(axis="x", nbins=5)
        ax.set_xlabel(name)
    for ax in axes[len(panels) :]:
        ax.set_axis_off()
    for ax in axes[::columns]:
        ax.set_ylabel("standard error of a patch,\n% of white")
    if is_curve:
        axes[0].set_xlabel("")
        axes[1].set_ylabel("exposure time for an\nequal bound, relative")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=1 if is_curve else 3)


def _draw_maps(
    figure: Any, rows: Sequence[Row], marked: Marked, shown: Sequence[str], size: int
) -> None:
    from matplotlib.colors import LogNorm

    across, up = rows[0]["values"]
    lines = -(-len(shown) // 2)
    figure.set_size_inches(7.6, 0.5 + 3.1 * lines)
    axes = figure.subplots(lines, 2, sharex=True, sharey=True, squeeze=False)
    x, y = (_edges(np.unique(_values(rows[1:], name))) for name in (across, up))
    for ax, number in zip(axes.flat, shown, strict=True):
        ax.set_facecolor(FAILED)
        ax.set_title(DRAWN[number][0])
        ax.locator_params(axis="x", nbins=5)
        values = np.ma.masked_invalid(_percent(rows[1:], number).reshape(size, size).T)
        if values.mask.all():
            continue
        norm = LogNorm(values.min(), max(values.max(), 1.001 * values.min()))
        picture = ax.pcolormesh(x, y, values, norm=norm, cmap="viridis_r", shading="flat")
        unit = "relative" if number == "exposure_time" else "% of white"
        plain_ticks(figure.colorbar(picture, ax=ax, shrink=0.92, label=unit).ax.yaxis)
        for row, mark in marked:
            h, v = (float(row["values"][name]) for name in (across, up))
            if x[0] <= h <= x[-1] and y[0] <= v <= y[-1]:
                ax.plot(h, v, clip_on=False, **mark)
    for ax in axes[-1]:
        ax.set_xlabel(across)
    for ax in axes[:, 0]:
        ax.set_ylabel(up)


def _values(rows: Sequence[Row], name: str) -> Array:
    return np.array([float(row["values"][name]) for row in rows])


def _percent(rows: Sequence[Row], number: str) -> Array:
    """Return a number of each row in its unit; NaN where it is missing or infinite."""
    values = DRAWN[number][1] * np.array([row[number] for row in rows], float)
    return np.where(np.isfinite(values), values, np.nan)


def _edges(values: Array) -> Array:
    """Return the edges of cells about ascending values."""
    half = np.diff(values) / 2 if len(values) > 1 else np.zeros(1)
    middles = values[:-1] + half[: len(values) - 1]
    return np.concatenate([[values[0] - half[0]], middles, [values[-1] + half[-1]]])
