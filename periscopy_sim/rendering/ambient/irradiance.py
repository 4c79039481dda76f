"""Irradiance at points of a wall: direct light from each emitter, and light that has bounced.

Light that has bounced comes from the same surfaces for every point of a wall. So what a ray from
one point meets serves all: that another could have found it, too, the balance heuristic ([1] of
`paths`) takes into account, at the price of a shadow ray for each pair. Hence several paths go on
from there.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array
from periscopy_sim.rendering.paths import PathNumbers, trace_paths
from periscopy_sim.rendering.variant import LANES, dr, mi

SPLIT = 4
"""Paths that go on from what a ray first meets: in a room with windows nine tenths of what a path
varies by come from further on, and to ask all points for that surface takes as long as two."""


def direct_irradiance(
    scene: Any, emitter: Any, points: Array, normals: Array, edges: Array, samples: int, seed: int
) -> Array:
    """Estimate the irradiance (M, 3) that one emitter causes, averaged over small parallelograms.

    They have (M, 3) centres and unit normals and (M, 2, 3) edge vectors. Rays aimed at the emitter
    and cosine-weighted ones, `samples` of each rounded up to a square number, are combined by the
    balance heuristic. The seed is of 32 bits.
    """
    count = math.ceil(math.sqrt(samples)) ** 2
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
    blocked = scene.ray_test(mi.Ray3f(position, toward.d, nearly(toward.dist), 0.0, []), lit)
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
    dr.eval(arriving)  # else computed anew for each component
    return rows_of(dr.block_reduce(dr.ReduceOp.Add, arriving, count)) / count


class BouncedIrradiance:
    """Estimates of the irradiance by light that has bounced, at (m, 3) points just off one wall.

    So many rays are sent from each point; from what each meets, `SPLIT` paths go on.
    """

    def __init__(self, scene: Any, points: Array, normals: Array, rays: int) -> None:
        self._scene, self._points, self._normals, self._rays = scene, points, normals, rays
        self._numbers = PathNumbers(len(points), (rays, (SPLIT - 1) * rays))

    def estimate(self, seed: int) -> Array:
        """Return the irradiance, (m, 3), as estimated by a seed."""
        m = len(self._points)
        light, hits = self._trace(seed)
        irradiance = np.zeros((m, 3))
        at_once = max(1, LANES // m)  # pairs of a path and a point
        for first in range(0, len(light), at_once):
            some = np.arange(first, min(first + at_once, len(light)), dtype=np.uint32)
            form = self._form_factors(some, hits)
            # Σ_j n_j p_j of a hit: the density with which the rays of all points find it.
            found = self._rays * form.sum(axis=1, keepdims=True)
            weight = np.divide(form, found, where=found > 0, out=np.zeros_like(form))
            irradiance += np.pi * weight.T @ light[some]
        return irradiance

    def _trace(self, seed: int) -> tuple[Array, tuple[Any, ...]]:
        """Trace rays in cosine-weighted directions, and the paths that go on from them.

        Return the radiance that each ray brings, (rays, 3), and what all paths first meet, those
        of the rays before others, as `trace_paths` does.
        """
        m, n = len(self._points), self._rays
        numbers = self._numbers.shifted(seed)
        ray_of = np.arange(m * n).reshape(m, 1, n)
        ray_of = mi.UInt32(
            np.concatenate([ray_of.ravel(), np.repeat(ray_of, SPLIT - 1, axis=1).ravel()])
        )
        frame = mi.Frame3f(gathered(mi.Normal3f, self._normals, ray_of // n))
        sample = (dr.gather(mi.Float, numbers(k), ray_of) for k in range(2))
        direction = frame.to_world(mi.warp.square_to_cosine_hemisphere(mi.Point2f(*sample)))
        ray = mi.Ray3f(gathered(mi.Point3f, self._points, ray_of // n), direction)
        light, hits = trace_paths(self._scene, numbers, 2, ray)
        dr.eval(light, hits)
        first, others = np.split(rows_of(light), [m * n])
        others = others.reshape(m, SPLIT - 1, n, 3).sum(axis=1).reshape(m * n, 3)
        return (first + others) / SPLIT, hits

    def _form_factors(self, paths: NDArray[np.uint32], hits: tuple[Any, ...]) -> Array:
        """Return the density of each hit from each point: cosines over π r², 0 where unseen."""
        m = len(self._points)
        pair = dr.arange(mi.UInt32, len(paths) * m)
        path, index = dr.opaque(mi.UInt32, int(paths[0])) + pair // m, pair % m
        own = path // self._rays == index
        position, toward_wall = (
            dr.gather(kind, hits[k], path) for k, kind in enumerate((mi.Point3f, mi.Normal3f))
        )
        valid, diffuse = (dr.gather(mi.Bool, hits[k], path) for k in (2, 3))
        point = gathered(mi.Point3f, self._points, index)
        away = position - point
        distance = dr.norm(away)
        direction = away / distance
        at_wall = dr.dot(gathered(mi.Normal3f, self._normals, index), direction)
        at_hit = -dr.dot(toward_wall, direction)
        # A surface that scatters unequally by direction serves only the path's own point.
        seen = valid & (own | diffuse) & (at_wall > 0) & (at_hit > 0)
        ray = mi.Ray3f(point, direction, nearly(distance), 0.0, [])
        blocked = self._scene.ray_test(ray, seen & ~own)
        form = dr.select(seen & ~blocked, at_wall * at_hit / (dr.pi * dr.square(distance)), 0)
        return np.array(form, dtype=np.float64).reshape(len(paths), m)


def nearly(distance: Any) -> Any:
    """Return how far a shadow ray goes, short of touching the surface at a distance."""
    return distance * (1 - mi.math.ShadowEpsilon)


def gathered(kind: Any, rows: Array, index: Any) -> Any:
    """Return rows, (n, components), at an index, as a Dr.Jit vector of a kind."""
    return dr.gather(kind, kind(np.ascontiguousarray(rows.T, np.float32)), index)


def rows_of(values: Any) -> NDArray[np.float64]:
    """Return (n, components) of a Dr.Jit vector."""
    return np.stack([np.array(component, dtype=np.float64) for component in values], axis=1)
