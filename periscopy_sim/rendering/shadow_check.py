"""Whether any occluder casts a shadow of the monitor into the camera's view."""

from __future__ import annotations

import numpy as np

from periscopy_sim.rendering.survey import Solid, Survey
from periscopy_sim.scenario import Array, Scenario

RAYS = 1 << 16
"""Between places of the monitor and of what the camera sees of the wall."""

LEAST = 1e-4
"""Part of them that occluders hide at least where there is a shadow; a wire of 1 mm hides 2e-3."""

LARGE, SMALL = 20.0, 1 / 200
"""Sizes over the distance from the monitor to the wall beyond which an occluder's unit is
doubted; `LARGE` as well its distance from the wall."""

SMALLEST = 1e-3
"""Metres that an occluder measures in its largest extent, at least, if its unit is right."""

NAMED = 3
"""Occluders that are told of."""


def shadow_doubt(scenario: Scenario) -> str:
    """Return why no shadow of the monitor tells the image; empty where occluders cast one.

    Rays between random places of the monitor and of the wall that the camera sees say so: of them
    less than `LEAST` meet an occluder, or all of them do. Each occluder is named with its place.
    """
    survey = Survey(scenario)
    hidden = _hidden_part(survey, scenario)
    if LEAST <= hidden < 1:
        return ""
    if not survey.solids:
        return (
            "nothing stands between the monitor and the wall: without shadows the photograph "
            "hardly tells the image"
        )
    told = [f"'{solid.name}' {_where(solid, scenario)}" for solid in survey.solids[:NAMED]]
    more = len(survey.solids) - len(told)
    listed = "; ".join([*told, f"{more} more"] if more else told)
    if hidden == 1:
        return f"occluders hide all of the monitor from what the camera sees of the wall: {listed}"
    return (
        "no occluder casts a shadow of the monitor into what the camera sees of the wall, and "
        f"without one the photograph hardly tells the image: {listed}"
    )


def hidden_part(scenario: Scenario) -> float:
    """Return which part of the monitor occluders hide from what the camera sees, on average.

    It is told by `RAYS` between random places of both.
    """
    return _hidden_part(Survey(scenario), scenario)


def _hidden_part(survey: Survey, scenario: Scenario) -> float:
    rng = np.random.default_rng(0)
    pixel, patch = (rng.integers(size, size=RAYS) for size in scenario.transport_shape)
    across, up = rng.uniform(-0.5, 0.5, (2, RAYS, 1))
    places = scenario.patch_centers[patch]
    places = places + across * scenario.patch_across[patch] + up * scenario.patch_up[patch]
    return float(np.mean(survey.blocked(scenario.wall_points[pixel], places)))


def size_doubts(scenario: Scenario) -> list[str]:
    """Return a line for each occluder that is smaller than `SMALLEST`, or larger than any room."""
    distance = _distance(scenario)
    doubts = []
    for occluder in scenario.occluders:
        if occluder.bounds is None:
            continue
        size = float(np.max(occluder.bounds[1] - occluder.bounds[0]))
        if not SMALLEST <= size <= LARGE * distance:
            told = f"{1e3 * size:.2g} mm" if size < 1 else f"{size:.3g} m"
            doubts.append(f"occluder '{occluder.name}' is {told} large: are its numbers metres?")
    return doubts


def _distance(scenario: Scenario) -> float:
    """Return metres from what the camera sees of the wall to the monitor."""
    wall, monitor = scenario.wall_points.mean(axis=0), scenario.patch_centers.mean(axis=0)
    return float(np.linalg.norm(wall - monitor))


def _where(solid: Solid, scenario: Scenario) -> str:
    """Return how large a solid is and where, and what is wrong with that, if it shows."""
    low, high = solid.points.min(axis=0), solid.points.max(axis=0)
    size = float(np.max(high - low))
    wall, monitor = scenario.wall_points.mean(axis=0), scenario.patch_centers.mean(axis=0)
    distance = _distance(scenario)
    x, y, z = (low + high) / 2
    told = f"is {size:.2g} m large, its middle at x {x:.3g}, y {y:.3g}, z {z:.3g} m"
    far = float(np.linalg.norm((low + high) / 2 - wall)) > LARGE * distance
    if far or size > LARGE * distance or size < SMALL * distance:
        return f"{told}: are its numbers metres?"
    if _all_behind(solid.points, monitor, scenario.patch_normals.mean(axis=0)):
        return f"{told}: behind the monitor"
    if _all_behind(solid.points, wall, scenario.wall_normals.mean(axis=0)):
        return f"{told}: behind the wall"
    return f"{told}: beside all lines between the two"


def _all_behind(points: Array, place: Array, normal: Array) -> bool:
    return bool(((points - place) @ normal <= 0).all())
