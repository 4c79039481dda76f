"""Occluders that stand in the wall or in the monitor, where nothing can stand."""

from __future__ import annotations

import numpy as np

from periscopy_sim.rendering.survey import Survey
from periscopy_sim.scenario import LIFT, Array, Scenario

LINES = 256
"""Along a surface in each direction: what is thinner than the gap between two may be missed."""

INSET = 1e-3
"""Of a surface's size by which the lines end before its edges: a frame may lie against them."""

FLAT = 1e-6
"""Cosine by which normals of a flat surface may differ."""


def pierced(scenario: Scenario) -> str:
    """Return which surface an occluder stands in, and which occluder; empty where none does.

    Lines run just before the face of the monitor, and of what the camera sees of the wall; what
    meets one stands in it. Surfaces that are not flat are taken to be free.
    """
    survey = Survey(scenario)
    half_across, half_up = scenario.patch_across / 2, scenario.patch_up / 2
    corners = [
        scenario.patch_centers + a * half_across + b * half_up for a in (-1, 1) for b in (-1, 1)
    ]
    surfaces = (
        ("monitor", np.concatenate(corners), scenario.patch_normals, scenario.patch_across[0]),
        ("wall", scenario.wall_points, scenario.wall_normals, _across(scenario)),
    )
    for name, points, normals, across in surfaces:
        if (normals @ normals[0] < 1 - FLAT).any():
            continue
        if survey.blocked(*_lines(points, normals[0], across)).any():
            within = [
                occluder.name
                for occluder in scenario.occluders
                if occluder.bounds is None or _meets(occluder.bounds, points, normals[0])
            ]
            listed = ", ".join(f"'{each}'" for each in within) or "an occluder"
            return f"{listed} stands in the {name}"
    return ""


def _across(scenario: Scenario) -> Array:
    rows, columns = scenario.photograph_shape
    points = scenario.wall_points.reshape(rows, columns, 3)
    return np.asarray(points[0, -1] - points[0, 0] if columns > 1 else points[-1, 0] - points[0, 0])


def _lines(points: Array, normal: Array, across: Array) -> tuple[Array, Array]:
    """Return the ends of lines over a rectangle about points (n, 3), both (2 `LINES`, 3)."""
    x = across / max(float(np.linalg.norm(across)), 1e-30)
    up = np.cross(normal, x)
    centre = points.mean(axis=0)
    place = (points - centre) @ np.stack([x, up], axis=1)
    low, high = place.min(axis=0), place.max(axis=0)
    low, high = low + INSET * (high - low), high - INSET * (high - low)
    lifted = centre + LIFT * float(np.linalg.norm(high - low)) * normal
    parts = np.linspace(0, 1, LINES)[:, None]

    def at(a: Array, b: Array) -> Array:
        return np.asarray(lifted + a * x + b * up)

    across_at, up_at = (low[k] + parts * (high[k] - low[k]) for k in (0, 1))
    ends = [at(across_at, edge[1] + 0 * parts) for edge in (low, high)]
    sides = [at(edge[0] + 0 * parts, up_at) for edge in (low, high)]
    return np.concatenate([ends[0], sides[0]]), np.concatenate([ends[1], sides[1]])


def _meets(bounds: Array, points: Array, normal: Array) -> bool:
    """Return whether a box, (2, 3), reaches through the plane of points, and about them."""
    margin = 1e-3 * float(np.linalg.norm(np.ptp(points, axis=0)))
    box = np.array(np.meshgrid(*bounds.T)).reshape(3, -1).T
    depth = (box - points[0]) @ normal
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    beside = (bounds[1] < low).any() or (bounds[0] > high).any()
    return bool(depth.min() < margin and depth.max() > 0 and not beside)
