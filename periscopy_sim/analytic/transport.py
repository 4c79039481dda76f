"""The light transport matrix A in closed form: planar scenes, shadows of convex parts projected.

    A[i, j] = ρ/π · area_j/K · Σ_k E(q_k → c_i) V(c_i, q_k) cos θ_i cos θ_q / ‖q_k − c_i‖²

with the wall's albedo ρ, the monitor's angular profile E (1 along its normal) and K midpoint
samples q_k of patch j. The visibility V is 0 where wall point c_i lies in the shadow that a convex
part of an occluder casts from q_k: in the convex hull of its projected vertices. No ray is traced.
"""

from __future__ import annotations

from collections.abc import Callable
from threading import Event

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.numerics.threads import ahead
from periscopy_sim.scenario import Array, EmissionProfile, Scenario, WallFrame, wall_frame

Progress = Callable[[float], None]

FLATNESS = 1e-6
"""Deviation, relative to its extent, up to which a surface counts as planar."""

SHARP = 0.5
"""Largest blur by the camera's lens, in pixels, that the pixels' centres stand for."""


def analytic_transport(
    scenario: Scenario, *, samples: int = 16, progress: Progress | None = None
) -> NDArray[np.float32]:
    """Compute the light transport matrix from projected shadows.

    Each patch is cut into as many strata as samples, as square as the divisors allow; a sample lies
    in the middle of each. Wall points are the pixels' centres. Patches are spread over all cores;
    the result does not depend on how many there are.

    Parameters
    ----------
    scenario
        A scene with a planar diffuse wall, a planar monitor of known angular profile, and occluders
        between the two whose connected parts (triangles that share vertices) are each convex.
    samples
        Samples K of a patch.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray
        A, (M, N) float32, radiance sent to the camera for each unit of a patch's normal radiance.
        Multiplied by the channel's `Scenario.channel_gain` where the wall is coloured.

    Raises
    ------
    SceneError
        If the scene is not of that kind; the message names the shape.
    ValueError
        If the number of samples is below 1.
    """
    if samples < 1:
        raise ValueError(f"{samples} samples: the number must be positive")
    report = progress or (lambda _: None)
    stopped = Event()
    column = _make_columns(scenario, samples, stopped)
    A = np.empty(scenario.transport_shape, np.float32)
    try:
        for j, values in enumerate(ahead(column, range(A.shape[1]))):
            A[:, j] = values
            report((j + 1) / A.shape[1])
    finally:
        stopped.set()  # after an interrupt, no thread goes on with its column
    return A


def _make_columns(
    scenario: Scenario, samples: int, stopped: Event
) -> Callable[[int], NDArray[np.float32]]:
    """Return the function that computes column j of A, (M,), until it is told to stop."""
    from periscopy_sim.analytic.shadow import lit_points

    emission, reflectance = _check_closed_forms(scenario)
    wall = _wall_plane(scenario)
    axes = _monitor_axes(scenario)
    vertices, starts = _occluding_parts(scenario, wall)
    plane = np.ascontiguousarray(_wall_coordinates(wall, scenario.wall_points).T[:2])
    order = np.argsort(plane[0], kind="stable")
    sorted_points = np.ascontiguousarray(plane[:, order].T)
    along_axes = axes @ scenario.wall_points.T
    offsets = _stratum_centers(samples)
    scale = reflectance / np.pi * scenario.patch_areas / samples

    def column(j: int) -> NDArray[np.float32]:
        edges = np.stack([scenario.patch_across[j], scenario.patch_up[j]])
        total = np.zeros(len(order))
        for q in scenario.patch_centers[j] + offsets @ edges:
            if stopped.is_set():
                break
            across, up, ahead = along_axes - (axes @ q)[:, None]
            foot, height = np.split(_wall_coordinates(wall, q), [2])
            squared = np.sum((plane - foot[:, None]) ** 2, axis=0) + height**2
            lit = np.empty(len(order), np.bool)
            lit[order] = lit_points(sorted_points, foot, height[0], vertices, starts)
            # A direction within the monitor's plane has no angles; its emission is 0 all the same.
            with np.errstate(invalid="ignore"):
                profile = emission(across, up, ahead)
            # cos θ_i = height/r and cos θ_q = ahead/r.
            total += lit * profile * np.maximum(height, 0) * ahead / squared**2
        return np.asarray(scale[j] * total, np.float32)

    return column


def _stratum_centers(samples: int) -> Array:
    """(K, 2) positions across and up from a patch's centre, row by row from the top."""
    down = next(n for n in range(int(np.sqrt(samples)), 0, -1) if samples % n == 0)
    across = samples // down
    row, column = np.divmod(np.arange(samples), across)
    return np.stack([(column + 0.5) / across - 0.5, 0.5 - (row + 0.5) / down], axis=1)


def _wall_coordinates(wall: WallFrame, points: Array) -> Array:
    """(n, 3) across, up and height above the wall."""
    coordinates: Array = (points - wall.center) @ np.stack([wall.across, wall.up, wall.normal]).T
    return coordinates


