"""The light transport matrix A by areas: what each wall point sees of each patch, without rays.

    A[i, j] = ρ/π ∫_patch j E(q → i) V(i, q) cos θ_i cos θ_q / ‖q − i‖² dq

with the wall's albedo ρ, the monitor's angular profile E and the visibility V, over the lit part of
the patch, see `patch_light`. Where rays leave noise that differs from place to place, this moves
smoothly with the scene: what descends on a scene's parameters needs that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.outline import Borders, borders_of
from periscopy_sim.errors import ClosedFormError
from periscopy_sim.numerics.machine import in_parallel, ranges
from periscopy_sim.scenario import Array, Scenario, WallFrame, wall_frame

RELIEF = 1e-4
"""Of the field of view's width: how far the wall may stand out of its plane anywhere."""

CELLS = 12
"""Rows and columns of cells, at least, over which light is linear: to 1e-5 of the chair's A."""

PIXEL_POINTS = 126
"""Wall points along a photograph's longer side, about: by its 63 pixels' own it lost 0.4 dB."""

FLATNESS = 1e-6
"""Deviation, relative to its extent, up to which a surface counts as planar."""


def area_transport(scenario: Scenario, finer: int = 1) -> NDArray[np.float32]:
    """Compute the light transport matrix by areas.

    Parameters
    ----------
    scenario
        A scene with a planar diffuse wall, a monitor that is a planar grid of rectangles of known
        angular profile, and occluders of triangles between the two.
    finer
        Wall points along each side of a pixel, over which A is averaged: the scenario's
        photograph has so many times the rows and columns that A is for.

    Returns
    -------
    ndarray
        A, (M, N) float32, M a `finer`² part of the scenario's; as `render_transport` makes it.

    Raises
    ------
    ClosedFormError
        If the scene is not of that kind; the message names the shape.
    """
    from periscopy_sim.analytic.patch_light import Lighting, light_rows

    view = _view(scenario, finer)
    A = np.empty((len(view.points), np.prod(scenario.hidden_shape)), np.float32)

    def part(some: tuple[int, int]) -> None:
        at = slice(*some)
        lit = Lighting(view.points[at], view.normals[at], view.cells, view.exponents)
        light_rows(lit, view.borders, view.shape, view.cut, A[at])

    in_parallel(part, ranges(len(A)))
    A *= view.scale
    return np.maximum(A, 0, out=A)  # of a patch in full shadow rounding is left


analytic_transport = area_transport  # the public name


def pixel_transport(scenario: Scenario) -> NDArray[np.float32]:
    """Compute A, (M, N), averaged over the pixels' areas; for the rest see `area_transport`."""
    shape, finer = scenario.photograph_shape, points_across(scenario.photograph_shape)
    places = (np.arange(finer) + 0.5) / finer - 0.5
    grid, normals = (
        values.reshape(*shape, 3) for values in (scenario.wall_points, scenario.wall_normals)
    )
    for axis, size in enumerate(shape):
        steps = np.asarray(np.gradient(grid, axis=axis)) if size > 1 else np.zeros_like(grid)
        offsets = np.expand_dims(np.tile(places, size), (1 - axis, 2))
        grid = grid.repeat(finer, axis) + offsets * steps.repeat(finer, axis)
        normals = normals.repeat(finer, axis)
    divided = replace(
        scenario,
        photograph_shape=(finer * shape[0], finer * shape[1]),
        wall_points=grid.reshape(-1, 3),
        wall_normals=normals.reshape(-1, 3),
    )
    return area_transport(divided, finer)


def points_across(photograph_shape: tuple[int, int]) -> int:
    """Return how many wall points along each side of a pixel A is averaged over."""
    return max(1, round(PIXEL_POINTS / max(photograph_shape)))


def has_areas(scenario: Scenario, finer: int = 1) -> bool:
    """Return whether a scene is of the kind that `area_transport` takes."""
    try:
        require_areas(scenario, finer)
    except ClosedFormError:
        return False
    return True


def require_areas(scenario: Scenario, finer: int = 1) -> None:
    """Raise a ClosedFormError unless a scene is of the kind that `area_transport` takes."""
    _view(scenario, finer)


