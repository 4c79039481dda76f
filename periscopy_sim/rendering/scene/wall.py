"""The wall as the camera's own rays meet it: its places, its colour or texture; no mirror."""

from collections.abc import Callable
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.scene.texture import trace_texture
from periscopy_sim.rendering.variant import dr, is_vectorized, mi, one_line
from periscopy_sim.scene import CAMERA

SLOPES = (0.8, 0, 0.6), (0, 0.8, 0.6)
"""Directions about the wall's normal in which its colour is looked at, too."""

UNIFORM = 1e-4
"""Change of reflectance, relative to the largest, that counts as none: far above the rounding of
single precision, 1e-7, and below the noise of a 60 dB photograph, 1e-3."""


def trace_wall(
    scene: Any, camera: Any, wall: Any, shape: tuple[int, int], across: int, where: str, what: str
) -> dict[str, Any]:
    """Return what a `View` has of the wall that its camera sees, by the names of its fields.

    `where` and `what` name scene and wall in messages: a wall that cannot be treated is a
    SceneError.
    """
    if int(wall.bsdf().flags()) & int(mi.BSDFFlags.DeltaReflection):  # shadow rays never find it
        raise SceneError(
            f"{what} reflects as a mirror does, in part or entirely; use a rough material, such "
            "as diffuse or roughplastic"
        )
    if camera.needs_aperture_sample():
        raise SceneError(
            f"{where}: the camera has a lens that blurs; give one in focus, of type perspective"
        )
    rows, columns = shape
    film = pixel_places(np.arange(rows * columns), shape, across).reshape(-1, 2)
    meet = _meet(scene, camera, wall)
    origins, directions, points, normals, shading, hit, *colors = _traced(meet, film, where)
    if not hit.all():
        missed = ~hit.reshape(rows * columns, -1).astype(bool).all(axis=1)
        first = int(np.flatnonzero(missed)[0])
        raise SceneError(
            f"{where}: {missed.sum()} of {missed.size} camera pixels miss the wall, the first"
            f" at row {first // columns}, column {first % columns}; move the camera, its film or "
            "what stands between it and the wall"
        )
    # At the pixels' centres alone a wallpaper could look plain.
    aside = np.random.default_rng(0).uniform(-0.5, 0.5, film.shape) / (columns, rows) / across
    hit_aside, color_aside = map_points(lambda at: itemgetter(5, 7)(meet(at)), film + aside)
    # By the cosine law, of a diffuse wall, a slope's cosine is all that it reflects less.
    fall = np.abs(np.array(colors[2:]) / SLOPES[0][2] - colors[1]).max()
    diffuse = bool(fall <= UNIFORM * colors[1].max())
    everywhere = np.concatenate([colors[1], color_aside[hit_aside[:, 0] != 0]])
    if _is_even(colors, everywhere, diffuse, what):
        albedo = colors[1].mean(axis=0)
        colours: dict[str, Any] = {"reflectance": np.pi * albedo if diffuse else None}
        colours["channel_gain"] = albedo / albedo.mean()
    else:
        colours = trace_texture(scene, camera, wall, shape, across, what)
    # Where a mesh has normals of its own, these count, as they do for the wall's BSDF.
    own = np.abs(shading - normals).max(axis=1, keepdims=True) > 1e-6
    normals = np.where(own, shading, normals)
    normals *= -np.sign(np.sum(normals * directions, axis=1, keepdims=True))
    outer = np.array([0, across - 1, across**2 - 1, across**2 - across])
    ends = np.array([0, columns - 1, rows * columns - 1, (rows - 1) * columns]) * across**2 + outer
    return {
        "points": points.reshape(rows * columns, -1, 3),
        "normals": normals.reshape(rows * columns, -1, 3),
        "rays": np.stack([origins, directions]),
        "corners": np.stack([origins[ends], points[ends]]),
        **colours,
    }


def camera_of(scene: Any, name: str = CAMERA) -> Any:
    """Return a sensor of a Mitsuba scene by its id."""
    return next(sensor for sensor in scene.sensors() if sensor.id() == name)


def shape_of(scene: Any, name: str) -> Any:
    """Return a shape of a Mitsuba scene by its id."""
    return next(shape for shape in scene.shapes() if shape.id() == name)


def pixel_places(
    pixels: NDArray[np.integer[Any]], shape: tuple[int, int], across: int
) -> NDArray[np.float64]:
    """Return places on the film, (P, across², 2), x and y from 0 to 1, of the points in pixels.

    They are the middles of strata, and the pixels (P,) row-major numbers.
    """
    within = np.indices((across, across)).reshape(2, -1) + 0.5
    down, along = np.stack(np.divmod(pixels, shape[1]))[..., None] + within[:, None] / across
    return np.stack([along / shape[1], down / shape[0]], axis=-1)


def middle_shape(scene: Any, camera: Any, where: str) -> str:
    """Return the id of the shape that the middle of a camera's picture shows; empty for none."""
    shapes = scene.shapes()

    def shown(film: Any) -> tuple[Any, ...]:
        _, si = look(scene, camera, film)
        return tuple(_is_shape(si, each) for each in shapes)

    hits = _traced(shown, np.full((1, 2), 0.5), where)
    return next((each.id() for each, hit in zip(shapes, hits, strict=True) if hit.any()), "")


