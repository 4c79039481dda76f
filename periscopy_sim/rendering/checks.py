"""Checks of a scene that loads and still gives a useless A: no shadow, an occluder in a surface."""

from __future__ import annotations

import numpy as np

from periscopy_sim.rendering.survey import Survey
from periscopy_sim.scenario import LIFT, Array, Scenario, corners, wall_frame

RAYS = 1 << 16
"""Rays between random places of the monitor and of the wall that `hidden_fraction` traces."""

LEAST = 1e-4
"""Fraction of these rays that occluders block at least where there is a shadow; a wire of 1 mm
blocks 2e-3."""

LINES = 256
"""Lines over a surface in each direction: `pierced` may miss what is thinner than their gap."""

INSET = 1e-3
"""Fraction of a surface's size by which lines end before its edges: a frame may touch these."""


def hidden_fraction(scenario: Scenario) -> float:
    """Return the fraction of light paths from the monitor to the visible wall that are blocked."""
    rng = np.random.default_rng(0)
    pixel, patch = (rng.integers(size, size=RAYS) for size in scenario.transport_shape)
    across, up = rng.uniform(-0.5, 0.5, (2, RAYS, 1))
    places = scenario.patch_centers[patch]
    places = places + across * scenario.patch_across[patch] + up * scenario.patch_up[patch]
    return float(np.mean(Survey(scenario).blocked(scenario.wall_points[pixel], places)))


def shadow_doubt(scenario: Scenario) -> str:
    """Return a warning where no occluder casts a shadow, or all is in shadow; empty otherwise."""
    hidden = hidden_fraction(scenario)
    if LEAST <= hidden < 1:
        return ""
    if hidden == 1:
        return "occluders hide all of the monitor from what the camera sees of the wall"
    names = ", ".join(f"'{occluder.name}'" for occluder in scenario.occluders[:3])
    return (
        "no occluder casts a shadow of the monitor into what the camera sees of the wall "
        f"({names or 'the scene has none'}): check their places, and that their numbers are metres"
    )


def pierced(scenario: Scenario) -> str:
    """Return which surface an occluder stands in, and which occluder; empty where none does.

    Lines run just in front of the monitor and of the visible wall: an occluder that blocks one
    stands in the surface. Surfaces that are not flat are not checked.
    """
    survey = Survey(scenario)
    wall = wall_frame(scenario.wall_points, scenario.wall_normals, scenario.photograph_shape)
    surfaces = (
        ("monitor", survey.monitor_points, scenario.patch_normals, scenario.patch_across[0]),
        ("wall", scenario.wall_points, scenario.wall_normals, wall.across),
    )
    for name, points, normals, across in surfaces:
        if not np.allclose(normals, normals[0], atol=1e-3):
            continue
        if survey.blocked(*_lines(points, normals[0], across)).any():
            within = [
                f"'{occluder.name}'"
                for occluder in scenario.occluders
                if occluder.bounds is None or _meets(occluder.bounds, points, normals[0])
            ]
            return f"{', '.join(within) or 'an occluder'} stands in the {name}"
    return ""


def _lines(points: Array, normal: Array, across: Array) -> tuple[Array, Array]:
    """Return the ends of lines over a rectangle about points (n, 3), both (2 `LINES`, 3)."""
    x = across / np.linalg.norm(across)
    axes, center = np.stack([x, np.cross(normal, x)]), points.mean(axis=0)
    place = (points - center) @ axes.T
    low, size = place.min(axis=0), np.ptp(place, axis=0)
    center = center + LIFT * float(np.linalg.norm(size)) * normal
    side = np.linspace(0, 1, LINES)

    def ends(inset: float) -> Array:
        end = np.stack([side, np.full(LINES, inset)], axis=1)
        return np.asarray((low + np.concatenate([end, end[:, ::-1]]) * size) @ axes + center)

    return ends(INSET), ends(1 - INSET)


def _meets(bounds: Array, points: Array, normal: Array) -> bool:
    """Return whether a box, (2, 3), reaches through the plane of points, and about them."""
    margin = 1e-3 * float(np.linalg.norm(np.ptp(points, axis=0)))
    depth = (corners(bounds) - points[0]) @ normal
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    beside = (bounds[1] < low).any() or (bounds[0] > high).any()
    return bool(depth.min() < margin and depth.max() > 0 and not beside)
