"""Irradiance at points of a wall: direct light from each emitter, and light that has bounced.

Light that has bounced comes from the same surfaces for every point of a wall. So each path serves
all points: where another point could have found the path's first hit itself, the balance heuristic
[1] takes that into account, at the price of a shadow ray for each pair. Further paths, which cost
none, sharpen the mean of the points, which is where most of the noise lies.

References
----------
[1] Veach, Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH
1995.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.ambient.light_paths import collected
from periscopy_sim.scenario import Array

ALONE = 3
"""Paths that serve the points' mean alone, for each that serves every point and so costs more: in a
room with windows mean and shape were then known alike."""

PAIRS = 1 << 23
"""Pairs of path and point treated at once; bounds the memory."""

POINT = 1e-6
"""Side of a pixel that counts as a point, in metres."""

NEARLY = 1 - 1e-3
"""How far shadow rays go to a surface, short of touching it."""


def pixel_edges(points: Array, normals: Array, shape: tuple[int, int]) -> Array:
    """Return the edges, (M, 2, 3) down and across, of pixels whose centres are the (M, 3) points.

    Pixels of a lone row or column count as square, a lone pixel as a point.
    """
    rows, columns = shape
    grid, normal = points.reshape(*shape, 3), normals.reshape(*shape, 3)
    if rows > 1:
        down = np.asarray(np.gradient(grid, axis=0))
    if columns > 1:
        across = np.asarray(np.gradient(grid, axis=1))
    elif rows > 1:
        across = np.cross(normal, down)
    else:
        across = POINT * np.cross(normal, np.eye(3)[np.abs(normals[0]).argmin()])
    if rows == 1:
        down = np.cross(normal, across)
    return np.stack([down, across], axis=2).reshape(-1, 2, 3)


def direct_irradiance(
    scene: Any, emitter: Any, points: Array, normals: Array, edges: Array, samples: int, seed: int
) -> Array:
    """Estimate the irradiance (M, 3) that one emitter causes, averaged over small parallelograms.

    They have (M, 3) centres and unit normals and (M, 2, 3) edge vectors. Rays aimed at the emitter
    and cosine-weighted ones, `samples` of each rounded up to a square number, are combined by the
    balance heuristic [1]. The seed is of 32 bits.
    """
    import drjit as dr
    import mitsuba as mi

    count = _square(samples)
    sampler = mi.load_dict({"type": "multijitter", "sample_count": count})
    sampler.set_samples_per_wavefront(count)
    sampler.seed(seed, len(points) * count)
    index = dr.arange(mi.UInt32, len(points) * count) // count
    within = sampler.next_2d()
    down, across = (gathered(mi.Vector3f, edges[:, k], index) for k in range(2))
    position = gathered(mi.Point3f, points, index)
    position += (within.x - 0.5) * down + (within.y - 0.5) * across
    normal = gathered(mi.Normal3f, normals, index)
    si = dr.zeros(mi.SurfaceInteraction3f, len(points) * count)
    si.p, si.n, si.sh_frame, si.wi = position, normal, mi.Frame3f(normal), mi.Vector3f(0, 0, 1)
    toward, weight = emitter.sample_direction(si, sampler.next_2d())
    cosine = dr.maximum(dr.dot(normal, toward.d), 0)
    lit = (cosine > 0) & (toward.pdf > 0)
    blocked = scene.ray_test(mi.Ray3f(position, toward.d, toward.dist * NEARLY, 0.0, []), lit)
    aimed = dr.select(toward.delta, 1, toward.pdf / (toward.pdf + cosine * dr.inv_pi))
    arriving = dr.select(lit & ~blocked, weight * cosine * aimed, 0)
    if not mi.has_flag(emitter.flags(), mi.EmitterFlags.Delta):
        # Rays are aimed at texels as if no to_uv turned them: what they miss is met by chance.
        direction = si.sh_frame.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
        hit = scene.ray_intersect(mi.Ray3f(position, direction))
        chance = dr.dot(normal, direction) * dr.inv_pi
        pdf = emitter.pdf_direction(si, mi.DirectionSample3f(scene, hit, si))
        met = (hit.emitter(scene) == mi.EmitterPtr(emitter)) & (chance > 0)
        arriving += dr.select(met, emitter.eval(hit) * dr.pi * chance / (chance + pdf), 0)
    return means_of_blocks(arriving, count)


def bounced_irradiance(scene: Any, points: Array, normals: Array, paths: int, seed: int) -> Array:
    """Estimate the irradiance (m, 3) by light that has bounced, at (m, 3) points just off one wall.

    The paths from each point that serve all are rounded up to passes of a square number each;
    `ALONE` times as many serve the mean alone.
    """
    m = len(points)
    passes = -(-paths * m**2 // PAIRS)
    each = _square(paths / passes)
    total = np.zeros((m, 3))
    seeds = np.random.SeedSequence(seed).generate_state(2 * passes).reshape(-1, 2).tolist()
    for one, another in seeds:
        light, hits = _trace(scene, points, normals, each, one)
        form = _form_factors(scene, points, normals, each, hits)
        # Σ_j n_j p_j of a hit: the density with which the paths of all points find it.
        found = each * form.sum(axis=1, keepdims=True)
        weight = np.divide(form, found, where=found > 0, out=np.zeros_like(form))
        # The points' mean is that of the paths, so that more paths sharpen it.
        more, _ = _trace(scene, points, normals, _square(ALONE * each), another)
        mean = np.concatenate([light, more]).mean(axis=0)
        total += np.pi * (weight.T @ light + mean - light.mean(axis=0))
    return total / passes


def _trace(
    scene: Any, points: Array, normals: Array, each: int, seed: int
) -> tuple[Array, tuple[Any, ...]]:
    """Trace paths in cosine-weighted directions.

    Return the radiance that each brings, (paths, 3), and what it first meets, as `collected` does.
    """
    import drjit as dr
    import mitsuba as mi

    count = each * len(points)
    sampler = mi.load_dict({"type": "multijitter", "sample_count": each})
    sampler.set_samples_per_wavefront(each)
    sampler.seed(seed, count)
    index = dr.arange(mi.UInt32, count) // each
    frame = mi.Frame3f(gathered(mi.Normal3f, normals, index))
    direction = frame.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
    ray = mi.Ray3f(gathered(mi.Point3f, points, index), direction)
    light, hits = collected(scene, sampler, ray)
    dr.eval(light, hits)
    return rows_of(light), hits


def _form_factors(
    scene: Any, points: Array, normals: Array, each: int, hits: tuple[Any, ...]
) -> Array:
    """Return the density of each hit from each point: cosines over π r², 0 where unseen."""
    import drjit as dr
    import mitsuba as mi

    m = len(points)
    pair = dr.arange(mi.UInt32, each * m * m)
    path, index = pair // m, pair % m
    own = path // each == index
    position, toward_wall = (
        dr.gather(kind, hits[k], path) for k, kind in enumerate((mi.Point3f, mi.Normal3f))
    )
    valid, diffuse = (dr.gather(mi.Bool, hits[k], path) for k in (2, 3))
    point = gathered(mi.Point3f, points, index)
    away = position - point
    distance = dr.norm(away)
    direction = away / distance
    at_wall = dr.dot(gathered(mi.Normal3f, normals, index), direction)
    at_hit = -dr.dot(toward_wall, direction)
    # What does not scatter alike in all directions serves the path's own point alone.
    seen = valid & (own | diffuse) & (at_wall > 0) & (at_hit > 0)
    blocked = scene.ray_test(mi.Ray3f(point, direction, distance * NEARLY, 0.0, []), seen & ~own)
    form = dr.select(seen & ~blocked, at_wall * at_hit / (dr.pi * dr.square(distance)), 0)
    return np.array(form, dtype=np.float64).reshape(each * m, m)


def _square(samples: float) -> int:
    """Round up to a square number, as the multi-jittered sampler wants it."""
    return math.ceil(math.sqrt(samples)) ** 2


def means_of_blocks(values: Any, count: int) -> NDArray[np.float64]:
    """Return the means, (n, components), of so many values each in a row of a Dr.Jit vector."""
    import drjit as dr

    dr.eval(values)  # else computed anew for each component
    return rows_of(dr.block_reduce(dr.ReduceOp.Add, values, count)) / count


def gathered(kind: Any, rows: Array, index: Any) -> Any:
    """Return rows, (n, components), at an index, as a Dr.Jit vector of a kind."""
    import drjit as dr

    return dr.gather(kind, kind(np.ascontiguousarray(rows.T, np.float32)), index)


def rows_of(values: Any) -> NDArray[np.float64]:
    """Return (n, components) of a Dr.Jit vector."""
    return np.stack([np.array(component, dtype=np.float64) for component in values], axis=1)
