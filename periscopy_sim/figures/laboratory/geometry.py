"""The things that a drawing of a laboratory shows, their names and their measures."""

import re
from collections import Counter
from collections.abc import Iterable

import numpy as np

from periscopy_sim.figures.style import NO_BREAK
from periscopy_sim.hidden import Surface
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.survey import Solid, Survey
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import MONITOR

FARTHEST = 4.0
"""Times the size of camera, monitor and view, from their middle, up to which occluders that are
smaller than this size are in sight; of larger ones, such as a floor, up to one size."""

COVERING = 0.15
"""Fraction of a panel; a thing that covers more is drawn as its ground."""

FLAT = 0.9999
"""Length of the mean normal of a surface that counts as flat; a curved one has a shorter."""

EVEN = 0.01
"""Standard deviation of the middles of a curved surface's parts, over their radius, up to which
these are one: facets turn their normals."""

TOUCHING = 1e-3
"""Metres from the wall up to which a thing stands on it."""


class RoomPlan:
    """A scenario's laboratory along the world's axes: across the picture, the other level one, up.

    `axes` are the three axes' numbers, `wall` the places of the two along the wall, and `others`
    those of the other two panels. Where the wall stands, the second axis runs towards it; where it
    lies, to the picture's top. `signs` are -1 where an axis runs the other way in the drawing. The
    wall's `normal`, the view's `middle` on it, the camera's `eye`, and the drawing's corners `low`
    and `high` are (3,).
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario, self.survey = scenario, Survey(scenario)
        survey = self.survey
        normal = scenario.view.center_normals.mean(axis=0)
        self.normal: Array = normal / np.linalg.norm(normal)
        self.middle, self.eye = survey.view_points[4], survey.view_origins[4]
        top_left, top_right, _, bottom_left, _ = survey.view_points
        self.lies = bool(np.abs(normal[2]) > np.abs(normal[:2]).max())
        facing = top_left - bottom_left if self.lies else -normal
        rightwards = top_right - top_left
        # The level axis that runs along the picture, or else the one that does not face the wall.
        across = int(np.argmax(np.abs(rightwards[:2] if self.lies else normal[1::-1])))
        self.axes = across, 1 - across, 2
        self.wall, *self.others = (
            [(0, 1), (0, 2), (1, 2)] if self.lies else [(0, 2), (1, 2), (0, 1)]
        )
        signs = rightwards[across] >= 0, facing[1 - across] >= 0, True
        self.signs = [1 if each else -1 for each in signs]
        hidden = np.concatenate([each.reshape(-1, 3) for each in survey.corners.values()])
        core = np.concatenate([survey.view_origins, survey.view_points, hidden])
        size = float(np.max(np.ptp(core, axis=0)))
        middle = (core.min(axis=0) + core.max(axis=0)) / 2
        points = core
        for each in (solid.points for solid in survey.solids):
            # Large things, as floors and walls, are cut at the frame, and do not widen it.
            reach = size if np.ptp(each, axis=0).max() > size else FARTHEST * size
            if np.abs(each - middle).max() < reach:
                points = np.concatenate([points, each])
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.09 * float(np.max(high - low))
        self.low, self.high = low - margin, high + margin

    def label(self, k: int) -> str:
        """Return the name of an axis, and its unit."""
        return f"{'xyz'[self.axes[k]]} / m"

    def occluders(self) -> dict[str, Array]:
        """Return the middle of each occluder that stands off the wall, (3,), by name."""
        middles = {}
        for name, points in groups_of(self.standing()).items():
            if ((points - self.middle) @ self.normal).min() > TOUCHING:
                middles[name] = (points.min(axis=0) + points.max(axis=0)) / 2
        return middles

    def distance(self, point: Array) -> float:
        """Return how far a point, (3,), is from the wall's plane."""
        return float((point - self.middle) @ self.normal)

    def standing(self, *panels: tuple[int, int]) -> list[Solid]:
        """Return the solids that cover little of every panel, unlike tables, floors and walls.

        A panel shows two of the axes, by their places; without any, `others`.
        """

        def is_small(solid: Solid) -> bool:
            ends = np.clip(
                [solid.points.min(axis=0), solid.points.max(axis=0)], self.low, self.high
            )
            part = ((ends[1] - ends[0]) / (self.high - self.low))[[*self.axes]]
            return all(part[h] * part[v] < COVERING for h, v in panels or self.others)

        return list(filter(is_small, self.survey.solids))


def groups_of(solids: Iterable[Solid]) -> dict[str, Array]:
    """Return points of the solids by name; solids whose names share their first words are one."""
    points = {solid.name: solid.points for solid in solids}
    stems = {n: [n[: end.start()] for end in re.finditer("_", n)] for n in points}
    count = Counter(stem for each in stems.values() for stem in each)
    groups: dict[str, list[Array]] = {}
    for name, each in stems.items():
        shared = (stem for stem in each if count[stem] > 1 and stem not in points)
        groups.setdefault(next(shared, name), []).append(points[name])
    return {name: np.concatenate(parts) for name, parts in groups.items()}


