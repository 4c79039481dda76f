"""Light that reaches the wall by other surfaces: path traced at few pixels, then interpolated.

It is smooth, since it comes from everywhere. So it is traced at a coarse grid of the film, and a
polynomial of low degree takes out what noise is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from experiments.laboratories.making.light import OFFSET, Source, from_source

Array = NDArray[np.float64]


def bounced_radiance(
    scene: Any,
    points: Array,
    normal: Array,
    groups: Sequence[Sequence[Source]],
    *,
    bounces: int,
    samples: int,
    seed: int,
    lanes: int = 1 << 20,
) -> tuple[Array, Array]:
    """Return the light that other surfaces send to wall points, averaged about the cosine lobe.

    Times the wall's reflectance it is the radiance that the camera sees.

    Parameters
    ----------
    scene
        Of Mitsuba; its surfaces are diffuse.
    points
        (n, 3) of the wall.
    normal
        (3,) of the wall.
    groups
        Sources, by group.
    bounces
        Reflections at most, that at the wall point counted.
    samples
        Paths of each point.
    seed
        Of the paths.
    lanes
        Paths at a time.

    Returns
    -------
    tuple of ndarray
        (groups, n, 3) the light, and the standard error of each.
    """
    n = len(points)
    at_once = max(1, lanes // n)
    batches = max(2, -(-samples // at_once))
    first = np.repeat(points.astype(np.float32), at_once, axis=0)
    sums = []
    for batch in range(batches):
        rng = mi.PCG32(size=len(first), initstate=mi.UInt64(1_000_003 * seed + batch))
        facing = mi.Vector3f(*normal.tolist())
        light = _paths(scene, mi.Point3f(first.T), facing, groups, bounces, rng)
        means = [np.array(each, np.float64).T.reshape(n, at_once, 3).mean(axis=1) for each in light]
        sums.append(means)
    of_batches = np.array(sums)
    return of_batches.mean(axis=0), of_batches.std(axis=0, ddof=1) / np.sqrt(batches)


def _paths(
    scene: Any, points: Any, normal: Any, groups: Sequence[Sequence[Source]], bounces: int, rng: Any
) -> list[Any]:
    """Follow one path from each point; at each surface, one point of each source."""
    tables = [[source.table() for source in group] for group in groups]
    totals = [mi.Color3f(0) for _ in groups]
    throughput = mi.Color3f(1)
    active = mi.Bool(True)
    for _ in range(bounces - 1):
        frame = mi.Frame3f(normal)
        lobe = mi.Point2f(rng.next_float32(), rng.next_float32())
        direction = frame.to_world(mi.warp.square_to_cosine_hemisphere(lobe))
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


def smooth_over_film(
    positions: Array, values: Array, degree: int
) -> tuple[chebyshev.Chebyshev | Array, Array]:
    """Fit a polynomial of film positions in [-1, 1]² by least squares.

    Parameters
    ----------
    positions
        (n, 2) column and row.
    values
        (n, 3).
    degree
        Of both variables together.

    Returns
    -------
    tuple of ndarray
        Coefficients for `over_film` and what the polynomial leaves, (n, 3).
    """
    design = _design(positions, degree)
    coefficients, *_ = np.linalg.lstsq(design, values, rcond=None)
    return coefficients, values - design @ coefficients


def over_film(coefficients: Array, positions: Array, degree: int) -> Array:
    """Evaluate the polynomial of `smooth_over_film` at (n, 2) positions: (n, 3)."""
    return _design(positions, degree) @ coefficients


def _design(positions: Array, degree: int) -> Array:
    full = chebyshev.chebvander2d(positions[:, 0], positions[:, 1], [degree, degree])
    order = np.add.outer(np.arange(degree + 1), np.arange(degree + 1)).ravel()
    design: Array = full[:, order <= degree]
    return design