def _check_closed_forms(scenario: Scenario) -> tuple[EmissionProfile, float]:
    """Angular profile of the monitor and albedo of the wall."""
    if scenario.wall_texture is not None:
        raise _refusal(scenario, "wall", "is textured; give it one reflectance")
    if scenario.wall_reflectance is None:
        raise _refusal(scenario, "wall", "is not diffuse; give it a diffuse bsdf")
    if scenario.blur > SHARP * _pixel_side(scenario):
        raise _refusal(
            scenario, "wall", f"is blurred by {scenario.blur:.2g} m; focus the camera on it"
        )
    if scenario.emission is None:
        raise _refusal(
            scenario, "monitor", "has no closed angular profile; give it an area or lcd emitter"
        )
    return scenario.emission, float(scenario.wall_reflectance.mean())


def _pixel_side(scenario: Scenario) -> float:
    """Metres between the wall points of neighbouring pixels, at most; 0 of a single pixel."""
    grid = scenario.wall_points.reshape(*scenario.photograph_shape, 3)
    steps = [np.linalg.norm(np.diff(grid, axis=axis), axis=2) for axis in (0, 1)]
    return float(max((step.max() for step in steps if step.size), default=0.0))


def _wall_plane(scenario: Scenario) -> WallFrame:
    points, normals = scenario.wall_points, scenario.wall_normals
    wall = wall_frame(points, normals, scenario.photograph_shape)
    deviation = np.abs(_wall_coordinates(wall, points)[:, 2]).max()
    if deviation > _tolerance(points) or np.abs(normals - wall.normal).max() > FLATNESS:
        raise _refusal(
            scenario,
            "wall",
            f"is not one plane where the camera sees it (off by {deviation:.2g} m); flatten it",
        )
    return wall


def _monitor_axes(scenario: Scenario) -> Array:
    """(3, 3) unit across, up and normal, which all patches share."""
    centers, normals = scenario.patch_centers, scenario.patch_normals
    across, up, normal = scenario.patch_across, scenario.patch_up, normals[0]
    row, column = np.divmod(np.arange(len(centers)), scenario.hidden_shape[1])
    grid = centers[0] + column[:, None] * across[0] - row[:, None] * up[0]
    deviations = (centers - grid, across - across[0], up - up[0], across @ normal, up @ normal)
    deviation = max(np.abs(metres).max() for metres in deviations)
    corners = np.concatenate([centers - (across + up) / 2, centers + (across + up) / 2])
    if deviation > _tolerance(corners) or np.abs(normals - normal).max() > FLATNESS:
        raise _refusal(
            scenario,
            "monitor",
            f"is not a planar grid of equal parallelograms (off by {deviation:.2g} m); use a "
            "rectangle",
        )
    axes: Array = np.stack([across[0], up[0], normal])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return axes


def _occluding_parts(scenario: Scenario, wall: WallFrame) -> tuple[Array, NDArray[np.int64]]:
    """(V, 3) vertices of all convex parts in the wall's coordinates, and where each part begins."""
    from periscopy_sim.analytic.shadow import connected_parts, is_convex

    parts: list[Array] = []
    for occluder in scenario.occluders:
        if occluder.vertices is None or occluder.faces is None:
            raise _refusal(scenario, occluder.name, "has no triangles; replace it by a mesh")
        for vertices, faces in connected_parts(occluder.vertices, occluder.faces):
            if not is_convex(vertices, faces):
                x, y, z = vertices.mean(axis=0)
                raise _refusal(
                    scenario,
                    occluder.name,
                    f"has a part about ({x:.4g}, {y:.4g}, {z:.4g}) that is not a closed convex "
                    "solid or a flat convex polygon; split it into such parts that share no vertex",
                )
            _check_between(scenario, wall, occluder.name, vertices)
            parts.append(_wall_coordinates(wall, vertices))
    starts = np.cumsum([0] + [len(part) for part in parts])
    return np.concatenate([np.empty((0, 3)), *parts]), starts


def _check_between(scenario: Scenario, wall: WallFrame, name: str, vertices: Array) -> None:
    """Check that the rays from every sample of the monitor through the vertices meet the wall."""
    height = _wall_coordinates(wall, vertices)[:, 2]
    if height.min() < -_tolerance(scenario.wall_points):
        raise _refusal(scenario, name, "reaches behind the wall's plane; move it to the front")
    if ((vertices - scenario.patch_centers[0]) @ scenario.patch_normals[0]).min() <= 0:
        raise _refusal(
            scenario, name, "reaches the monitor's plane or behind; move it towards the wall"
        )
    # A monitor that is tilted against the wall may have samples nearer to it than the vertices.
    centers, across, up = scenario.patch_centers, scenario.patch_across, scenario.patch_up
    corners = [centers + (s * across + t * up) / 2 for s in (-1, 1) for t in (-1, 1)]
    if height.max() >= _wall_coordinates(wall, np.concatenate(corners))[:, 2].min():
        raise _refusal(
            scenario, name, "is no nearer to the wall than the monitor; move it towards the wall"
        )


def _tolerance(points: Array) -> float:
    """Metres that points of one plane may lie off it: `FLATNESS` and single-precision rounding."""
    extent = np.linalg.norm(np.ptp(points, axis=0))
    return float(FLATNESS * extent + np.finfo(np.float32).eps * np.abs(points).max())


def _refusal(scenario: Scenario, shape: str, reason: str) -> SceneError:
    return SceneError(
        f"scene '{scenario.path}': for the analytic model, shape '{shape}' {reason}; the rendered "
        "model (render_transport) treats it as it is"
    )
