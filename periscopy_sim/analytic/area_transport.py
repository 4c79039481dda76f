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

from periscopy_sim.analytic.border_motion import light_derivatives
from periscopy_sim.analytic.outline import Borders, borders_of
from periscopy_sim.analytic.patch_light import Lighting, light_rows
from periscopy_sim.errors import ClosedFormError
from periscopy_sim.hidden import Surface
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.machine import in_parallel, ranges
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import Scene
from periscopy_sim.view import LIFT, View, WallFrame

CELLS = 12
"""Rows and columns of cells, at least, over which light is linear: to 1e-5 of the chair's A."""

PIXEL_POINTS = 126
"""Wall points along a photograph's longer side, about: by its 63 pixels' own it lost 0.4 dB."""

FLATNESS = 1e-6
"""Deviation, relative to its extent, up to which a surface counts as planar."""


def area_transport(scenario: Scenario) -> NDArray[np.float32]:
    """Compute the light transport matrix by areas, averaged over the points of the view's pixels.

    Parameters
    ----------
    scenario
        A scene with a planar diffuse wall, a monitor that is a planar grid of rectangles of known
        angular profile, and occluders of triangles between the two.

    Returns
    -------
    ndarray
        A, (M, N) float32, as `render_transport` makes it.

    Raises
    ------
    ClosedFormError
        If the scene is not of that kind; the message names the shape.
    """
    blocks = [_local_scene(scenario, name).light() for name in scenario.hidden]
    return np.hstack(blocks) if len(blocks) > 1 else blocks[0]


analytic_transport = area_transport  # the public name


def pixel_transport(scenario: Scenario) -> NDArray[np.float32]:
    """Compute A, (M, N), averaged over the pixels' areas; for the rest see `area_transport`."""
    return area_transport(scenario.averaged(points_across(scenario.photograph_shape)))


def points_across(photograph_shape: tuple[int, int]) -> int:
    """Return how many wall points along each side of a pixel A is averaged over."""
    return max(1, round(PIXEL_POINTS / max(photograph_shape)))


def has_areas(scenario: Scenario) -> bool:
    """Return whether a scene is of the kind that `area_transport` takes."""
    try:
        require_areas(scenario)
    except ClosedFormError:
        return False
    return True


def require_areas(scenario: Scenario, beside: Scenario | None = None) -> None:
    """Raise a ClosedFormError unless a scene is of the kind that `area_transport` takes.

    So it is unless `area_derivatives` can take differences to another scene, if one is given.
    """
    for name in scenario.hidden:
        local = _local_scene(scenario, name)
        if beside is not None:
            _require_alike(local, _local_scene(beside, name))