def _traced(function: Callable[..., tuple[Any, ...]], film: Array, where: str) -> list[Array]:
    """Return `map_points` of a film; a SceneError of shapes that cannot be traced."""
    try:
        return map_points(function, film)
    except RuntimeError as error:  # of shapes that Mitsuba builds but cannot trace
        raise SceneError(f"{where}: Mitsuba cannot trace it: {one_line(error)}") from None


def _is_shape(si: Any, shape: Any) -> Any:
    """Return whether a ray met a shape."""
    return si.is_valid() & (si.shape == (mi.ShapePtr(shape) if is_vectorized() else shape))


def look(scene: Any, camera: Any, film: Any) -> tuple[Any, Any]:
    """Return a camera's rays through points of its film, (0, 0) to (1, 1), and what they meet."""
    ray, _ = camera.sample_ray(0.0, 0.0, film, mi.Point2f(0.5, 0.5))
    return ray, scene.ray_intersect(ray)


def _meet(scene: Any, camera: Any, wall: Any) -> Callable[[Any], tuple[Any, ...]]:
    """Return what the camera's ray through a point of the film meets, as a function of that point.

    The ray's origin and direction, the wall's point and both its normals, whether it is the wall,
    the reflection to the camera, and that along the normal and along `SLOPES`.
    """
    bsdf, context = wall.bsdf(), mi.BSDFContext()

    def meet(position: Any) -> tuple[Any, ...]:
        ray, si = look(scene, camera, position)
        hit = _is_shape(si, wall)
        toward_camera = mi.Vector3f(0, 0, dr.sign(si.wi.z))
        facing = bsdf.eval(context, si, toward_camera)
        si.wi = mi.Vector3f(0, 0, 1)
        colors = [bsdf.eval(context, si, mi.Vector3f(*to)) for to in ((0, 0, 1), *SLOPES)]
        return ray.o, ray.d, si.p, si.n, si.sh_frame.n, hit, facing, *colors

    return meet


def _is_even(colors: list[Array], everywhere: Array, diffuse: bool, what: str) -> bool:
    """Return whether a wall has one colour, (n, 3), everywhere.

    A SceneError rejects a wall without reflection, or whose colour changes with direction, or from
    place to place unless it is diffuse.
    """
    facing, color, *tilted = colors
    if not (np.isfinite(facing + color).all() and facing.any() and color.min() >= 0):
        raise SceneError(
            f"{what} reflects nothing to the camera, or no number from 0 on; turn its front to the "
            "camera or make it two-sided"
        )
    # What the wall reflects sideways, over what it reflects along the normal, is one number.
    slanted = np.array(tilted)
    fall = slanted.sum(axis=(1, 2), keepdims=True) / color.sum()
    even = bool((np.ptp(everywhere, axis=0) <= UNIFORM * color.max()).all())
    if (np.abs(slanted - fall * color) > UNIFORM * fall * color.max()).any() or not (
        even or diffuse
    ):
        raise SceneError(
            f"{what} reflects differently from place to place, or in another colour with "
            "direction; give it a diffuse material, which may have a texture, or one material "
            "without a texture"
        )
    return even


def map_points(function: Callable[..., tuple[Any, ...]], *points: Array) -> list[Array]:
    """Evaluate a function of Mitsuba's points, that returns Dr.Jit numbers and vectors.

    The points are (n, 2) or (n, 3); the result is an (n, components) float64 array for each of the
    function's values.
    """
    kinds = [mi.Point2f if each.shape[1] == 2 else mi.Point3f for each in points]
    if is_vectorized():
        arguments = (each.T.astype(np.float32) for each in points)
        values = function(*(kind(each) for kind, each in zip(kinds, arguments, strict=True)))
        dr.eval(*values)  # all in one kernel, where each component would be traced by its own
        # Values that are the same everywhere have length 1.
        return [np.atleast_2d(value).T + np.zeros((len(points[0]), 1)) for value in values]
    each = [
        function(*(kind(place.tolist()) for kind, place in zip(kinds, places, strict=True)))
        for places in zip(*points, strict=True)
    ]
    return [np.array([*map(np.ravel, rows)], np.float64) for rows in zip(*each, strict=True)]


def surface_at(shape: Any, uv: Any) -> Any:
    """Find the point of a shape at UV coordinates, Mitsuba's Point2f within the unit square.

    Mitsuba looks for it by a ray in the UV plane, which may slip between two triangles where it
    meets their edge; there a point beside it is taken. The interaction is not valid where the shape
    has no point. A shape without UV coordinates is a RuntimeError.
    """
    surface = shape.eval_parameterization(uv, +mi.RayFlags.All)
    if not shape.is_mesh():
        return surface
    beside = uv * (1 - 2e-5) + mi.Point2f(0.7e-5, 1.3e-5)
    missed = ~surface.is_valid() if is_vectorized() else not surface.is_valid()
    return dr.select(missed, shape.eval_parameterization(beside, +mi.RayFlags.All, missed), surface)