def facts(layout: RoomPlan) -> list[str]:
    """Return sentences of distances and sizes."""
    scenario, survey, normal = layout.scenario, layout.survey, layout.normal
    corners = survey.view_points[:4]
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    sight = layout.eye - layout.middle
    away = float(np.linalg.norm(sight))
    slant = np.degrees(np.arccos(np.clip(sight @ normal / away, -1, 1)))
    where, aim = "parallel rays (a rectified picture of the wall)", ""
    if not survey.parallel:
        where = f"{in_words(away)} from the wall along its line of sight"
        aim = "" if layout.lies else f" ({turn_and_tilt(-sight, -normal)})"
    lines = [
        f"Camera: {where}, {slant:.0f}° off its normal{aim}; sees "
        f"{in_words((sides[0] + sides[2]) / 2)} x {in_words((sides[1] + sides[3]) / 2)} of it.",
    ]
    flat = []
    for name, surface in scenario.hidden.items():
        (rows, columns), known = surface.shape, "Monitor" if name == MONITOR else name
        facing = surface.normals.mean(axis=0)
        if np.linalg.norm(facing) < FLAT:  # its distance may be a choice, so none is printed
            lines.append(f"{known}: {_sphere(surface, survey.corners[name]) or 'curved'}.")
            continue
        wide = columns * np.linalg.norm(surface.across, axis=1).mean()
        high = rows * np.linalg.norm(surface.up, axis=1).mean()
        before = layout.distance(surface.centers.mean(axis=0))
        flat.append((before, wide, high))
        turned = turn_and_tilt(facing, -normal)
        if layout.lies:
            turned = f"{np.degrees(np.arccos(np.clip(-facing @ normal, -1, 1))):.0f}°"
        lines.append(
            f"{known}: {in_words(wide)} x {in_words(high)}, {in_words(before)} from the wall, "
            f"{turned} from facing it squarely."
        )
    if not layout.lies:
        lines.append(
            "Positive turns are counterclockwise as seen from above, positive tilts upwards."
        )
    distances = []
    before, wide, high = flat[0] if flat else (np.inf, 0, 0)
    for name, middle in layout.occluders().items():
        if (distance := layout.distance(middle)) < before:
            # By similar triangles an edge at d before the wall, of a monitor at D, casts a penumbra
            # d / (D - d) times as wide as the monitor.
            stretch = distance / (before - distance)
            penumbra = f" ({in_words(wide * stretch, 2)} x {in_words(high * stretch, 2)})"
            own = f"{name} {in_words(distance)}{penumbra if flat else ''}"
            distances.append(own.replace(" ", NO_BREAK))
    if distances:
        what = " (and width x height of the penumbra of an edge)" if flat else ""
        lines.append(f"Distance of occluders from the wall{what}: {', '.join(distances)}.")
    return lines


def _sphere(surface: Surface, corners: Array) -> str:
    """Return the middle, radius and directions of a part of a sphere; empty of another form."""
    facing, centers = surface.normals, surface.centers
    even = facing - facing.mean(axis=0)
    radius = -float(np.sum(even * centers) / np.sum(even**2))
    middles = centers + radius * facing
    if middles.std(axis=0).max() > EVEN * abs(radius):
        return ""
    middle = middles.mean(axis=0)
    x, y, z = np.moveaxis(corners - middle, -1, 0)
    angles = np.unwrap(np.arctan2(y, x)), np.arctan2(z, np.hypot(x, y))
    ends = [np.degrees([each.min(), each.max()]).round().astype(int) for each in angles]
    ends[0] -= 360 * (ends[0][0] // 360) * (ends[0][1] >= 360)
    names = "azimuth from x", "elevation"
    ways = ", ".join(f"{n} {low} to {high}°" for n, (low, high) in zip(names, ends, strict=True))
    place = ", ".join(f"{each + 0.0:.2f}" for each in middle.round(2))
    return f"{ways} of a sphere about ({place}) m, of {abs(radius):.2g} m radius"


def turn_and_tilt(direction: Array, ahead: Array) -> str:
    """Return the angles by which a direction is turned and tilted from another, in words.

    The turn is about the vertical, counterclockwise from above, the tilt upwards from there.
    """
    turn = np.arctan2(direction[1], direction[0]) - np.arctan2(ahead[1], ahead[0])
    tilts = [np.arctan2(each[2], np.hypot(each[0], each[1])) for each in (direction, ahead)]
    angles = (np.degrees(turn) + 180) % 360 - 180, np.degrees(tilts[0] - tilts[1])
    turned, tilted = (round(float(angle), 1) + 0.0 for angle in angles)
    return f"turned {turned:g}°, tilted {tilted:g}°"


def in_words(length: float, digits: int = 3) -> str:
    """Return a length, in metres, as a person writes it."""
    if 0 < length < 0.00995:
        return f"{1000 * length:.{digits}g} mm"
    return f"{length:.2f} m" if length >= 0.995 else f"{100 * length:.{digits}g} cm"


def border(corners: Array) -> Array:
    """Return the border, (n, ...), of a grid of points, (rows, columns, ...), once around it."""
    sides = corners[0, :-1], corners[:-1, -1], corners[-1, :0:-1], corners[:0:-1, 0]
    return np.concatenate(sides)


def hull(points: Array) -> Array:
    """Return the corners of the convex hull of points in a plane; of a line its two ends."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return extremes(points)


def extremes(points: Array) -> Array:
    """Return the two of points in a plane, (n, 2), that lie farthest out along their length."""
    values, axes = np.linalg.eigh(np.cov(points.T))
    along = (points - points.mean(axis=0)) @ axes[:, np.argmax(values)]
    return np.asarray(points[[np.argmin(along), np.argmax(along)]])
