"""A laboratory's wall, plan and side view, to scale."""

from typing import Any

import numpy as np

from periscopy_sim.figures.laboratory.geometry import (
    RoomPlan,
    extremes,
    groups_of,
    hull,
)
from periscopy_sim.figures.laboratory.labels import Labels
from periscopy_sim.figures.style import OKABE_ITO
from periscopy_sim.scenario import Array

VIEWED, MONITOR, *_ = OKABE_ITO
OCCLUDER, GROUND = "0.25", "0.93"

GRID = 150
"""Points of the wall along its panel's width."""

LINES = (
    "Dotted: where shadows begin on the wall; solid: where all of the monitor is hidden; dashed: "
    "rays from its ends past occluders."
)
"""Meaning of the lines without a label."""


def draw_wall(ax: Any, layout: RoomPlan) -> None:
    """Show how much of the monitor each point of the wall sees, and the camera's view."""
    from matplotlib.patches import Polygon

    survey, h, v = layout.survey, layout.axes[0], layout.axes[2]
    limits = ax.get_xlim(), ax.get_ylim()
    (left, right), (bottom, top) = map(sorted, limits)
    x = np.linspace(left, right, GRID)
    z = np.linspace(bottom, top, max(2, round(GRID * (top - bottom) / (right - left))))
    share = _share(layout, x, z)
    ax.imshow(
        share, origin="lower", extent=(left, right, bottom, top), cmap="gray", vmin=0, vmax=1,
        interpolation="bilinear", zorder=0, alpha=2 / 3,  # full shadow stays grey, lines legible
    )  # fmt: skip
    if np.ptp(share) > 0.05:
        ax.contour(x, z, share, levels=[0.02], colors="black", linewidths=0.8)
        ax.contour(x, z, share, levels=[0.98], colors="black", linewidths=0.6, linestyles=":")
    labels = Labels(ax)
    for outline, colour, style, text in (
        (survey.view_points[:4][:, [h, v]], VIEWED, "-", "seen by the camera"),
        (hull(survey.monitor_points[:, [h, v]]), MONITOR, "--", "monitor"),
    ):
        ax.add_patch(Polygon(outline, fill=False, edgecolor=colour, linewidth=1.2, linestyle=style))
        labels.avoid_line(np.concatenate([outline, outline[:1]]))
        labels.add(text, outline, colour, hollow=True)
    ax.set(xlim=limits[0], ylim=limits[1])
    labels.place()


