"""The light transport matrix A by areas: what each wall point sees of each patch, without rays.

    A[i, j] = ρ/π ∫_patch j E(q → i) V(i, q) cos θ_i cos θ_q / ‖q − i‖² dq

with the wall's albedo ρ, the monitor's angular profile E and the visibility V, over the lit part of
the patch, see `patch_light`. Where rays leave noise that differs from place to place, this moves
smoothly with the scene: what descends on a scene's parameters needs that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from periscopy_sim.analytic.border_motion import light_derivatives
from periscopy_sim.analytic.clipped_light import Patches, clipped_rows, hides_itself, patches_of
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

MOST_FACES = 256
"""Triangles past which clipping by each costs more than rays."""


def area_transport(scenario: Scenario) -> NDArray[np.float32]:
    """Compute the light transport matrix by areas, averaged over the points of the view's pixels.

    Parameters
    ----------
    scenario
        A scene with a planar diffuse wall, hidden surfaces of known angular profile that do not
        hide themselves, and occluders of triangles.

    Returns
    -------
    ndarray
        A, (M, N) float32, as `render_transport` makes it.

    Raises
    ------
    ClosedFormError
        If the scene is not of that kind; the message names the shape.
    """
    blocks = [_scene_of(scenario, name).light() for name in scenario.hidden]
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


def has_outlines(scenario: Scenario) -> bool:
    """Return whether A is by shadows' outlines on planes alone: 30 times faster than by faces."""
    return all(isinstance(_scene_of(scenario, name), _LocalScene) for name in scenario.hidden)


def require_areas(scenario: Scenario) -> None:
    """Raise a ClosedFormError unless a scene is of the kind that `area_transport` takes."""
    for name in scenario.hidden:
        _scene_of(scenario, name)


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
    for before, after, _ in sides:
        _require_alike(after, before)
    for name, part in scenario.hidden.slices.items():
        local = _scene_of(scenario, name)
        beside = [(_scene_of(b, name), _scene_of(a, name), by) for a, b, by in sides]
        slopes = [
            _slope(after, before, by)
            for after, before, by in beside
            if isinstance(after, _LocalScene)
            and isinstance(before, _LocalScene)
            and len(after.meshes) == len(before.meshes)
        ]
        # Outlines move where both sides have them, and nothing passes the surface's plane between.
        if not isinstance(local, _LocalScene) or len(slopes) < len(sides):
            blocks.append(_differences(sides, name))
            continue
        changes = np.empty((len(sides), len(local.points), part.stop - part.start), np.float32)
        _fill_changes(changes, local, slopes)
        changes *= local.scale
        for change, by in zip(changes, slopes, strict=True):
            if by.scale:
                A = area_transport(scenario) if A is None else A
                change += by.scale / local.scale * A[:, part]
        blocks.append(changes)
    return np.concatenate(blocks, axis=2) if len(blocks) > 1 else blocks[0]


def _differences(
    sides: Sequence[tuple[Scenario, Scenario, float]], name: str
) -> NDArray[np.float32]:
    """Return (P, M, N) differences of a surface's columns, over the sides' distances."""
    steps: list[NDArray[np.float32]] = []
    last: Scenario | None = None
    for before, after, distance in sides:
        if before is not last:  # all may share one side
            last, start = before, _clipped_scene(before, name).light(np.float64)
        end = _clipped_scene(after, name).light(np.float64)
        steps.append(((end - start) / distance).astype(np.float32))
    return np.array(steps)


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


@dataclass(frozen=True, eq=False)
class _ClippedScene:
    """A scene as `clipped_rows` takes it."""

    points: Array  # (M, K, 3)
    normals: Array  # (M, K, 3)
    faces: Array  # (F, 3, 3)
    patches: Patches
    exponents: Array  # (2,)
    scale: float

    def light(self, dtype: type[np.floating[Any]] = np.float32) -> NDArray[Any]:
        """Return the surface's columns of A, (M, R C)."""
        A = np.empty((len(self.points), len(self.patches.centers)), dtype)

        def part(some: tuple[int, int]) -> None:
            at = slice(*some)
            points, normals = self.points[at], self.normals[at]
            clipped_rows(points, normals, self.faces, self.patches, self.exponents, A[at])

        in_parallel(part, ranges(len(A)))
        A *= self.scale
        return A


def _scene_of(scenario: Scenario, name: str) -> _LocalScene | _ClippedScene:
    """Return a scene before a hidden surface: by outlines on a plane where that is possible."""
    return _local_scene(scenario, name) or _clipped_scene(scenario, name)


def _emission(scenario: Scenario, name: str) -> tuple[Array, float]:
    """Return the exponents, (2,), of a surface's profile, and the wall's albedo over π.

    A ClosedFormError says that the wall or the profile has no closed form.
    """
    view, scene, emission = scenario.view, scenario.scene, scenario.scene.emission[name]
    if view.reflectance is None:
        raise no_closed_form(scene, "wall", "is not diffuse; give it a diffuse bsdf")
    if emission is None:
        reason = "has no closed angular profile; give it an area or lcd emitter"
        raise no_closed_form(scene, name, reason)
    wall = wall_plane(view)
    if view.relief > LIFT * np.ptp(view.points @ wall.across):
        raise no_closed_form(scene, "wall", "has parts that stand out of the plane that is seen")
    exponents = np.array([emission.vertical, emission.horizontal])
    return exponents, float(view.reflectance.mean()) / np.pi


