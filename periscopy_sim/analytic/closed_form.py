"""What a scene must be for its light to have a closed form: planes, and a known falloff."""

import numpy as np

from periscopy_sim.errors import ClosedFormError
from periscopy_sim.scenario import Array, EmissionProfile, Scenario, WallFrame, wall_frame

FLATNESS = 1e-6
"""Deviation, relative to its extent, up to which a surface counts as planar."""


def emission_and_reflectance(scenario: Scenario) -> tuple[EmissionProfile, float]:
    """Return the monitor's profile and the wall's albedo, or raise a `ClosedFormError`."""
    if scenario.wall_reflectance is None:
        raise refusal(scenario, "wall", "is not diffuse; give it a diffuse bsdf")
    if scenario.emission is None:
        raise refusal(
            scenario, "monitor", "has no closed angular profile; give it an area or lcd emitter"
        )
    return scenario.emission, float(scenario.wall_reflectance.mean())


def wall_plane(scenario: Scenario) -> WallFrame:
    """Return the frame of a wall that is one plane; else raise a SceneError."""
    points, normals = scenario.wall_points, scenario.wall_normals
    wall = wall_frame(points, normals, scenario.photograph_shape)
    deviation = np.abs((points - wall.center) @ wall.normal).max()
    if deviation > tolerance(points) or np.abs(normals - wall.normal).max() > FLATNESS:
        raise refusal(
            scenario,
            "wall",
            f"is not one plane where the camera sees it (off by {deviation:.2g} m); flatten it",
        )
    return wall


def monitor_axes(scenario: Scenario) -> Array:
    """Return unit across, up and normal, (3, 3), which all patches share, or raise a SceneError."""
    centers, normals = scenario.patch_centers, scenario.patch_normals
    across, up, normal = scenario.patch_across, scenario.patch_up, normals[0]
    row, column = np.divmod(np.arange(len(centers)), scenario.hidden_shape[1])
    grid = centers[0] + column[:, None] * across[0] - row[:, None] * up[0]
    deviations = (centers - grid, across - across[0], up - up[0], across @ normal, up @ normal)
    deviation = max(np.abs(metres).max() for metres in deviations)
    corners = np.concatenate([centers - (across + up) / 2, centers + (across + up) / 2])
    if deviation > tolerance(corners) or np.abs(normals - normal).max() > FLATNESS:
        raise refusal(
            scenario,
            "monitor",
            f"is not a planar grid of equal parallelograms (off by {deviation:.2g} m); use a "
            "rectangle",
        )
    axes: Array = np.stack([across[0], up[0], normal])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return axes


def tolerance(points: Array) -> float:
    """Return the metres that points of one plane may lie off it: `FLATNESS`, and rounding."""
    extent = np.linalg.norm(np.ptp(points, axis=0))
    return float(FLATNESS * extent + np.finfo(np.float32).eps * np.abs(points).max())


def refusal(scenario: Scenario, shape: str, reason: str) -> ClosedFormError:
    """Return the error that says why a shape has no closed form."""
    return ClosedFormError(
        f"scene '{scenario.path}': for the analytic model, shape '{shape}' {reason}; the rendered "
        "model (render_transport) treats it as it is"
    )