def area_derivatives(
    scenario: Scenario,
    sides: Sequence[tuple[Scenario, Scenario, float]],
    A: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Compute derivatives of the light transport matrix of `area_transport` by some parameters.

    Parameters
    ----------
    scenario
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
    blocks = []
    for name, part in scenario.hidden.slices.items():
        local = _local_scene(scenario, name)
        slopes = [
            _slope(_local_scene(b, name), _local_scene(a, name), distance)
            for a, b, distance in sides
        ]
        changes = np.empty((len(sides), len(local.points), part.stop - part.start), np.float32)
        _fill_changes(changes, local, slopes)
        changes *= local.scale
        for change, by in zip(changes, slopes, strict=True):
            if by.scale:
                A = area_transport(scenario) if A is None else A
                change += by.scale / local.scale * A[:, part]
        blocks.append(changes)
    return np.concatenate(blocks, axis=2) if len(blocks) > 1 else blocks[0]


@dataclass(frozen=True, eq=False)
class _LocalScene:
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

    def light(self) -> NDArray[np.float32]:
        """Return the surface's columns of A, (M, R C)."""
        A = np.empty((len(self.points), int(np.prod(self.shape // self.cut))), np.float32)

        def part(some: tuple[int, int]) -> None:
            at = slice(*some)
            lit = Lighting(self.points[at], self.normals[at], self.cells, self.exponents)
            light_rows(lit, self.borders, self.shape, self.cut, A[at])

        in_parallel(part, ranges(len(A)))
        A *= self.scale
        return np.maximum(A, 0, out=A)  # of a patch in full shadow rounding is left


def _local_scene(scenario: Scenario, name: str) -> _LocalScene:
    """Bring a scene into a hidden surface's coordinates; a ClosedFormError says that it cannot."""
    view, scene, surface = scenario.view, scenario.scene, scenario.hidden[name]
    emission = scene.emission[name]
    if view.reflectance is None:
        raise no_closed_form(scene, "wall", "is not diffuse; give it a diffuse bsdf")
    if emission is None:
        reason = "has no closed angular profile; give it an area or lcd emitter"
        raise no_closed_form(scene, name, reason)
    wall = wall_plane(view)
    if view.relief > LIFT * np.ptp(view.points @ wall.across):
        raise no_closed_form(scene, "wall", "has parts that stand out of the plane that is seen")
    axes = surface_axes(scene, name, surface)
    if abs(axes[0] @ axes[1]) > FLATNESS:
        raise no_closed_form(scene, name, "has patches that are not rectangular")
    width, height = (float(np.linalg.norm(edge[0])) for edge in (surface.across, surface.up))
    first = surface.centers[0] - surface.across[0] / 2 + surface.up[0] / 2
    turned = np.stack([axes[0], -axes[1], axes[2]]).T
    shape = np.array(surface.shape)
    cut = -(-CELLS // shape)
    cells = np.array([width, height]) / cut[::-1]
    unit = np.array([*cells, 1.0])
    points, normals = (view.points - first) @ turned / unit, view.normals @ turned
    if points[..., 2].min() <= 0:
        raise no_closed_form(scene, name, "does not face all of the wall that the camera sees")
    meshes = []
    for occluder in scene.before(name):
        if occluder.vertices is None or occluder.faces is None:
            raise no_closed_form(scene, occluder.name, "has no triangles; replace it by a mesh")
        vertices = (occluder.vertices - first) @ turned / unit
        above = vertices[:, 2] / points[..., 2].min()
        if above.max() <= FLATNESS:  # behind the surface, it hides nothing of it
            continue
        meshes.append((vertices, occluder.faces))
        if above.min() <= FLATNESS or above.max() >= 1 - FLATNESS:
            end = "monitor's plane" if above.min() <= FLATNESS else "wall's nearest point"
            raise no_closed_form(
                scene, occluder.name, f"reaches the {end}; move it between the two"
            )
    exponents = np.array([emission.vertical, emission.horizontal])
    scale = float(view.reflectance.mean()) / np.pi * width * height
    return _LocalScene(points, normals, cells, exponents, meshes, shape * cut, cut, scale)


def _require_alike(after: _LocalScene, before: _LocalScene) -> None:
    """Raise a ClosedFormError unless two scenes have the same meshes before a hidden surface."""
    if len(after.meshes) != len(before.meshes) or any(
        len(a) != len(b) or not np.array_equal(f, g)
        for (a, f), (b, g) in zip(after.meshes, before.meshes, strict=True)
    ):
        raise ClosedFormError("a parameter changes an occluder's faces, or what hides a surface")


def _slope(after: _LocalScene, before: _LocalScene, distance: float) -> _LocalScene:
    """Return the derivative of a scene's arrays, from those on either side."""
    _require_alike(after, before)
    slopes = {
        name: (getattr(after, name) - getattr(before, name)) / distance
        for name in ("points", "normals", "cells", "exponents", "vertices", "scale")
    }
    meshes = [(slopes.pop("vertices"), np.empty((0, 3), np.int64))]
    return replace(before, meshes=meshes, **slopes)


def _fill_changes(
    changes: NDArray[np.float32], local: _LocalScene, slopes: Sequence[_LocalScene]
) -> None:
    points, normals, cells, exponents = stacked = [
        np.array([getattr(by, name) for by in slopes])
        for name in ("points", "normals", "cells", "exponents")
    ]
    vertices = np.array([by.vertices[local.borders.sources] for by in slopes])
    shines = np.any([each.reshape(len(slopes), -1).any(axis=1) for each in stacked], axis=0)

    def part(some: tuple[int, int]) -> None:
        at = slice(*some)
        lit = Lighting(local.points[at], local.normals[at], local.cells, local.exponents)
        by = Lighting(points[:, at], normals[:, at], cells, exponents)
        out = changes[:, at]
        light_derivatives(lit, by, vertices, shines, local.borders, local.shape, local.cut, out)

    in_parallel(part, ranges(changes.shape[1]))


def wall_plane(view: View) -> WallFrame:
    """Return the frame of a wall that is one plane; else raise a ClosedFormError."""
    points, normals, wall = view.points.reshape(-1, 3), view.normals.reshape(-1, 3), view.frame
    deviation = np.abs((points - wall.center) @ wall.normal).max()
    if deviation > tolerance(points) or np.abs(normals - wall.normal).max() > FLATNESS:
        reason = f"is not one plane where the camera sees it (off by {deviation:.2g} m); flatten it"
        raise no_closed_form(view.scene, "wall", reason)
    return wall


def surface_axes(scene: Scene, name: str, surface: Surface) -> Array:
    """Return unit across, up and normal, (3, 3), which all patches of a hidden surface share.

    A ClosedFormError says that they share none.
    """
    centers, normals = surface.centers, surface.normals
    across, up, normal = surface.across, surface.up, normals[0]
    row, column = np.divmod(np.arange(len(centers)), surface.shape[1])
    grid = centers[0] + column[:, None] * across[0] - row[:, None] * up[0]
    deviations = (centers - grid, across - across[0], up - up[0], across @ normal, up @ normal)
    deviation = max(np.abs(metres).max() for metres in deviations)
    corners = np.concatenate([centers - (across + up) / 2, centers + (across + up) / 2])
    if deviation > tolerance(corners) or np.abs(normals - normal).max() > FLATNESS:
        reason = f"is not a planar grid of equal parallelograms (off by {deviation:.2g} m)"
        raise no_closed_form(scene, name, f"{reason}; use a rectangle")
    axes = np.stack([across[0], up[0], normal])
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


def tolerance(points: Array) -> float:
    """Return the metres that points of one plane may lie off it: `FLATNESS`, and rounding."""
    extent = np.linalg.norm(np.ptp(points, axis=0))
    rounding = 4 * np.finfo(np.float32).eps  # a vertex is a sum of three products and a shift
    return float(FLATNESS * extent + rounding * np.abs(points).max())


def no_closed_form(scene: Scene, shape: str, reason: str) -> ClosedFormError:
    """Return the error that says why a shape has no closed form."""
    return ClosedFormError(
        f"scene '{scene.path}': for A by areas, shape '{shape}' {reason}; A by rays "
        "(render_transport) treats it as it is, calibration cannot"
    )
