"""The overview of a laboratory: a path-traced picture with the camera and its view drawn in."""

from __future__ import annotations

from typing import Any

import numpy as np

from periscopy_sim.figures.laboratory.geometry import RoomPlan, hull
from periscopy_sim.figures.laboratory.labels import Labels
from periscopy_sim.figures.laboratory.projections import MONITOR, VIEWED
from periscopy_sim.rendering.overview import covered, find_view, render_overview
from periscopy_sim.rendering.variant import is_vectorized
from periscopy_sim.storage.formats.srgb import srgb_encode

COLUMNS = {True: 640, False: 200}
"""Pixels of the picture's width; fewer where one ray is traced after the other."""


def draw_overview(ax: Any, layout: RoomPlan) -> None:
    """Show a path-traced picture, with the camera and its view drawn in."""
    from matplotlib.patches import Polygon
    from matplotlib.path import Path as Polyline

    scenario, survey, normal = layout.scenario, layout.survey, layout.normal
    box = ax.get_window_extent()
    columns = COLUMNS[is_vectorized()]
    shape = (round(columns * box.height / box.width), columns)
    inside = [np.clip(s.points, layout.low, layout.high) for s in survey.solids]
    corners = [survey.monitor_points, survey.view_points, survey.view_origins, *inside]
    patches, facing = scenario.patch_centers[::9], scenario.patch_normals[::9]
    landmarks = [
        patches + 0.01 * facing,
        patches - 0.01 * facing,  # the monitor may be seen from either side
        survey.view_points + 0.01 * normal,
        *(s.points[:: max(1, len(s.points) // 8)] for s in survey.solids),
    ]
    surfaces = [
        (layout.middle, normal),
        (scenario.patch_centers.mean(axis=0), scenario.patch_normals.mean(axis=0)),
    ]
    view = find_view(
        survey, np.concatenate(corners), np.concatenate(landmarks), surfaces, shape, -normal
    )
    picture, shown = render_overview(scenario, view), covered(survey, view)[..., None]
    screen = hull(view.project(survey.monitor_points)[0])
    centres = np.indices(shape)[::-1].reshape(2, -1).T + 0.5
    on_screen = Polyline(screen).contains_points(centres, radius=2).reshape(shape)
    lit = (shown[..., 0] > 0.99) & ~on_screen
    white = float(np.percentile(picture[lit], 98)) if lit.any() else 1.0
    ax.imshow(srgb_encode(np.clip(picture / white, 0, 1)) * shown + (1 - shown), aspect="equal")
    labels = Labels(ax)
    outline, _ = view.project(survey.view_points[:4])
    for polygon, colour in ((screen, MONITOR), (outline, VIEWED)):
        ax.add_patch(Polygon(polygon, fill=False, edgecolor=colour, linewidth=1.2))
        labels.avoid_line(np.concatenate([polygon, polygon[:1]]))
    for start, end in zip(survey.view_origins[:4], survey.view_points[:4], strict=True):
        line, before = view.project(np.stack([start, end]))
        if before.all():
            ax.plot(*line.T, color=VIEWED, linewidth=0.5)
            labels.avoid_line(line)
    camera, _ = view.project(survey.view_origins[4:5])
    ax.plot(*camera[0], marker="o", markersize=5, color=VIEWED)
    labels.add("camera", camera, VIEWED)
    labels.add("monitor", view.project(survey.monitor_points)[0], MONITOR)
    labels.add("seen by the camera", outline, VIEWED, hollow=True)
    for solid in layout.standing():
        labels.avoid(view.project(solid.points)[0])
    ax.set(xlim=(0, shape[1]), ylim=(shape[0], 0))
    labels.place()
