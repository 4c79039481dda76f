"""The light transport matrix A by areas: what each wall point sees of each patch, without rays.

    A[i, j] = ρ/π ∫_patch j E(q → i) V(i, q) cos θ_i cos θ_q / ‖q − i‖² dq

with the wall's albedo ρ, the monitor's angular profile E and the visibility V, over the lit part of
the patch, see `patch_light`. Where rays leave noise that differs from place to place, this moves
smoothly with the scene: what descends on a scene's parameters needs that.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from periscopy_sim.analytic import patch_light
from periscopy_sim.analytic.clipped_light import Patches, clipped_rows, hides_itself, patches_of
from periscopy_sim.errors import ClosedFormError
from periscopy_sim.hidden import Surface
from periscopy_sim.numerics import Array, machine
from periscopy_sim.scene import Scene
from periscopy_sim.view import LIFT, Geometry, View, WallFrame

CELLS = 12
"""Rows and columns of cells, at least, over which light is linear: to 1e-5 of the chair's A."""

PIXEL_POINTS = 126
"""Wall points along a photograph's longer side, about: by its 63 pixels' own it lost 0.4 dB."""

PART = 1e-3
"""Fraction of the way to a neighbouring scene over which light is differenced. Few wall points
then pass from one side of a face to its other, where light bends; the whole way made an error of
10 % in derivatives."""

FLATNESS = 1e-6
"""Deviation, relative to its extent, up to which a wall counts as planar."""

MOST_FACES = 256
"""Triangles past which clipping by each costs more than rays."""


def area_transport(scenario: Geometry) -> NDArray[np.float32]:
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
    blocks = [way.light() for way in ways_to(scenario).values()]
    return np.hstack(blocks) if len(blocks) > 1 else blocks[0]


analytic_transport = area_transport  # the public name


def points_across(photograph_shape: tuple[int, int]) -> int:
    """Return how many wall points along each side of a pixel A is averaged over."""
    return max(1, round(PIXEL_POINTS / max(photograph_shape)))


def has_areas(scenario: Geometry) -> bool:
    """Return whether a scene is of the kind that `area_transport` takes."""
    try:
        ways_to(scenario)
    except ClosedFormError:
        return False
    return True


