"""The wall as the camera's own rays meet it: its places, and its colour or texture."""

import warnings
from collections.abc import Callable
from itertools import product
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.rendering import variant
from periscopy_sim.scene import CAMERA

PRECISE = 1e-4
"""Error of pixels' albedo, root mean square over their mean, at which it is exact enough: a tenth
of a 60 dB photograph's noise. Squares with sharp borders err by 3.4e-4, a wallpaper by 4e-5."""

POINTS, MOST = (64, 1 << 16), 1 << 26
"""Points in each area by which a texture is averaged first and at most, and at most in all areas
together."""

STEPS = 0xC13FA9A9, 0x91E10DA5
"""Steps of the points along x and y, over 2³²: 1 over the plastic number, and its square."""

MISSED = 2.0
"""Points of an area, about, that its average has too many or too few of one colour."""

DARKEST = 1e-4
"""Albedo over its mean that darker pixels count as, so that each channel can be divided by it. Such
a pixel shows no light, and has no weight in A."""


def trace_texture(
    scene: Any,
    camera: Any,
    wall: Any,
    shape: tuple[int, int],
    across: int,
    what: str,
    motion: Array | None = None,
) -> dict[str, Array]:
    """Return what a `View` has of a diffuse wall's texture, by the names of its fields.

    The texture is averaged over the areas about the points in a pixel, `across` of them along each
    side. The camera's rays sample each area by two lattices of points, shifted at random. Their
    number doubles where colours differ, until the two averages say that the error is `PRECISE`. A
    rectangular wall may have moved, by a matrix, (4, 4), from the camera's rays to its own. `what`
    names the wall in messages: a texture that has no mean is a SceneError.
    """
    from scipy import ndimage

    variant.require_vectorized("a wall's texture")
    _check_uv(camera, scene, wall, what)
    rows, columns = (across * side for side in shape)
    own = None if motion is None else variant.mi.Transform4f(motion)

    def sample(number: Any, area: Any, replica: Any) -> list[Any]:
        """Return the colour of an area's point, its square and 1, by number; 0 if it is no wall."""
        shift = variant.mi.sample_tea_32(area, replica, 8)
        within = [
            variant.mi.Float((number * step + by) >> 8) * 2.0**-24
            for step, by in zip(STEPS, shift, strict=True)
        ]
        # There and back, so that what is averaged has no jump at the area's borders.
        x, y = (1 - variant.dr.abs(2 * each - 1) for each in within)
        film = variant.mi.Point2f((area % columns + x) / columns, (area // columns + y) / rows)
        ray, _ = camera.sample_ray(0.0, 0.0, film, variant.mi.Point2f(0.5, 0.5))
        if own is None:
            si = scene.ray_intersect(ray)
            hit = is_shape(si, wall)
        else:
            si = wall.ray_intersect(
                variant.mi.Ray3f(own @ ray.o, variant.dr.normalize(own @ ray.d))
            )
            hit = si.is_valid()
        albedo = _albedo(wall, si)
        values = (*albedo, variant.dr.squared_norm(albedo), variant.mi.Float(1))
        return [variant.dr.select(hit, each, 0) for each in values]

    sums = np.zeros((2, 5, rows * columns))  # of red, green, blue, their squares, and of points
    areas = np.arange(rows * columns, dtype=np.uint32)
    first, (last, most) = 0, POINTS
    while True:
        added = last - first
        for replica, start in product(range(2), range(0, len(areas), variant.LANES // added)):
            some = areas[start : start + variant.LANES // added]
            padded = np.resize(some, _lanes(len(some) * added) // added)
            lane = variant.dr.arange(variant.mi.UInt32, len(padded) * added)
            each, begin, of = (
                variant.dr.opaque(variant.mi.UInt32, number) for number in (added, first, replica)
            )
            area = variant.dr.gather(variant.mi.UInt32, variant.mi.UInt32(padded), lane // each)
            seen = sample(lane % each + begin, area, of)
            variant.dr.eval(*seen)  # all in one kernel
            light = np.array([variant.dr.block_sum(values, added) for values in seen])
            sums[replica][:, some] += light[:, : len(some)]
        means = (sums[:, :4] / np.maximum(sums[:, 4:], 1)).swapaxes(1, 2)
        albedo, squares = means[..., :3], means[..., 3]
        if not (np.isfinite(albedo).all() and albedo.min() >= 0 < albedo.max()):
            raise SceneError(f"{what} has a texture that is black, negative or not finite")
        errors, precise = (albedo[0] - albedo[1]) / 2, PRECISE * albedo.mean()
        whole = _by_pixel(errors, shape, across).mean(axis=1)
        error = float(np.sqrt(np.mean(whole**2)))
        spread = np.sqrt(np.maximum(squares - np.sum(albedo**2, axis=2), 0)).max(axis=0)
        # Both averages may be equal and wrong, where they miss what a neighbour has.
        grids, size = albedo.reshape(2, rows, columns, 3), (1, 3, 3, 1)
        highest, lowest = ndimage.maximum_filter(grids, size), ndimage.minimum_filter(grids, size)
        contrast = (highest.max(axis=0) - lowest.min(axis=0)).max(axis=2).ravel()
        areas = np.flatnonzero(np.maximum(spread, contrast) > precise * last / MISSED).astype(
            np.uint32
        )
        if error <= precise or last >= most or len(areas) * last > MOST:
            break
        first, last = last, 2 * last
    if error > 10 * precise:
        warnings.warn(
            f"{what} has a texture so fine that its pixels err by {error / albedo.mean():.1e}; "
            "give the camera more pixels",
            RuntimeWarning,
            stacklevel=2,
        )
    return _fields(_by_pixel(albedo.mean(axis=0), shape, across))


def _by_pixel(areas: Array, shape: tuple[int, int], across: int) -> Array:
    """Return values of areas, (n, 3), by pixel and point, (M, K, 3)."""
    rows, columns = shape
    grid = areas.reshape(rows, across, columns, across, 3).swapaxes(1, 2)
    return np.asarray(grid.reshape(rows * columns, across**2, 3))


def _fields(albedo: Array) -> dict[str, Array]:
    """Return the fields of a view by the albedo about its points, (M, K, 3); see `View.albedo`."""
    pixels = albedo.mean(axis=1)
    colour = pixels.mean(axis=0)
    texture = np.divide(
        albedo, pixels[:, None], out=np.ones_like(albedo), where=pixels[:, None] > 0
    )
    paint = np.divide(pixels, colour, out=np.ones_like(pixels), where=colour > 0)
    paint = np.maximum(paint, DARKEST)
    beside = paint * np.sqrt(np.mean(paint**-2.0, axis=1, keepdims=True))
    return {
        "reflectance": colour * paint,
        "channel_gain": colour / colour.mean() * beside,
        "texture": texture,
    }


def _albedo(wall: Any, si: Any) -> Any:
    """Return the albedo at points of a diffuse wall."""
    si.wi = up = variant.mi.Vector3f(0, 0, 1)
    return variant.dr.pi * wall.bsdf().eval(variant.mi.BSDFContext(), si, up)


def _check_uv(camera: Any, scene: Any, wall: Any, what: str) -> None:
    """Reject a texture by UV coordinates that a mesh lacks: Mitsuba would show it on each face."""
    if not wall.is_mesh() or wall.has_vertex_texcoords():
        return
    film = np.random.default_rng(0).random((2, 1024))
    ray, _ = camera.sample_ray(0.0, 0.0, variant.mi.Point2f(film), variant.mi.Point2f(0.5, 0.5))
    si = scene.ray_intersect(ray)
    si.uv = variant.mi.Point2f(0.3, 0.4)
    seen = np.broadcast_to(np.array(_albedo(wall, si)), (3, 1024))[:, np.array(si.is_valid())]
    if np.ptp(seen, axis=1).max() <= PRECISE * seen.max():
        raise SceneError(
            f"{what} has a texture, and its mesh no UV coordinates; unwrap the mesh (in Blender: "
            "Edit Mode, UV, Smart UV Project) and export it with a material"
        )


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
    if int(wall.bsdf().flags()) & int(
        variant.mi.BSDFFlags.DeltaReflection
    ):  # shadow rays never find it
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
        return tuple(is_shape(si, each) for each in shapes)

    hits = _traced(shown, np.full((1, 2), 0.5), where)
    return next((each.id() for each, hit in zip(shapes, hits, strict=True) if hit.any()), "")


def _traced(function: Callable[..., tuple[Any, ...]], film: Array, where: str) -> list[Array]:
    """Return `map_points` of a film; a SceneError of shapes that cannot be traced."""
    try:
        return map_points(function, film)
    except RuntimeError as error:  # of shapes that Mitsuba builds but cannot trace
        raise SceneError(f"{where}: Mitsuba cannot trace it: {variant.one_line(error)}") from None


def pointer_to(shape: Any) -> Any:
    """Return a Dr.Jit pointer to a shape that scenes loaded one after another share kernels with.

    Dr.Jit numbers the shapes of a process. As a constant, the number would give each scene kernels
    of its own, which take LLVM a tenth of a second each.
    """
    return variant.dr.opaque(variant.mi.ShapePtr, shape) if variant.is_vectorized() else shape


def is_shape(si: Any, shape: Any) -> Any:
    """Return whether a ray met a shape."""
    return si.is_valid() & (si.shape == pointer_to(shape))


def look(scene: Any, camera: Any, film: Any) -> tuple[Any, Any]:
    """Return a camera's rays through points of its film, (0, 0) to (1, 1), and what they meet."""
    ray, _ = camera.sample_ray(0.0, 0.0, film, variant.mi.Point2f(0.5, 0.5))
    return ray, scene.ray_intersect(ray)


def _meet(scene: Any, camera: Any, wall: Any) -> Callable[[Any], tuple[Any, ...]]:
    """Return what the camera's ray through a point of the film meets, as a function of that point.

    The ray's origin and direction, the wall's point and both its normals, whether it is the wall,
    the reflection to the camera, and that along the normal and along `SLOPES`.
    """
    bsdf, context = wall.bsdf(), variant.mi.BSDFContext()

    def meet(position: Any) -> tuple[Any, ...]:
        ray, si = look(scene, camera, position)
        hit = is_shape(si, wall)
        toward_camera = variant.mi.Vector3f(0, 0, variant.dr.sign(si.wi.z))
        facing = bsdf.eval(context, si, toward_camera)
        si.wi = variant.mi.Vector3f(0, 0, 1)
        colors = [bsdf.eval(context, si, variant.mi.Vector3f(*to)) for to in ((0, 0, 1), *SLOPES)]
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


def _lanes(count: int) -> int:
    """Return the number of points that stands for a count: LLVM compiles each number anew.

    A power of four up to 2¹⁶ points, which are traced faster than a kernel is compiled.
    """
    if not 0 < count <= 1 << 16:
        return count
    return int(max(64, 4 ** -(-(count - 1).bit_length() // 2)))


def map_points(function: Callable[..., tuple[Any, ...]], *points: Array) -> list[Array]:
    """Evaluate a function of Mitsuba's points, that returns Dr.Jit numbers and vectors.

    The points are (n, 2) or (n, 3); the result is an (n, components) float64 array for each of the
    function's values.
    """
    kinds = [variant.mi.Point2f if each.shape[1] == 2 else variant.mi.Point3f for each in points]
    if variant.is_vectorized():
        count = len(points[0])
        some = np.resize(np.arange(count), _lanes(count))
        arguments = (each[some].T.astype(np.float32) for each in points)
        values = function(*(kind(each) for kind, each in zip(kinds, arguments, strict=True)))
        variant.dr.eval(
            *values
        )  # all in one kernel, where each component would be traced by its own
        # Values that are the same everywhere have length 1.
        return [np.atleast_2d(value).T[:count] + np.zeros((count, 1)) for value in values]
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
    surface = shape.eval_parameterization(uv, +variant.mi.RayFlags.All)
    if not shape.is_mesh():
        return surface
    beside = uv * (1 - 2e-5) + variant.mi.Point2f(0.7e-5, 1.3e-5)
    missed = ~surface.is_valid() if variant.is_vectorized() else not surface.is_valid()
    return variant.dr.select(
        missed, shape.eval_parameterization(beside, +variant.mi.RayFlags.All, missed), surface
    )
