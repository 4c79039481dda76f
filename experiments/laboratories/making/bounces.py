"""Light that reaches the wall by other surfaces: path traced at few pixels, then interpolated.

It is smooth, since it comes from everywhere. So it is traced at a coarse grid of the film, and a
polynomial of low degree takes out what noise is left.
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from experiments.laboratories.making.light import OFFSET, Source, from_source

Array = NDArray[np.float64]

LANES = 1 << 20
"""Paths that are followed at a time."""


def bounced_radiance(
    scene: Any,
    points: Array,
    normal: Array,
    groups: Sequence[Sequence[Source]],
    *,
    bounces: int,
    samples: int,
    seed: int,
) -> Array:
    """Return the light that other surfaces send to wall points, averaged about the cosine lobe.

    Times the wall's reflectance it is the radiance that the camera sees.

    Parameters
    ----------
    scene
        Of Mitsuba; its surfaces are diffuse.
    points, normal
        (n, 3) and (3,) of the wall.
    groups
        Sources, by group.
    bounces
        Reflections at most, that at the wall point counted.
    samples
        Paths of each point.
    seed
        Of the paths.

    Returns
    -------
    ndarray
        (groups, n, 3) the light.
    """
    n = len(points)
    at_once = max(1, LANES // n)
    batches = max(2, -(-samples // at_once))
    first = np.repeat(points.astype(np.float32), at_once, axis=0)
    facing = mi.Vector3f(*normal.tolist())
    means = []
    for batch in range(batches):
        rng = mi.PCG32(size=len(first), initstate=mi.UInt64(1_000_003 * seed + batch))
        light = _paths(scene, mi.Point3f(first.T), facing, groups, bounces, rng)
        means.append(
            [np.array(each, np.float64).T.reshape(n, at_once, 3).mean(axis=1) for each in light]
        )
    return np.asarray(np.mean(means, axis=0))


def _paths(
    scene: Any, points: Any, normal: Any, groups: Sequence[Sequence[Source]], bounces: int, rng: Any
) -> list[Any]:
    """Follow one path from each point; at each surface, one point of each source."""
    tables = [[source.table() for source in group] for group in groups]
    totals = [mi.Color3f(0) for _ in groups]
    throughput = mi.Color3f(1)
    active = mi.Bool(True)
    for _ in range(bounces - 1):
        lobe = mi.Point2f(rng.next_float32(), rng.next_float32())
        direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(lobe))
        ray = mi.Ray3f(points + OFFSET * normal, direction, dr.largest(mi.Float), 0.0, [])
        hit = scene.ray_intersect(ray, active)
        active &= hit.is_valid()
        throughput *= hit.bsdf(ray).eval_diffuse_reflectance(hit, active)
        normal = dr.select(dr.dot(hit.n, direction) > 0, -hit.n, hit.n)
        points = hit.p
        for index, (group, of_group) in enumerate(zip(groups, tables, strict=True)):
            for source, table in zip(group, of_group, strict=True):
                u, v = rng.next_float32(), rng.next_float32()
                origin = points + OFFSET * normal
                light = from_source(scene, origin, normal, source, table, u, v, active)
                totals[index] += throughput * light * (source.area / np.pi)
    dr.eval(totals)
    return totals


def interpolated(positions: Array, values: Array, others: Array, degree: int) -> Array:
    """Return (n, 3) values at film positions in [-1, 1]² as a polynomial has them at others."""
    coefficients, *_ = np.linalg.lstsq(_design(positions, degree), values, rcond=None)
    return np.asarray(_design(others, degree) @ coefficients)


def _design(positions: Array, degree: int) -> Array:
    """Return (n, terms) Chebyshev products, of a degree in both variables together."""
    full = chebyshev.chebvander2d(positions[:, 0], positions[:, 1], [degree, degree])
    order = np.add.outer(np.arange(degree + 1), np.arange(degree + 1)).ravel()
    return np.asarray(full[:, order <= degree])
