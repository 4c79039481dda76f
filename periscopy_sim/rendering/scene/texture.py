"""The albedo of a textured wall, averaged over the areas that a camera's pixels see of it."""

import warnings
from itertools import product
from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.variant import LANES, dr, mi, require_vectorized

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

    require_vectorized("a wall's texture")
    _check_uv(camera, scene, wall, what)
    rows, columns = (across * side for side in shape)
    own = None if motion is None else mi.Transform4f(motion)

    def sample(number: Any, area: Any, replica: int) -> list[Any]:
        """Return the colour of an area's point, its square and 1, by number; 0 if it is no wall."""
        shift = mi.sample_tea_32(area, mi.UInt32(replica), 8)
        within = [
            mi.Float((number * step + by) >> 8) * 2.0**-24
            for step, by in zip(STEPS, shift, strict=True)
        ]
        # There and back, so that what is averaged has no jump at the area's borders.
        x, y = (1 - dr.abs(2 * each - 1) for each in within)
        film = mi.Point2f((area % columns + x) / columns, (area // columns + y) / rows)
        ray, _ = camera.sample_ray(0.0, 0.0, film, mi.Point2f(0.5, 0.5))
        if own is None:
            si = scene.ray_intersect(ray)
            hit = si.is_valid() & (si.shape == mi.ShapePtr(wall))
        else:
            si = wall.ray_intersect(mi.Ray3f(own @ ray.o, dr.normalize(own @ ray.d)))
            hit = si.is_valid()
        albedo = _albedo(wall, si)
        values = (*albedo, dr.squared_norm(albedo), mi.Float(1))
        return [dr.select(hit, each, 0) for each in values]

    sums = np.zeros((2, 5, rows * columns))  # of red, green, blue, their squares, and of points
    areas = np.arange(rows * columns, dtype=np.uint32)
    first, (last, most) = 0, POINTS
    while True:
        added = last - first
        for replica, start in product(range(2), range(0, len(areas), LANES // added)):
            some = areas[start : start + LANES // added]
            lane = dr.arange(mi.UInt32, len(some) * added)
            area = dr.gather(mi.UInt32, mi.UInt32(some), lane // added)
            seen = sample(lane % added + dr.opaque(mi.UInt32, first), area, replica)
            dr.eval(*seen)  # all in one kernel
            sums[replica][:, some] += [dr.block_sum(each, added) for each in seen]
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
    si.wi = up = mi.Vector3f(0, 0, 1)
    return dr.pi * wall.bsdf().eval(mi.BSDFContext(), si, up)


def _check_uv(camera: Any, scene: Any, wall: Any, what: str) -> None:
    """Reject a texture by UV coordinates that a mesh lacks: Mitsuba would show it on each face."""
    if not wall.is_mesh() or wall.has_vertex_texcoords():
        return
    film = np.random.default_rng(0).random((2, 1024))
    ray, _ = camera.sample_ray(0.0, 0.0, mi.Point2f(film), mi.Point2f(0.5, 0.5))
    si = scene.ray_intersect(ray)
    si.uv = mi.Point2f(0.3, 0.4)
    seen = np.broadcast_to(np.array(_albedo(wall, si)), (3, 1024))[:, np.array(si.is_valid())]
    if np.ptp(seen, axis=1).max() <= PRECISE * seen.max():
        raise SceneError(
            f"{what} has a texture, and its mesh no UV coordinates; unwrap the mesh (in Blender: "
            "Edit Mode, UV, Smart UV Project) and export it with a material"
        )
