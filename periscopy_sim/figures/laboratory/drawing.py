"""A laboratory drawn to scale: plan, side view, the wall with its shadows, and an overview."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.figures.laboratory.geometry import CHARACTERS, drawn_box, facts, world_axes
from periscopy_sim.figures.laboratory.overview import draw_overview
from periscopy_sim.figures.laboratory.projections import LINES, draw_projection, draw_wall
from periscopy_sim.rendering.survey import Survey
from periscopy_sim.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, DOTS = 10.0, 160
"""Inches, and pixels of each."""

LEFT, RIGHT, TOP, BOTTOM, BETWEEN, LINE = 0.62, 0.18, 0.34, 0.6, 0.62, 0.19
"""Inches about and between the panels, and of a line of text below them."""

LOWEST, TALLEST = 1.3, 5.5
"""Inches that a panel may be high."""


def draw_laboratory(
    path: Path, scenario: Scenario, *, metadata: Mapping[str, str] | None = None
) -> None:
    """Draw a scenario's laboratory to scale: see `laboratory_figure`.

    The metadata are text chunks of a PNG, such as provenance.
    """
    laboratory_figure(scenario).savefig(path, metadata=dict(metadata or {}))


def laboratory_figure(scenario: Scenario) -> Figure:
    """Return the figure that `draw_laboratory` saves.

    Three views at one scale, after the third-angle projection: the wall as the camera faces it,
    the side view beside it, the plan below. Grey is how much of the monitor a point of the wall
    sees. Below the side view stands a path-traced overview.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    survey = Survey(scenario)
    frame = world_axes(scenario, survey)
    low, high = drawn_box(survey)
    spans = (high - low)[list(frame.axes)]
    room = WIDTH - LEFT - RIGHT - BETWEEN
    scale = min(room / (spans[0] + spans[1]), TALLEST / spans[1], TALLEST / spans[2])
    sizes = np.maximum(scale * spans, LOWEST)
    ends = (low + high)[list(frame.axes)] / 2 + sizes / scale * np.array([[-0.5], [0.5]])
    ends[:, np.array(frame.signs) < 0] = ends[::-1, np.array(frame.signs) < 0]
    across, towards, up = map(float, sizes)
    lines = [*wrap(LINES, CHARACTERS), *facts(scenario, survey)]
    bottom = BOTTOM + LINE * len(lines)
    tall = TOP + up + BETWEEN + towards + bottom
    figure = Figure(figsize=(WIDTH, tall), dpi=DOTS)
    FigureCanvasAgg(figure)  # labels are placed by their size in pixels
    left = LEFT + max(0.0, (room - across - towards) / 2)

    def panel(x: float, y: float, width: float, height: float) -> Any:
        return figure.add_axes((x / WIDTH, y / tall, width / WIDTH, height / tall))

    wall = panel(left, bottom + towards + BETWEEN, across, up)
    side = panel(left + across + BETWEEN, bottom + towards + BETWEEN, towards, up)
    plan = panel(left, bottom, across, towards)
    picture = panel(left + across + BETWEEN - 0.1, bottom, towards + 0.1, towards)
    for ax, (h, v), title in (
        (wall, (0, 2), "the wall as the camera faces it; grey: part of the monitor is hidden"),
        (side, (1, 2), "from the side"),
        (plan, (0, 1), "plan"),
    ):
        ax.set_title(title, fontsize=9)
        ax.set_xlabel(frame.label(h), fontsize=8, labelpad=1)
        ax.set_ylabel(frame.label(v), fontsize=8, labelpad=1)
        ax.tick_params(labelsize=7)
        ax.set_xlim(*ends[:, h])
        ax.set_ylim(*ends[:, v])
        ax.set_aspect("equal")
    draw_wall(wall, scenario, survey, frame)
    draw_projection(side, scenario, survey, frame, (1, 2))
    draw_projection(plan, scenario, survey, frame, (0, 1))
    draw_overview(picture, scenario, survey)
    text = "\n".join(lines)
    foot = (bottom - BOTTOM + 0.12) / tall
    figure.text(LEFT / WIDTH, foot, text, fontsize=8, va="top", linespacing=1.5)
    return figure