def _clipped_scene(scenario: Scenario, name: str) -> _ClippedScene:
    """Return a scene for clipping by faces; a ClosedFormError says that it cannot."""
    view, scene, surface = scenario.view, scenario.scene, scenario.hidden[name]
    exponents, scale = _emission(scenario, name)
    faces = [np.empty((0, 3, 3))]
    for occluder in view.before(name):
        if occluder.vertices is None or occluder.faces is None:
            raise no_closed_form(scene, occluder.name, "has no triangles; replace it by a mesh")
        faces.append(occluder.vertices[occluder.faces])
    if (count := sum(map(len, faces))) > MOST_FACES:
        reason = f"is one of {count} triangles that hide; use {MOST_FACES} or fewer"
        raise no_closed_form(scene, view.before(name)[-1].name, reason)
    if hides_itself(surface, tuple(view.corners[1].ravel())):
        raise no_closed_form(scene, name, "hides parts of itself; split it")
    stacked = np.concatenate(faces)
    return _ClippedScene(view.points, view.normals, stacked, patches_of(surface), exponents, scale)


def _local_scene(scenario: Scenario, name: str) -> _LocalScene | None:
    """Bring a scene into a flat surface's coordinates; None where it has no outlines there."""
    view, surface = scenario.view, scenario.hidden[name]
    exponents, scale = _emission(scenario, name)
    axes = rectangle_axes(surface)
    if axes is None:
        return None
    width, height = (float(np.linalg.norm(edge[0])) for edge in (surface.across, surface.up))
    first = surface.centers[0] - surface.across[0] / 2 + surface.up[0] / 2
    turned = np.stack([axes[0], -axes[1], axes[2]]).T
    shape = np.array(surface.shape)
    cut = -(-CELLS // shape)
    cells = np.array([width, height]) / cut[::-1]
    unit = np.array([*cells, 1.0])
    points, normals = (view.points - first) @ turned / unit, view.normals @ turned
    if points[..., 2].min() <= 0:
        return None
    # All light runs within the hull of these corners.
    rectangle = np.array([(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0)]) * [*(shape * cut)[::-1], 0]
    ends = np.concatenate([rectangle, (seen_corners(view) - first) @ turned / unit])
    meshes = []
    for occluder in view.before(name):
        if occluder.vertices is None or occluder.faces is None:
            return None
        vertices = (occluder.vertices - first) @ turned / unit
        above = vertices[:, 2] / points[..., 2].min()
        if above.max() <= FLATNESS:  # behind the surface, it hides nothing of it
            continue
        if above.min() <= FLATNESS or above.max() >= 1 - FLATNESS:
            if are_apart(vertices, ends):
                continue
            return None
        meshes.append((vertices, occluder.faces))
    scale *= width * height
    return _LocalScene(points, normals, cells, exponents, meshes, shape * cut, cut, scale)


def _require_alike(after: Scenario, before: Scenario) -> None:
    """Raise a ClosedFormError unless two scenes have occluders of the same faces."""
    pairs = zip_longest(after.scene.occluders, before.scene.occluders)
    if any(
        a is None
        or b is None
        or not np.array_equal(np.array(a.faces), np.array(b.faces))
        or np.array(a.vertices).shape != np.array(b.vertices).shape
        for a, b in pairs
    ):
        raise ClosedFormError("a parameter changes how many vertices an occluder has, or its faces")


def _slope(after: _LocalScene, before: _LocalScene, distance: float) -> _LocalScene:
    """Return the derivative of a scene's arrays, from those on either side."""
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


def seen_corners(view: View) -> Array:
    """Return the corners, (4, 3), of the rectangle about all points of a view of a plane."""
    wall = view.frame
    axes = np.stack([wall.across, wall.up])
    places = (view.points.reshape(-1, 3) - wall.center) @ axes.T
    (left, low), (right, high) = places.min(axis=0), places.max(axis=0)
    ends = np.array([(left, low), (left, high), (right, low), (right, high)])
    return np.asarray(wall.center + ends @ axes)


def are_apart(points: Array, others: Array) -> bool:
    """Return whether a plane parts two sets of points, (n, 3) and (m, 3).

    A linear program looks for the plane that is farthest from both.
    """
    scale = np.abs(np.concatenate([points, others])).max()
    sides = [np.insert(-points, 3, 1, axis=1), np.insert(others, 3, -1, axis=1)]
    rows = np.insert(np.concatenate(sides) / [scale, scale, scale, 1], 4, 1, axis=1)
    bounds = [(-1, 1)] * 3 + [(None, None), (0, 1)]  # the plane's normal, place and distance
    found = optimize.linprog([0, 0, 0, 0, -1], rows, np.zeros(len(rows)), bounds=bounds)
    return bool(found.success and found.x[4] > FLATNESS)


def rectangle_axes(surface: Surface) -> Array | None:
    """Return unit across, up and normal, (3, 3), of a plane of equal rectangles; None of others."""
    centers, normals = surface.centers, surface.normals
    across, up, normal = surface.across, surface.up, normals[0]
    row, column = np.divmod(np.arange(len(centers)), surface.shape[1])
    grid = centers[0] + column[:, None] * across[0] - row[:, None] * up[0]
    deviations = (centers - grid, across - across[0], up - up[0], across @ normal, up @ normal)
    deviation = max(np.abs(metres).max() for metres in deviations)
    corners = np.concatenate([centers - (across + up) / 2, centers + (across + up) / 2])
    axes = np.stack([across[0], up[0], normal])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    bent = max(np.abs(normals - normal).max(), abs(axes[0] @ axes[1]))
    return None if deviation > tolerance(corners) or bent > FLATNESS else np.asarray(axes)


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
