"""The wall as the camera's own rays meet it: of one material, of one colour, no mirror."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.parsing import one_line
from periscopy_sim.rendering.scene.pointwise import map_points
from periscopy_sim.rendering.variant import is_vectorized
from periscopy_sim.scenario import Array

SLOPES = (0.8, 0, 0.6), (0, 0.8, 0.6)
"""Directions about the wall's normal in which its colour is looked at, too."""


def seen_wall(
    scene: Any, camera: Any, wall: Any, pixels: tuple[int, int], where: str, material: str
) -> tuple[Array, Array, Array | None, Array, float]:
    """Return points, normals, reflectance, channel gain and blur of a `Scenario`.

    `where` and `material` are for messages: a wall that cannot be treated is a SceneError.
    """
    import mitsuba as mi

    if int(wall.bsdf().flags()) & int(mi.BSDFFlags.DeltaReflection):  # shadow rays never find it
        raise SceneError(
            f"{where}: the wall ({material}) reflects as a mirror does, in part or "
            "entirely; use a rough material, such as diffuse or roughplastic"
        )
    rows, columns = pixels
    row, column = np.divmod(np.arange(rows * columns), columns)
    film = np.stack([(column + 0.5) / columns, (row + 0.5) / rows], axis=1)
    try:
        points, normals, shading, views, hit, blur, *colors = map_points(
            _meet(scene, camera, wall), film
        )
    except RuntimeError as error:  # of shapes that Mitsuba builds but cannot trace
        raise SceneError(f"{where}: Mitsuba cannot trace it: {one_line(error)}") from None
    if not hit.all():
        first = divmod(int(np.flatnonzero(~hit[:, 0].astype(bool))[0]), columns)
        raise SceneError(
            f"{where}: {int((hit == 0).sum())} of {hit.size} camera pixels miss the wall, the first"
            f" at row {first[0]}, column {first[1]}; move the camera, its film or what stands "
            "between it and the wall"
        )
    albedo, diffuse = _reflection(wall, colors, where, material)
    # Where a mesh has normals of its own, these count, as they do for the wall's BSDF.
    own = np.abs(shading - normals).max(axis=1, keepdims=True) > 1e-6
    normals = np.where(own, shading, normals)
    normals *= np.sign(np.sum(normals * views, axis=1, keepdims=True))
    reflectance = np.pi * albedo if diffuse else None
    return points, normals, reflectance, albedo / albedo.mean(), float(blur.max())


def _meet(scene: Any, camera: Any, wall: Any) -> Callable[[Any], tuple[Any, ...]]:
    """Return what the camera's ray through a point of the film meets, as a function of that point.

    The wall's point and both its normals, the direction back, whether the whole aperture sees the
    wall, the blur, the reflection to the camera, and that along the normal and along `SLOPES`.
    """
    import drjit as dr
    import mitsuba as mi

    bsdf, context = wall.bsdf(), mi.BSDFContext()
    rim = ((0, 0.5), (1, 0.5), (0.5, 0), (0.5, 1)) if camera.needs_aperture_sample() else ()

    def through(position: Any, aperture: tuple[float, float]) -> tuple[Any, Any, Any]:
        ray, _ = camera.sample_ray(0.0, 0.0, position, mi.Point2f(*aperture))
        si = scene.ray_intersect(ray)
        hit = si.is_valid() & (si.shape == (mi.ShapePtr(wall) if is_vectorized() else wall))
        return si, ray.d, hit

    def meet(position: Any) -> tuple[Any, ...]:
        si, direction, hit = through(position, (0.5, 0.5))
        blur = mi.Float(0)
        for aperture in rim:
            off_axis, _, also_hit = through(position, aperture)
            hit &= also_hit
            blur = dr.maximum(blur, dr.norm(off_axis.p - si.p))
        toward_camera = mi.Vector3f(0, 0, dr.sign(si.wi.z))
        facing = bsdf.eval(context, si, toward_camera)
        si.wi = mi.Vector3f(0, 0, 1)
        colors = [bsdf.eval(context, si, mi.Vector3f(*to)) for to in ((0, 0, 1), *SLOPES)]
        return si.p, si.n, si.sh_frame.n, -direction, hit, blur, facing, *colors

    return meet


def _reflection(wall: Any, colors: list[Array], where: str, material: str) -> tuple[Array, bool]:
    """Albedo over π of a wall of one colour, (3,), and whether it is diffuse."""
    import mitsuba as mi

    facing, color, *tilted = colors
    if not (np.isfinite(facing).all() and np.isfinite(color).all()):
        raise SceneError(f"{where}: the wall's reflectance is not finite ({material}); fix it")
    if not facing.any():
        raise SceneError(
            f"{where}: the wall ({material}) reflects nothing to the camera; turn its "
            "front to the camera or make it two-sided"
        )
    albedo = color.mean(axis=0)
    if np.ptp(color, axis=0).max() > 1e-4 * albedo.max():
        raise SceneError(
            f"{where}: the wall is textured ({material}); only a wall of one uniform "
            "material can be treated"
        )
    slanted = np.array([values.mean(axis=0) for values in tilted])
    mean = slanted.mean(axis=1, keepdims=True) * albedo.mean()
    if (np.abs(slanted * albedo.mean() - mean / albedo.mean() * albedo) > 1e-4 * mean).any():
        raise SceneError(
            f"{where}: the colour of the wall's reflection ({material}) changes with direction; "
            "use a wall of one colour"
        )
    flags = int(wall.bsdf().flags())
    other = int(mi.BSDFFlags.Glossy) | int(mi.BSDFFlags.Delta) | int(mi.BSDFFlags.Delta1D)
    plain = flags & int(mi.BSDFFlags.DiffuseReflection) and not flags & other
    # Not so of a diffuse wall beneath a normal map.
    falls_as_cosine = np.abs(slanted / 0.6 - albedo).max() <= 1e-4 * albedo.max()
    return albedo, bool(plain and falls_as_cosine)
