"""The picture of a design: curves over one parameter, maps over two."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.evaluation.design import Row, values_of
from periscopy_sim.figures import style
from periscopy_sim.numerics import Array

Marked = Sequence[tuple[Row, str]]

DRAWN = {
    "bound": "Cramér-Rao bound",
    "reported_error": "reported error, noise-aware",
    "error": "actual error, noise-aware",
}
"""Numbers of a row that are drawn, in percent of white, and their titles."""

GREY = "0.85"
MARKS = {"o": "given scene", "*": "best", "s": "no scene, or\nundetermined patches"}

LOOK: dict[str, Any] = {"markeredgecolor": "black", "markerfacecolor": "white"}


def draw_design(
    path: Path,
    rows: Sequence[Row],
    best: Row | None,
    *,
    units: Mapping[str, str],
    caption: str = "",
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Draw the errors at a design's points, `run_design`'s, with the first and the best marked.

    The units are those of the parameters, by name.
    """
    shown = [name for name in DRAWN if any(row[name] is not None for row in rows)]
    marked = [(rows[0], "o")] + ([] if best is None else [(best, "*")])
    draw = _draw_curves if len(values_of(rows[0])) == 1 else _draw_maps
    words = {name: f"{name}, {units.get(name, 'scene unit')}" for name in values_of(rows[0])}
    with style.drawn(path, metadata, caption) as figure:
        draw(figure, rows, shown, marked, words)


def _marks() -> list[Any]:
    """Return the legend's entries of the marks."""
    grey = {"markeredgecolor": GREY, "markerfacecolor": GREY}
    return [
        style.mpl.lines.Line2D(
            [], [], ls="", marker=marker, label=label, **(grey if marker == "s" else LOOK)
        )
        for marker, label in MARKS.items()
    ]


def _draw_curves(
    figure: Any, rows: Sequence[Row], shown: Sequence[str], marked: Marked, words: Mapping[str, str]
) -> None:
    """Draw the errors over the parameter, in words with its unit."""
    figure.set_size_inches(style.COLUMN, 3.2)
    ax = figure.subplots()
    (name,) = values_of(rows[0])
    for number, colour in zip(shown, style.OKABE_ITO, strict=False):
        x, y = _values(rows[1:], name), _percent(rows[1:], number)
        ax.plot(x, y, "o-", color=colour, markersize=3, label=DRAWN[number])
        for row, marker in marked:
            ax.plot(_values([row], name), _percent([row], number), marker, **LOOK)
    for x in _values([row for row in rows[1:] if not np.isfinite(row["bound"] or np.nan)], name):
        ax.axvline(x, color=GREY, zorder=0)
    ax.set(xlabel=words[name], ylabel="standard error, % of white")
    ax.grid(True, axis="y")
    ax.xaxis.set_major_locator(style.mpl.ticker.MaxNLocator(5))
    if any(not np.isnan(style.positive(_percent(rows, number))).all() for number in shown):
        ax.set_yscale("log")
        style.plain_ticks(ax.yaxis)
    else:
        ax.set_yticks([])
    figure.legend(
        handles=[*ax.get_legend_handles_labels()[0], *_marks()], ncols=2, loc="outside upper center"
    )


def _draw_maps(
    figure: Any, rows: Sequence[Row], shown: Sequence[str], marked: Marked, words: Mapping[str, str]
) -> None:
    """Draw a map of each error over the two parameters, in words with their units."""
    across, up = values_of(rows[0])
    figure.set_size_inches(style.COLUMN, 2.7)
    (axes,) = figure.subplots(1, len(shown), sharey=True, squeeze=False)
    figure.legend(handles=_marks(), ncols=3, loc="outside upper center", columnspacing=1)
    x, y = (np.unique(_values(rows[1:], name)) for name in (across, up))
    for ax, number in zip(axes, shown, strict=True):
        ax.set(facecolor=GREY, title=style.wrapped(DRAWN[number], 2.9 / len(shown)))
        values = style.positive(_percent(rows[1:], number)).reshape(len(x), len(y)).T
        picture = ax.pcolormesh(x, y, values, norm=style.log_norm(values), cmap="viridis_r")
        if np.isnan(values).all():
            middle: Any = {"ha": "center", "va": "center", "transform": ax.transAxes}
            ax.text(0.5, 0.5, "no finite error\nabove 0", **middle)
        else:
            bar = figure.colorbar(picture, ax=ax, location="bottom", aspect=12, label="% of white")
            low, high = picture.get_clim()
            ends = [low, np.sqrt(low * high), high]
            bar.set_ticks(ends, labels=[f"{float(f'{each:.2g}'):g}" for each in ends], minor=False)
            bar.ax.minorticks_off()
        ax.set(xlim=ax.get_xlim(), ylim=ax.get_ylim())  # marks beyond are cut off
        ax.set_xticks(x[[0, -1]], [f"{each:.3g}".replace("-", "−") for each in x[[0, -1]]])
        for row, marker in marked:
            ax.plot(_values([row], across), _values([row], up), marker, **LOOK)
    axes[0].set_ylabel(words[up])
    axes[len(axes) // 2].set_xlabel(words[across])


def _values(rows: Sequence[Row], name: str) -> Array:
    return np.array([float(row[name]) for row in rows])


def _percent(rows: Sequence[Row], number: str) -> Array:
    """Return a number of each row in percent; NaN where it is missing or ten times white."""
    values = 100 * np.array([row[number] for row in rows], float)
    return np.where(values < 1000, values, np.nan)