def area_derivatives(
    scenario: Scenario,
    sides: Sequence[tuple[Scenario, Scenario, float]],
    finer: int = 1,
    A: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Compute derivatives of the light transport matrix of `area_transport` by some parameters.

    Parameters
    ----------
    scenario, finer
        As there.
    sides
        For each of P parameters the scene on either side, and how far these are apart. Only the
        places of things there count, not what is seen: far enough for single precision, and so
        near that places change in proportion.
    A
        What `area_transport` computes of the scenario, if that is known.

    Returns
    -------
    ndarray
        (P, M, N) float32: derivatives of what `area_transport` computes; where it has a corner,
        as where faces of two occluders lie in one plane and part, those to either side.

    Raises
    ------
    ClosedFormError
        As there, of any of the scenes.
    """
    view = _view(scenario, finer)
    moved = [_moved(_view(b, finer), _view(a, finer), apart) for a, b, apart in sides]
    shape = len(view.points), int(np.prod(scenario.hidden_shape))
    changes = np.empty((len(sides), *shape), np.float32)
    _fill_changes(changes, view, moved)
    changes *= view.scale
    for change, by in zip(changes, moved, strict=True):
        if by.scale:
            A = area_transport(scenario, finer) if A is None else A
            change += by.scale / view.scale * A
    return changes


@dataclass(frozen=True, eq=False)
class _View:
    """A scene as `light_rows` takes it."""

    points: Array  # (M, K, 3)
    normals: Array  # (M, K, 3)
    cells: Array  # (2,)
    exponents: Array  # (2,)
    meshes: list[tuple[Array, NDArray[np.int64]]]
    shape: NDArray[np.int64]  # (2,)
    cut: NDArray[np.int64]  # (2,)
    scale: float

    @property
    def vertices(self) -> Array:
        """(V, 3) of all meshes."""
        return np.concatenate([np.empty((0, 3)), *(vertices for vertices, _ in self.meshes)])

    @cached_property
    def borders(self) -> Borders:
        """The edges of the meshes."""
        return borders_of(self.meshes)


def _view(scenario: Scenario, finer: int) -> _View:
    """Bring a scene into the monitor's coordinates; a ClosedFormError says that it cannot."""
    emission, reflectance = scenario.emission, scenario.wall_reflectance
    if reflectance is None:
        raise refusal(scenario, "wall", "is not diffuse; give it a diffuse bsdf")
    if emission is None:
        reason = "has no closed angular profile; give it an area or lcd emitter"
        raise refusal(scenario, "monitor", reason)
    wall = wall_plane(scenario)
    if scenario.wall_relief > RELIEF * np.ptp(scenario.wall_points @ wall.across):
        raise refusal(scenario, "wall", "has parts that stand out of the plane that is seen")
    axes = monitor_axes(scenario)
    if abs(axes[0] @ axes[1]) > FLATNESS:
        raise refusal(scenario, "monitor", "has patches that are not rectangular")
    width, height = (
        float(np.linalg.norm(edge[0])) for edge in (scenario.patch_across, scenario.patch_up)
    )
    first = scenario.patch_centers[0] - scenario.patch_across[0] / 2 + scenario.patch_up[0] / 2
    turned = np.stack([axes[0], -axes[1], axes[2]]).T
    hidden = np.array(scenario.hidden_shape)
    cut = -(-CELLS // hidden)
    cells = np.array([width, height]) / cut[::-1]
    unit = np.array([*cells, 1.0])
    points = _blocks((scenario.wall_points - first) @ turned / unit, scenario, finer)
    normals = _blocks(scenario.wall_normals @ turned, scenario, finer)
    if points[..., 2].min() <= 0:
        raise refusal(scenario, "monitor", "does not face all of the wall that the camera sees")
    meshes = []
    for occluder in scenario.occluders:
        if occluder.vertices is None or occluder.faces is None:
            raise refusal(scenario, occluder.name, "has no triangles; replace it by a mesh")
        vertices = (occluder.vertices - first) @ turned / unit
        meshes.append((vertices, occluder.faces))
        above = vertices[:, 2] / points[..., 2].min()
        if above.min() <= FLATNESS or above.max() >= 1 - FLATNESS:
            end = "monitor's plane" if above.min() <= FLATNESS else "wall's nearest point"
            raise refusal(scenario, occluder.name, f"reaches the {end}; move it between the two")
    exponents = np.array([emission.vertical, emission.horizontal])
    scale = float(reflectance.mean()) / np.pi * width * height
    return _View(points, normals, cells, exponents, meshes, hidden * cut, cut, scale)


def _moved(there: _View, here: _View, apart: float) -> _View:
    """Return the derivative of a view, from two of them."""
    if len(there.meshes) != len(here.meshes) or any(
        len(a) != len(b) or not np.array_equal(f, g)
        for (a, f), (b, g) in zip(there.meshes, here.meshes, strict=True)
    ):
        raise ClosedFormError("a parameter changes how many vertices an occluder has, or its faces")
    slopes = {
        name: (getattr(there, name) - getattr(here, name)) / apart
        for name in ("points", "normals", "cells", "exponents", "vertices", "scale")
    }
    meshes = [(slopes.pop("vertices"), np.empty((0, 3), np.int64))]
    return replace(here, meshes=meshes, **slopes)


def _fill_changes(changes: NDArray[np.float32], view: _View, moved: Sequence[_View]) -> None:
    from periscopy_sim.analytic.border_motion import light_derivatives
    from periscopy_sim.analytic.patch_light import Lighting

    points, normals, cells, exponents = stacked = [
        np.array([getattr(by, name) for by in moved])
        for name in ("points", "normals", "cells", "exponents")
    ]
    vertices = np.array([by.vertices[view.borders.sources] for by in moved])
    shines = np.any([each.reshape(len(moved), -1).any(axis=1) for each in stacked], axis=0)

    def part(some: tuple[int, int]) -> None:
        at = slice(*some)
        lit = Lighting(view.points[at], view.normals[at], view.cells, view.exponents)
        by = Lighting(points[:, at], normals[:, at], cells, exponents)
        out = changes[:, at]
        light_derivatives(lit, by, vertices, shines, view.borders, view.shape, view.cut, out)

    in_parallel(part, ranges(changes.shape[1]))


def _blocks(values: Array, scenario: Scenario, finer: int) -> Array:
    """Return what wall points have, (M, K, 3), by the pixels that they are averaged over."""
    rows, columns = (size // finer for size in scenario.photograph_shape)
    laid = values.reshape(rows, finer, columns, finer, 3).transpose(0, 2, 1, 3, 4)
    return np.ascontiguousarray(laid.reshape(rows * columns, finer**2, 3))


def wall_plane(scenario: Scenario) -> WallFrame:
    """Return the frame of a wall that is one plane; else raise a SceneError."""
    points, normals = scenario.wall_points, scenario.wall_normals
    wall = wall_frame(points, normals, scenario.photograph_shape)
    deviation = np.abs((points - wall.center) @ wall.normal).max()
    if deviation > tolerance(points) or np.abs(normals - wall.normal).max() > FLATNESS:
        reason = f"is not one plane where the camera sees it (off by {deviation:.2g} m); flatten it"
        raise refusal(scenario, "wall", reason)
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
        reason = f"is not a planar grid of equal parallelograms (off by {deviation:.2g} m)"
        raise refusal(scenario, "monitor", f"{reason}; use a rectangle")
    axes = np.stack([across[0], up[0], normal])
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


def tolerance(points: Array) -> float:
    """Return the metres that points of one plane may lie off it: `FLATNESS`, and rounding."""
    extent = np.linalg.norm(np.ptp(points, axis=0))
    rounding = 4 * np.finfo(np.float32).eps  # a vertex is a sum of three products and a shift
    return float(FLATNESS * extent + rounding * np.abs(points).max())


def refusal(scenario: Scenario, shape: str, reason: str) -> ClosedFormError:
    """Return the error that says why a shape has no closed form."""
    return ClosedFormError(
        f"scene '{scenario.path}': for the analytic model, shape '{shape}' {reason}; the rendered "
        "model (render_transport) treats it as it is"
    )