def draw_projection(ax: Any, layout: RoomPlan, shown: tuple[int, int]) -> None:
    """Draw everything onto two axes: camera and view, monitor, occluders, shadows."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Polygon

    scenario, survey = layout.scenario, layout.survey
    h, v = (layout.axes[k] for k in shown)
    limits = ax.get_xlim(), ax.get_ylim()
    labels = Labels(ax)
    middle, eye, normal = layout.middle, layout.eye, layout.normal
    cone = np.concatenate([survey.view_origins[:4], survey.view_points[:4]])[:, [h, v]]
    ax.add_patch(Polygon(hull(cone), facecolor=VIEWED, alpha=0.12, linewidth=0, zorder=1))
    _draw_wall_line(ax, labels, layout, (h, v))
    seen = extremes(survey.view_points[:4][:, [h, v]])
    ax.plot(*seen.T, color=VIEWED, linewidth=3, solid_capstyle="butt", zorder=4)
    upright = layout.standing(shown)
    _draw_shadow_rays(ax, layout, (h, v))
    for solid in survey.solids:
        corners = solid.points[:, [h, v]]
        outlines = [hull(corners)] if solid.faces is None else list(corners[solid.faces])
        colour, depth = (OCCLUDER, 5.0) if solid in upright else (GROUND, 0.5)
        look: dict[str, Any] = {"facecolor": colour, "edgecolor": colour, "linewidth": 0.4}
        ax.add_collection(PolyCollection(outlines, zorder=depth, **look))
    for name, points in groups_of(upright).items():
        labels.add(name, points[:, [h, v]], "black")
    monitor = hull(survey.monitor_points[:, [h, v]])
    ax.add_patch(Polygon(monitor, facecolor=MONITOR, edgecolor=MONITOR, linewidth=2.4, zorder=6))
    labels.add("monitor", monitor, MONITOR)
    size = 0.05 * float(np.ptp(limits[0]) + np.ptp(limits[1]))
    screen, facing = scenario.patch_centers.mean(axis=0), scenario.patch_normals.mean(axis=0)
    shortened = min(1.0, size / float(np.linalg.norm(middle - eye))) * (middle - eye)
    for start, direction, colour in (
        (screen, size * facing, MONITOR), (middle, size * normal, "0.45"), (eye, shortened, VIEWED)
    ):  # fmt: skip
        ends = np.stack([start, start + direction])[:, [h, v]]
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": 1, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", ends[1], ends[0], arrowprops=arrow, zorder=7, annotation_clip=False)
        labels.avoid_line(ends)
    labels.add("normal", (middle + size * normal)[None, [h, v]], "0.45")
    ax.plot(*eye[[h, v]], marker="o", markersize=5, color=VIEWED, zorder=7)
    labels.add("camera", eye[None, [h, v]], VIEWED)
    labels.avoid_line(seen)
    ax.set(xlim=limits[0], ylim=limits[1])
    labels.place()


def _draw_wall_line(ax: Any, labels: Labels, layout: RoomPlan, axes: tuple[int, int]) -> None:
    """Draw where the wall's plane meets the panel's: through the view's middle, to the ends."""
    middle, normal = layout.middle[[*axes]], layout.normal[[*axes]]
    along = np.array([-normal[1], normal[0]]) / np.linalg.norm(normal)
    reach = float(np.ptp(ax.get_xlim()) + np.ptp(ax.get_ylim()))
    line = middle + np.linspace(-reach, reach, 200)[:, None] * along
    ax.plot(*line.T, color="black", linewidth=0.8, zorder=3)
    (left, right), (bottom, top) = sorted(ax.get_xlim()), sorted(ax.get_ylim())
    inside = line[((line > (left, bottom)) & (line < (right, top))).all(axis=1)]
    # The label stands by the end that is farther from the view.
    far = inside[[0, -1]][np.argmax(np.linalg.norm(inside[[0, -1]] - middle, axis=1))]
    labels.add("wall", far[None], "black")
    labels.avoid_line(line[[0, -1]])


def _share(layout: RoomPlan, x: Array, z: Array) -> Array:
    """Return the share of the monitor that points of the wall's plane see, (z, x)."""
    normal, middle = layout.normal, layout.middle
    grid = np.empty((len(z), len(x), 3))
    h, d, v = layout.axes
    grid[..., h], grid[..., v] = x, z[:, None]
    slope = (grid[..., h] - middle[h]) * normal[h] + (grid[..., v] - middle[v]) * normal[v]
    grid[..., d] = middle[d] - slope / normal[d]
    points = grid.reshape(-1, 3) + 1e-4 * normal
    share = layout.survey.lit_share(points, layout.scenario.patch_centers)
    return share.reshape(len(z), len(x))


def _draw_shadow_rays(ax: Any, layout: RoomPlan, axes: tuple[int, int]) -> None:
    """Draw the rays from the monitor's ends that just pass the occluders, up to the wall."""
    middle, normal, monitor = layout.middle, layout.normal, layout.survey.monitor_points
    points = np.concatenate([np.zeros((0, 3)), *(solid.points for solid in layout.standing())])
    height = (points - middle) @ normal
    before = ((monitor - middle) @ normal).min()
    points = points[(height > 1e-3) & (height < before - 1e-3)][:, axes]
    wall, facing = middle[[*axes]], normal[[*axes]]
    for end in extremes(monitor[:, axes]):
        to = points - end
        hits = end + ((wall - end) @ facing / (to @ facing))[:, None] * to
        along = hits @ np.array([-facing[1], facing[0]])
        for extreme in (np.argmin(along), np.argmax(along)) if len(along) else ():
            ray = np.stack([end, hits[extreme]])
            ax.plot(*ray.T, color="0.55", linewidth=0.6, linestyle="--", zorder=2)
