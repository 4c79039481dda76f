"""What a drawing of a laboratory shows, and how its things are named and measured."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.survey import Solid, Survey
from periscopy_sim.scenario import Array, Scenario

FARTHEST = 1.0
"""Times the size of camera, monitor and view: what reaches farther from their middle (a floor, a
room) is drawn where it is in sight."""

COVERING = 0.15
"""Part of a panel: what covers more is drawn as its ground."""

PANELS = (0, 1), (1, 2)
"""Axes of the plan and the side view, by their places in `WorldAxes`."""

MOST_TOLD, CHARACTERS = 5, 138
"""Occluders whose distances are told, and characters of a line."""


NO_BREAK = "\N{NO-BREAK SPACE}"


@dataclass(frozen=True)
class WorldAxes:
    """World axes as panels show them: across the wall, towards it, up; with their directions.

    `signs` are -1 where the axis runs to the left (across), or away from the wall (towards).
    """

    axes: tuple[int, int, int]
    signs: tuple[int, int, int]

    def label(self, k: int) -> str:
        """Return the name of an axis, and its unit."""
        return f"{'xyz'[self.axes[k]]} / m"


def world_axes(scenario: Scenario, survey: Survey) -> WorldAxes:
    """Take the world's axes; depth is the horizontal one along which the wall is faced.

    A wall that lies more than it stands is a `SceneError`.
    """
    ahead = -scenario.wall_normals.mean(axis=0)
    depth = int(np.argmax(np.abs(ahead[:2])))
    if abs(ahead[depth]) < abs(ahead[2]):
        raise SceneError(
            f"scene '{scenario.path}': its wall lies; only one that stands (z up) can be drawn"
        )
    rightwards = (survey.view_points[1] - survey.view_points[0])[1 - depth]
    return WorldAxes(
        (1 - depth, depth, 2), (1 if rightwards >= 0 else -1, 1 if ahead[depth] >= 0 else -1, 1)
    )


def drawn_box(survey: Survey) -> tuple[Array, Array]:
    """Return the box of what is to be drawn, with a margin."""
    core = np.concatenate([survey.view_origins, survey.view_points, survey.monitor_points])
    size = float(np.max(np.ptp(core, axis=0)))
    middle = (core.min(axis=0) + core.max(axis=0)) / 2
    kept = [
        solid.points
        for solid in survey.solids
        if np.abs(solid.points - middle).max() < FARTHEST * size
    ]
    points = np.concatenate([core, *kept])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.09 * float(np.max(high - low))
    return low - margin, high + margin


def standing(survey: Survey, axes: WorldAxes, shown: Sequence[tuple[int, int]]) -> list[Solid]:
    """Return the solids that cover little of every panel shown, unlike tables, floors and walls.

    A panel shows two of the axes, by their places in `WorldAxes`.
    """
    low, high = drawn_box(survey)
    found = []
    for solid in survey.solids:
        inside = np.minimum(solid.points.max(axis=0), high)
        inside = np.maximum(inside - np.maximum(solid.points.min(axis=0), low), 0) / (high - low)
        if all(inside[axes.axes[h]] * inside[axes.axes[v]] < COVERING for h, v in shown):
            found.append(solid)
    return found


def groups_of(solids: Sequence[Solid]) -> dict[str, Array]:
    """Return points of the solids by name; those whose names share their first words are one."""
    names = [solid.name for solid in solids]
    stems = [[name[: end.start()] for end in re.finditer("_", name)] for name in names]
    count = Counter(stem for each in stems for stem in each)
    groups: dict[str, list[Array]] = {}
    for solid, each in zip(solids, stems, strict=True):
        shared = (stem for stem in each if count[stem] > 1 and stem not in names)
        groups.setdefault(next(shared, solid.name), []).append(solid.points)
    return {name: np.concatenate(points) for name, points in groups.items()}


def facts(scenario: Scenario, survey: Survey) -> list[str]:
    """Return lines of distances and sizes."""
    normal = scenario.wall_normals.mean(axis=0)
    normal /= np.linalg.norm(normal)
    middle = survey.view_points[4]
    corners = survey.view_points[:4]
    wide = (np.linalg.norm(corners[1] - corners[0]) + np.linalg.norm(corners[2] - corners[3])) / 2
    high = (np.linalg.norm(corners[3] - corners[0]) + np.linalg.norm(corners[2] - corners[1])) / 2
    sight = survey.view_origins[4] - middle
    away = float(np.linalg.norm(sight))
    slant = np.degrees(np.arccos(np.clip(sight @ normal / away, -1, 1)))
    aim = "" if survey.parallel else f" ({turn_and_tilt(-sight, -normal)})"
    across, up = _monitor_size(scenario)
    before = float((scenario.patch_centers.mean(axis=0) - middle) @ normal)
    facing = turn_and_tilt(scenario.patch_normals.mean(axis=0), -normal)
    where = (
        "parallel rays, as of a picture that was brought to the wall's own rectangle"
        if survey.parallel
        else f"{in_words(away)} from the wall along its line of sight"
    )
    seen = f"{in_words(float(wide))} x {in_words(float(high))}"
    lines = [
        f"Camera: {where}, {slant:.0f}° off its normal{aim}; sees {seen} of it.",
        f"Monitor: {in_words(across)} x {in_words(up)}, {in_words(before)} before the wall, "
        f"{facing} from facing it squarely.",
        "Turns are counterclockwise as seen from above, tilts upwards; negative the other way.",
    ]
    told = []
    frame = world_axes(scenario, survey)
    solids = standing(survey, frame, PANELS)
    for name, points in groups_of(solids).items():
        heights = (points - middle) @ normal
        distance = float(heights.min() + heights.max()) / 2
        if 0 < distance < before:
            stretch = distance / (before - distance)
            penumbra = f"{in_words(across * stretch, 2)} x {in_words(up * stretch, 2)}"
            told.append(f"{name} {in_words(distance)} ({penumbra})".replace(" ", NO_BREAK))
    if told:
        shown = ", ".join(told[:MOST_TOLD]) + (", ..." if told[MOST_TOLD:] else "")
        lines.append(
            "Middles before the wall (and how wide an edge's penumbra is from there, across x up): "
            f"{shown}."
        )
    sizes = [
        f"{name} {' x '.join(map(in_words, np.ptp(points, axis=0)[list(frame.axes)]))}".replace(
            " ", NO_BREAK
        )
        for name, points in groups_of(
            [*solids, *(s for s in survey.solids if s not in solids)]
        ).items()
    ]
    if sizes:
        shown = ", ".join(sizes[:MOST_TOLD]) + (", ..." if sizes[MOST_TOLD:] else "")
        axes = ", ".join("xyz"[axis] for axis in frame.axes)
        lines.append(f"Extents along {axes}: {shown}.")
    return [line for long in lines for line in wrap(long, CHARACTERS)]


def _monitor_size(scenario: Scenario) -> tuple[float, float]:
    rows, columns = scenario.hidden_shape
    across = np.linalg.norm(scenario.patch_across, axis=1).mean() * columns
    return float(across), float(np.linalg.norm(scenario.patch_up, axis=1).mean() * rows)


def turn_and_tilt(direction: Array, ahead: Array) -> str:
    """Return by which angles a direction is turned and tilted from another, in words.

    The turn is about the vertical, counterclockwise from above, the tilt upwards from there.
    """
    turn = np.arctan2(direction[1], direction[0]) - np.arctan2(ahead[1], ahead[0])
    tilts = [np.arctan2(each[2], np.hypot(each[0], each[1])) for each in (direction, ahead)]
    turned = (np.degrees(turn) + 180) % 360 - 180
    told = [round(float(each), 1) + 0.0 for each in (turned, np.degrees(tilts[0] - tilts[1]))]
    return f"turned {told[0]:g}°, tilted {told[1]:g}°"


def in_words(length: float, digits: int = 3) -> str:
    """Return a length, in metres, as a person writes it."""
    if 0 < length < 0.00995:
        return f"{1000 * length:.{digits}g} mm"
    return f"{length:.2f} m" if length >= 0.995 else f"{100 * length:.{digits}g} cm"


def hull(points: Array) -> Array:
    """Return the corners of the convex hull of points in a plane; of a line its two ends."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return points[list(extremes(points))]


def extremes(points: Array) -> tuple[int, int]:
    """Return which two of points in a plane lie farthest out, where they reach farthest."""
    along = (points - points.mean(axis=0)) @ _direction(points)
    return int(np.argmin(along)), int(np.argmax(along))


def _direction(points: Array) -> Array:
    values, axes = np.linalg.eigh(np.cov(points.T))
    return np.asarray(axes[:, np.argmax(values)])
