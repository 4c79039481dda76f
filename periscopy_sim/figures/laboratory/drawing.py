"""A laboratory drawn to scale: plan, side view, and the wall with its shadows."""

from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.figures.laboratory.geometry import CHARACTERS, RoomPlan, facts
from periscopy_sim.figures.laboratory.projections import LINES, draw_projection, draw_wall
from periscopy_sim.figures.style import STYLE
from periscopy_sim.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, TALLEST = 10.0, 5.5
"""Inches of the drawing's width, and that a panel may be high."""


def draw_laboratory(
    path: Path, scenario: Scenario, *, metadata: Mapping[str, str] | None = None
) -> None:
    """Draw a scenario's laboratory to scale: see `laboratory_figure`.

    The metadata are text chunks of a PNG, such as provenance.
    """
    laboratory_figure(scenario).savefig(path, metadata=dict(metadata or {}))


def laboratory_figure(scenario: Scenario) -> "Figure":
    """Return the figure that `draw_laboratory` saves.

    Three views at one scale, after the third-angle projection: the wall as the camera faces it,
    the side view beside it, the plan below. Grey is how much of the monitor a point of the wall
    sees.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    layout = RoomPlan(scenario)
    low, high, axes = layout.low, layout.high, [*layout.axes]
    spans = (high - low)[axes]
    spans = np.maximum(spans, spans.max() / 5)  # labels need room
    scale = min(0.86 * WIDTH / (spans[0] + spans[1]), TALLEST / spans[1], TALLEST / spans[2])
    ends = (low + high)[axes] / 2 + spans * np.array([[-0.5], [0.5]])
    ends[:, np.array(layout.signs) < 0] = ends[::-1, np.array(layout.signs) < 0]
    lines = [*wrap(LINES, CHARACTERS), *facts(layout)]
    height = scale * (spans[1] + spans[2]) + 1.3 + 0.19 * len(lines)
    with rc_context(STYLE | {"axes.spines.top": True, "axes.spines.right": True}):
        figure = Figure(figsize=(WIDTH, height), dpi=160)
        figure.set_layout_engine("constrained", h_pad=0.1)
        FigureCanvasAgg(figure)  # labels are placed by their size in pixels
        ratios: Any = {"width_ratios": spans[:2], "height_ratios": spans[:0:-1]}
        (wall, side), (plan, rest) = figure.subplots(2, 2, **ratios)
        for ax, (h, v), title in (
            (wall, (0, 2), "the wall as the camera faces it; grey: part of the monitor is hidden"),
            (side, (1, 2), "from the side"),
            (plan, (0, 1), "plan"),
        ):
            ax.set(title=title, xlabel=layout.label(h), ylabel=layout.label(v))
            ax.set(xlim=ends[:, h], ylim=ends[:, v], aspect="equal")
        rest.remove()
        figure.supxlabel("\n".join(lines), x=0.06, ha="left", linespacing=1.5)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # nothing moves once labels have their places
        draw_wall(wall, layout)
        draw_projection(side, layout, (1, 2))
        draw_projection(plan, layout, (0, 1))
    return figure
