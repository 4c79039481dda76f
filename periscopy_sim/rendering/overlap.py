"""Occluders that stand in each other, where no two bodies can.

Light is blocked by both together, so that nothing that is rendered is wrong. Parts of one body may
be joined so, a chair's legs and its seat; two bodies cannot. So it is a doubt, not an error.
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import permutations

import numpy as np
from scipy.spatial import Delaunay, QhullError

from periscopy_sim.rendering.survey import Solid, Survey
from periscopy_sim.scenario import Array, Scenario

POINTS = 512
"""On each occluder's surface, by which is told how much of it lies in another."""

SHRUNK = 1e-3
"""Of its size by which an occluder is shrunk about its middle first: it may touch another."""

WITHIN = 0.5
"""Winding number from which on a point is within: it is 1 there and 0 outside."""

LARGEST = 1 << 24
"""Triangles times points that are looked at for a pair; of finer meshes fewer points are."""

CHUNK = 1 << 18
"""Of them at once."""

NAMED = 3
"""Pairs that are told of."""


def overlaps(scenario: Scenario) -> dict[tuple[str, str], float]:
    """Return how much of an occluder's surface lies in another, by their names; where any does."""
    solids = Survey(scenario).solids
    return {
        (one.name, other.name): share
        for one, other in permutations(solids, 2)
        if _boxes_meet(one, other) and (share := _share_within(one, other)) > 0
    }


def overlap_doubt(scenario: Scenario, but: Collection[tuple[str, str]] = ()) -> str:
    """Return which occluders stand in each other; empty where none do, `but` those pairs."""
    pairs = {tuple(sorted(pair)) for pair in overlaps(scenario)}
    pairs -= {tuple(sorted(pair)) for pair in but}
    listed = [f"'{one}' and '{other}'" for one, other in sorted(pairs)]
    more = [f"{len(listed) - NAMED} more pairs"] if len(listed) > NAMED else []
    return f"{', '.join(listed[:NAMED] + more)} stand in each other" if listed else ""


def swallowed(scenario: Scenario) -> list[str]:
    """Return a line for each occluder that lies wholly within another, so casts no shadow."""
    return [
        f"occluder '{one}' lies within '{other}', and so casts no shadow of its own"
        for (one, other), share in overlaps(scenario).items()
        if share == 1
    ]


def _boxes_meet(one: Solid, other: Solid) -> bool:
    low, high = one.points.min(axis=0), one.points.max(axis=0)
    return bool((low < other.points.max(axis=0)).all() and (high > other.points.min(axis=0)).all())


def _share_within(one: Solid, other: Solid) -> float:
    count = 1 if other.faces is None else len(other.faces)
    points = _surface_points(one, min(POINTS, max(8, LARGEST // count)))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    points = middle + (1 - SHRUNK) * (points - middle)
    if other.faces is None:
        try:
            return float(np.mean(Delaunay(other.points).find_simplex(points) >= 0))
        except QhullError:  # a flat one holds nothing
            return 0.0
    return float(np.mean(winding_number(points, other.points[other.faces]) > WITHIN))


def _surface_points(solid: Solid, count: int) -> Array:
    """Return points spread over a solid's surface by area."""
    if solid.faces is None:
        return solid.points
    a, b, c = np.moveaxis(solid.points[solid.faces], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not areas.sum() > 0:
        return solid.points
    rng = np.random.default_rng(0)
    face = rng.choice(len(areas), count, p=areas / areas.sum())
    s, t = rng.random((2, count, 1))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    return np.asarray(a[face] + s * (b - a)[face] + t * (c - a)[face])


def winding_number(points: Array, triangles: Array) -> Array:
    """Return how often triangles, (F, 3, 3), go round points, (n, 3), whichever way they turn.

    The sum of their solid angles over 4π (A. van Oosterom and J. Strackee, "The solid angle of a
    plane triangle", IEEE Trans. Biomed. Eng. 1983, Eq. 8), without its sign.
    """
    turns = np.empty(len(points))
    step = max(1, CHUNK // len(triangles))
    for first in range(0, len(points), step):
        chosen = slice(first, first + step)
        a, b, c = np.moveaxis(triangles - points[chosen, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        volume = np.sum(a * np.cross(b, c), axis=-1)
        ab, bc, ca = (np.sum(u * v, axis=-1) for u, v in ((a, b), (b, c), (c, a)))
        angles = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        turns[chosen] = angles.sum(axis=1)
    return np.abs(turns) / (4 * np.pi)
