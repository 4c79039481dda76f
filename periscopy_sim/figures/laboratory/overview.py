"""The overview of a laboratory: a path-traced picture with the camera and its view drawn in."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.figures.laboratory.geometry import PANELS, drawn_box, hull, standing, world_axes
from periscopy_sim.figures.laboratory.labels import Labels
from periscopy_sim.figures.laboratory.projections import MONITOR, VIEWED
from periscopy_sim.rendering.overview import View, covered, find_view, render_overview
from periscopy_sim.rendering.survey import Survey
from periscopy_sim.rendering.variant import is_vectorized
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.storage.formats.srgb import srgb_encode

COLUMNS = {True: 640, False: 200}
"""Pixels of the picture's width; fewer where one ray is traced after the other."""


def draw_overview(ax: Any, scenario: Scenario, survey: Survey) -> None:
    """Show a path-traced picture, with the camera and what it sees drawn in."""
    from matplotlib.patches import Polygon

    ax.set_axis_off()
    low, high = drawn_box(survey)
    box = ax.get_window_extent()
    columns = COLUMNS[is_vectorized()]
    shape = (round(columns * box.height / box.width), columns)
    inside = [np.clip(s.points, low, high) for s in survey.solids]
    given = [survey.monitor_points, survey.view_points, survey.view_origins, *inside]
    normal = scenario.wall_normals.mean(axis=0)
    landmarks = np.concatenate(
        [
            # Before and behind: it may be seen from either side.
            scenario.patch_centers[::9] + 0.01 * scenario.patch_normals[::9],
            scenario.patch_centers[::9] - 0.01 * scenario.patch_normals[::9],
            survey.view_points + 0.01 * normal,
            *(s.points[:: max(1, len(s.points) // 8)] for s in survey.solids),
        ]
    )
    surfaces = [
        (survey.view_points[4], normal),
        (scenario.patch_centers.mean(axis=0), scenario.patch_normals.mean(axis=0)),
    ]
    view = find_view(survey, np.concatenate(given), landmarks, surfaces, shape, -normal)
    picture = render_overview(scenario, view)
    shown = covered(survey, view)[..., None]
    screen = hull(view.project(survey.monitor_points)[0])
    lit = (shown[..., 0] > 0.99) & ~_within(screen, shape)
    white = float(np.percentile(picture[lit], 98)) if lit.any() else 1.0
    ax.imshow(srgb_encode(np.clip(picture / white, 0, 1)) * shown + (1 - shown), aspect="equal")
    ax.set_title("overview", fontsize=9)
    labels = Labels(ax)
    outline, _ = view.project(survey.view_points[:4])
    ax.add_patch(Polygon(screen, fill=False, edgecolor=MONITOR, linewidth=1.2))
    ax.add_patch(Polygon(outline, fill=False, edgecolor=VIEWED, linewidth=1.2))
    for polygon in (screen, outline):
        labels.avoid_line(np.concatenate([polygon, polygon[:1]]))
    for start, end in zip(survey.view_origins[:4], survey.view_points[:4], strict=True):
        line, before = view.project(np.stack([start, end]))
        if before.all():
            ax.plot(*line.T, color=VIEWED, linewidth=0.5)
            labels.avoid_line(line)
    for text, where, colour in (
        ("camera", survey.view_origins[4], VIEWED),
        ("monitor", survey.monitor_points, MONITOR),
        ("seen by the camera", survey.view_points[:4], VIEWED),
    ):
        at, _ = view.project(np.atleast_2d(where))
        if text == "camera":
            ax.plot(*at[0], marker="o", markersize=5, color=colour)
        labels.add(text, at, colour, hollow=text == "seen by the camera")
    for solid in standing(survey, world_axes(scenario, survey), PANELS):
        labels.avoid(view.project(solid.points)[0])
    _draw_triad(ax, view)
    ax.set_xlim(0, shape[1])
    ax.set_ylim(shape[0], 0)
    labels.place()


def _draw_triad(ax: Any, view: View) -> None:
    """Draw the directions of x, y and z in the lower left corner."""
    width = view.shape[1]
    corner = np.array([0.09 * width, 0.9 * view.shape[0]])
    tips = corner + 0.08 * width * view.axes[:2].T * (1, -1)
    look = {"arrowstyle": "->", "lw": 1, "shrinkA": 0, "shrinkB": 0}
    for tip, place, name in zip(
        tips, letter_places(corner, tips, 0.028 * width), "xyz", strict=True
    ):
        ax.annotate("", tip, corner, arrowprops=look)
        ax.text(*place, name, fontsize=8, ha="center", va="center")


def letter_places(corner: Array, tips: Array, gap: float) -> Array:
    """Return where the letters of arrows from a corner to their tips (3, 2) stand.

    Each stands a gap beyond its tip, or turned about it, where that is farthest from all arrows and
    other letters: arrows that point at the viewer are short, and two may point alike.
    """
    along = np.linspace(corner, tips, 9)  # (9, 3, 2)
    found: list[Array] = []
    for tip in tips:
        ahead = np.arctan2(*(tip - corner)[::-1])
        angles = ahead + np.radians([0, 30, -30, 60, -60, 90, -90, 135, -135, 180])
        places = tip + gap * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        others = np.concatenate([along.reshape(-1, 2), *(each[None] for each in found)])
        apart = np.linalg.norm(places[:, None] - others, axis=2).min(axis=1)
        free = np.flatnonzero(apart >= 0.99 * gap)
        found.append(places[free[0] if free.size else int(apart.argmax())])
    return np.array(found)


def _within(outline: Array, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which pixels of a picture lie in a polygon, (rows, columns)."""
    from matplotlib.path import Path as Polyline

    row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    centres = np.stack([column + 0.5, row + 0.5], axis=1)
    return np.asarray(Polyline(outline).contains_points(centres, radius=2)).reshape(shape)
