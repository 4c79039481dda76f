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

from periscopy_sim.analytic.closed_form import (
    emission_and_reflectance,
    monitor_axes,
    refusal,
    tolerance,
    wall_coordinates,
    wall_plane,
)
from periscopy_sim.numerics.threads import ahead
from periscopy_sim.scenario import Array, Scenario, WallFrame

Progress = Callable[[float], None]


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

    emission, reflectance = emission_and_reflectance(scenario)
    wall = wall_plane(scenario)
    axes = monitor_axes(scenario)
    vertices, starts = _occluding_parts(scenario, wall)
    plane = np.ascontiguousarray(wall_coordinates(wall, scenario.wall_points).T[:2])
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
            foot, height = np.split(wall_coordinates(wall, q), [2])
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


def _occluding_parts(scenario: Scenario, wall: WallFrame) -> tuple[Array, NDArray[np.int64]]:
    """(V, 3) vertices of all convex parts in the wall's coordinates, and where each part begins."""
    from periscopy_sim.analytic.shadow import connected_parts, is_convex

    parts: list[Array] = []
    for occluder in scenario.occluders:
        if occluder.vertices is None or occluder.faces is None:
            raise refusal(scenario, occluder.name, "has no triangles; replace it by a mesh")
        for vertices, faces in connected_parts(occluder.vertices, occluder.faces):
            if not is_convex(vertices, faces):
                x, y, z = vertices.mean(axis=0)
                raise refusal(
                    scenario,
                    occluder.name,
                    f"has a part about ({x:.4g}, {y:.4g}, {z:.4g}) that is not a closed convex "
                    "solid or a flat convex polygon; split it into such parts that share no vertex",
                )
            _check_between(scenario, wall, occluder.name, vertices)
            parts.append(wall_coordinates(wall, vertices))
    starts = np.cumsum([0] + [len(part) for part in parts])
    return np.concatenate([np.empty((0, 3)), *parts]), starts


def _check_between(scenario: Scenario, wall: WallFrame, name: str, vertices: Array) -> None:
    """Check that the rays from every sample of the monitor through the vertices meet the wall."""
    height = wall_coordinates(wall, vertices)[:, 2]
    if height.min() < -tolerance(scenario.wall_points):
        raise refusal(scenario, name, "reaches behind the wall's plane; move it to the front")
    if ((vertices - scenario.patch_centers[0]) @ scenario.patch_normals[0]).min() <= 0:
        raise refusal(
            scenario, name, "reaches the monitor's plane or behind; move it towards the wall"
        )
    # A monitor that is tilted against the wall may have samples nearer to it than the vertices.
    centers, across, up = scenario.patch_centers, scenario.patch_across, scenario.patch_up
    corners = [centers + (s * across + t * up) / 2 for s in (-1, 1) for t in (-1, 1)]
    if height.max() >= wall_coordinates(wall, np.concatenate(corners))[:, 2].min():
        raise refusal(
            scenario, name, "is no nearer to the wall than the monitor; move it towards the wall"
        )