def area_derivatives(
    scenario: Geometry, sides: Sequence[tuple[Geometry, float]]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Compute the light transport matrix of `area_transport` and its derivatives by parameters.

    Parameters
    ----------
    scenario
        As there.
    sides
        For each of P parameters a scene where it has another value, and by how much: far enough
        for single precision, and so near that places change in proportion.

    Returns
    -------
    A, derivatives
        (M, N) and (P, M, N) float32; where A has a corner, as where faces of two occluders lie in
        one plane and part, the derivatives are those to either side.

    Raises
    ------
    ClosedFormError
        As there, of any of the scenes; or if a parameter changes an occluder's faces.
    """
    scenarios, distances = [scenario, *(beside for beside, _ in sides)], [by for _, by in sides]
    if not all(have_same_faces(each.scene, scenario.scene) for each in scenarios):
        raise ClosedFormError("a parameter changes how many vertices an occluder has, or its faces")
    blocks = []
    for name in scenario.hidden:
        ways = [way_to(each, name) for each in scenarios]
        # Outlines move where all have them, and nothing passes the surface's plane between.
        if len({len(way.meshes) if isinstance(way, Outlines) else None for way in ways}) > 1:
            ways = [way_to(each, name, by_faces=True) for each in scenarios]
        blocks.append(ways[0].linearized(list(zip(ways[1:], distances, strict=True))))
    if len(blocks) == 1:
        return blocks[0]
    A, changes = (np.concatenate(each, axis=-1) for each in zip(*blocks, strict=True))
    return A, changes


def have_same_faces(one: Scene, other: Scene) -> bool:
    """Return whether the occluders of two scenes differ in their places alone."""
    pairs = zip_longest(one.occluders, other.occluders)
    return all(
        a
        and b
        and np.array(a.vertices).shape == np.array(b.vertices).shape
        and np.array_equal(np.array(a.faces), np.array(b.faces))
        for a, b in pairs
    )


@dataclass(frozen=True, eq=False)
class Way(ABC):
    """The way to a hidden surface's columns of A: what light runs past, as arrays."""

    points: Array  # (M, K, 3)
    normals: Array  # (M, K, 3), as long as the wall is bright there
    exponents: Array  # (2,) of the surface's profile
    scale: float  # of the light that `fill` computes
    patches: int  # R C

    def light(self, dtype: type[np.floating[Any]] = np.float32) -> NDArray[Any]:
        """Return the surface's columns of A, (M, R C)."""
        A = np.empty((len(self.points), self.patches), dtype)

        def part(rows: tuple[int, int]) -> None:
            own = A[slice(*rows)]
            self.fill(slice(*rows), own)
            own *= self.scale
            np.maximum(own, 0, out=own)  # of a patch in full shadow rounding is left

        machine.in_parallel(part, machine.ranges(len(A)))
        return A

    @abstractmethod
    def linearized(
        self, sides: Sequence[tuple[Any, float]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the light and its derivatives, from ways of this kind beside it, at distances."""

    @abstractmethod
    def fill(self, rows: slice, out: NDArray[Any]) -> None:
        """Fill `out` with the light of each patch in some rows, over the scale."""


@dataclass(frozen=True, eq=False)
class Outlines(Way):
    """A flat surface's, by shadows' outlines: 30 times as fast as by faces; see `light_rows`."""

    cells: Array  # (2,)
    meshes: list[tuple[Array, NDArray[np.int64]]]  # vertices and faces of each
    shape: NDArray[np.int64]  # (2,)
    cut: NDArray[np.int64]  # (2,)

    @cached_property
    def borders(self) -> patch_light.Borders:
        """The edges of the meshes."""
        return patch_light.borders_of(self.meshes)

    def fill(self, rows: slice, out: NDArray[Any]) -> None:
        """Fill `out` with the light of each patch in some rows, over the scale."""
        lit = patch_light.Lighting(
            self.points[rows], self.normals[rows], self.cells, self.exponents
        )
        patch_light.light_rows(lit, self.borders, self.shape, self.cut, out)

    @property
    def vertices(self) -> Array:
        """(V, 3) of all meshes."""
        return np.concatenate([np.empty((0, 3)), *(vertices for vertices, _ in self.meshes)])

    def linearized(
        self, sides: Sequence[tuple["Outlines", float]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the light and its derivatives by the outlines' motion; see `light_derivatives`."""
        A, count = self.light(), len(sides)
        points, normals, cells, exponents, vertices, scales = [
            np.array([(getattr(side, name) - getattr(self, name)) / by for side, by in sides])
            for name in ("points", "normals", "cells", "exponents", "vertices", "scale")
        ]
        vertices = vertices[:, self.borders.sources]
        changes = np.empty((count, *A.shape), np.float32)

        def part(some: tuple[int, int]) -> None:
            at = slice(*some)
            lit = patch_light.Lighting(
                self.points[at], self.normals[at], self.cells, self.exponents
            )
            by = patch_light.Lighting(points[:, at], normals[:, at], cells, exponents)
            out = changes[:, at]
            patch_light.light_derivatives(
                lit, by, vertices, self.borders, self.shape, self.cut, out
            )

        machine.in_parallel(part, machine.ranges(len(A)))
        changes *= self.scale
        for change, by in zip(changes, scales, strict=True):
            if by:
                change += by / self.scale * A
        return A, changes


@dataclass(frozen=True, eq=False)
class Faces(Way):
    """Any surface's, by occluders' faces that clip its patches; see `clipped_rows`."""

    faces: Array  # (F, 3, 3)
    grid: Patches

    def fill(self, rows: slice, out: NDArray[Any]) -> None:
        """Fill `out` with the light of each patch in some rows, over the scale."""
        points, normals = map(np.ascontiguousarray, (self.points[rows], self.normals[rows]))
        clipped_rows(points, normals, self.faces, self.grid, self.exponents, out)

    def linearized(
        self, sides: Sequence[tuple["Faces", float]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the light and its derivatives, differences in double precision."""
        A = self.light(np.float64)
        changes = np.empty((len(sides), *A.shape), np.float32)
        for change, (side, distance) in zip(changes, sides, strict=True):
            moved = {
                name: moved_towards(getattr(self, name), getattr(side, name))
                for name in ("points", "normals", "exponents", "scale", "faces")
            }
            grid = Patches(*map(moved_towards, self.grid, side.grid))
            moved_light = replace(self, grid=grid, **moved).light(np.float64)
            change[:] = (moved_light - A) / (PART * distance)
        return A.astype(np.float32), changes


def moved_towards(own: Any, beside: Any) -> Any:
    """Return numbers moved by `PART` of the way to others."""
    return own + PART * (beside - own)


def ways_to(scenario: Geometry) -> dict[str, Way]:
    """Return the way to each hidden surface's columns of A; a ClosedFormError says why not."""
    return {name: way_to(scenario, name) for name in scenario.hidden}


def way_to(scenario: Geometry, name: str, *, by_faces: bool = False) -> Way:
    """Return the way to a hidden surface's columns of A, by outlines where it has such.

    A ClosedFormError says that there is none.
    """
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
    exponents = np.array([emission.vertical, emission.horizontal], np.float64)
    scale = float(view.even.albedo) / np.pi
    outlines = None if by_faces else outlines_on(view, name, surface, exponents, scale)
    if outlines is not None:
        return outlines
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
    patches = len(surface.centers)
    return Faces(
        view.points, view.painted_normals, exponents, scale, patches, stacked, patches_of(surface)
    )


def outlines_on(
    view: View, name: str, surface: Surface, exponents: Array, scale: float
) -> Outlines | None:
    """Return the way by outlines, in the surface's coordinates; None where it has none."""
    across, up, normal = surface.across[0], surface.up[0], surface.normals[0]
    width, height = np.linalg.norm(across), np.linalg.norm(up)
    if surface.curved is not None or abs(across @ up) > FLATNESS * width * height:
        return None
    first = surface.centers[0] - across / 2 + up / 2
    turned = np.stack([across / width, -up / height, normal]).T
    shape = np.array(surface.shape)
    cut = -(-CELLS // shape)
    cells = np.array([width, height]) / cut[::-1]
    unit = np.array([*cells, 1.0])
    points = (view.points - first) @ turned / unit
    normals = view.painted_normals @ turned
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
    scale, patches = scale * float(width * height), len(surface.centers)
    return Outlines(points, normals, exponents, scale, patches, cells, meshes, shape * cut, cut)


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
