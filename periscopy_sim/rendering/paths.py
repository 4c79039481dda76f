"""Paths through a scene that collect the light of its emitters, and the numbers that draw them.

At every surface that a path meets, a point of an emitter is sampled; the path goes on in a
direction that the surface's BSDF samples, and may meet an emitter by chance. The balance heuristic
[1] weighs the two.

References
----------
[1] Veach, Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH
1995.

[2] Matousek, "On the L2-discrepancy for anchored boxes", Journal of Complexity, 1998.

[3] L'Ecuyer, Lemieux, "Recent advances in randomized quasi-Monte Carlo methods", in "Modeling
uncertainty", 2002.

[4] Owen, "Latin supercube sampling for very high-dimensional simulations", ACM Transactions on
Modeling and Computer Simulation, 1998.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import qmc

from periscopy_sim.rendering.variant import dr, mi

DIMENSIONS = 32
"""Dimensions of the sequence, which takes four bytes per dimension and path: those of the first
five surfaces. With numbers by chance two places took 2.3 and 2.5 times the paths."""

ROUNDS = 8
"""Rounds of hashing shifts and orders: after four, which are usual, neighbours are alike."""

Numbers = Callable[[Any], Any]
"""Maps a dimension, a Dr.Jit integer, to each path's number in [0, 1)."""

Deposit = Callable[[Any, Any, Any, Any, Any], Any]
"""Adds radiance, from an emitter at UV coordinates of its shape, to the light so far, if active."""


class PathNumbers:
    """Numbers in [0, 1) of so many paths from each of several origins, of low discrepancy.

    They are a scrambled Sobol sequence [2] whose digits each seed shifts anew [3], so that
    estimates by several seeds are independent and have no bias. Further dimensions are those of the
    sequence again, its points in a random order [4]. One dimension more orders the paths by origin,
    so that the paths of each origin have low discrepancy, and all of them together.

    Parameters
    ----------
    origins
        Number of origins.
    parts
        Paths from each origin that make a set of low discrepancy by themselves, and further ones:
        paths are ordered by part, then by origin.
    """

    def __init__(self, origins: int, parts: tuple[int, ...]) -> None:
        self._paths = count = origins * sum(parts)
        sequence = qmc.Sobol(1 + DIMENSIONS, rng=np.random.default_rng(0))
        points = sequence.random_base2(int(np.ceil(np.log2(count))))[:count]
        ends = np.cumsum([origins * each for each in parts])[:-1]
        split = np.split(np.arange(count), ends)
        order = np.concatenate([part[points[part, 0].argsort(kind="stable")] for part in split])
        self._digits = mi.UInt32((points[order, 1:].T * 2.0**32).astype(np.uint32).ravel())

    def shifted(self, seed: int) -> Numbers:
        """Return the numbers of a seed of 32 bits, by dimension."""
        dimensions, key = len(self._digits) // self._paths, dr.opaque(mi.UInt32, seed)

        def at(dimension: Any) -> Any:
            dimension = mi.UInt32(dimension)
            shift, order = mi.sample_tea_32(key, dimension // dimensions, ROUNDS)
            path, again = dr.arange(mi.UInt32, self._paths), dimension >= dimensions
            path = dr.select(again, mi.permute_kensler(path, self._paths, order, again), path)
            place = dimension % dimensions * self._paths + path
            shift ^= mi.sample_tea_32(key, ~dimension, ROUNDS)[0]
            return mi.Float((dr.gather(mi.UInt32, self._digits, place) ^ shift) >> 8) * 2.0**-24

        return at


def _add(light: Any, _: Any, __: Any, radiance: Any, active: Any) -> Any:
    return light + dr.select(active, radiance, 0)


def trace_paths(
    scene: Any,
    numbers: Numbers,
    first_number: int,
    ray: Any,
    *,
    throughput: Any = 1.0,
    active: Any = True,
    most: int | None = None,
    deposit: Deposit = _add,
) -> tuple[Any, tuple[Any, ...]]:
    """Return the radiance that paths bring which begin with the rays, and what these meet.

    All are Dr.Jit arrays. Emission that the rays themselves meet is left out. Paths draw `numbers`
    of the dimensions from `first_number` on, and meet `most` surfaces that reflect or emit light at
    most; None for any number. Of what the rays meet, the arrays hold positions, normals towards the
    rays' origins, whether there is a surface, and whether it scatters equally in all directions.
    """
    context = mi.BSDFContext()
    # A BSDF without these scatters equally in all directions; Delta lets light pass straight, too.
    other = int(mi.BSDFFlags.Glossy) | int(mi.BSDFFlags.Delta) | int(mi.BSDFFlags.Delta1D)
    last = min(most or 0xFFFFFFFF, 0xFFFFFFFF)  # of 32 bits

    def balance(alone: Any, pdf: Any, other: Any) -> Any:
        """Return the weight of a sample of a density beside another's; 1 where it is `alone`."""
        weight = pdf / dr.maximum(pdf + other, dr.smallest(mi.Float))
        return dr.select(alone, 1, dr.select(dr.isfinite(weight), weight, 0))

    def body(
        surface: Any, ray: Any, throughput: Any, pdf: Any, delta: Any, light: Any, first: Any,
        active: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """Go on to the next surface, by its number from 1."""
        si = scene.ray_intersect(ray, +mi.RayFlags.All, False, active)  # not coherent
        dimension = first_number + (surface - 1) * 6

        def pair(k: int) -> Any:
            """Return the surface's k-th pair of numbers."""
            return mi.Point2f(numbers(dimension + 2 * k), numbers(dimension + 2 * k + 1))

        # An emitter met by chance.
        emitter = si.emitter(scene, active)
        met = active & (surface > 1) & (emitter != None)  # noqa: E711
        origin = dr.zeros(mi.SurfaceInteraction3f)
        origin.p = ray.o
        there = mi.DirectionSample3f(scene, si, origin)
        sampled = scene.pdf_emitter_direction(origin, there, met & ~delta)
        weight = balance(delta, pdf, sampled)
        light = deposit(light, emitter, si.uv, throughput * emitter.eval(si, met) * weight, met)
        active &= si.is_valid() & (surface < last)
        # A point of an emitter, sampled.
        bsdf = si.bsdf()
        toward, radiance = scene.sample_emitter_direction(si, pair(0), False, active)
        value, bsdf_pdf = bsdf.eval_pdf(
            context, si, si.to_local(toward.d), active & (toward.pdf > 0)
        )
        lit = active & (toward.pdf > 0) & (dr.max(value * radiance) > 0)
        lit &= ~scene.ray_test(si.spawn_ray_to(toward.p), lit)
        weight = balance(toward.delta, toward.pdf, bsdf_pdf)
        gain = throughput * value * weight
        light = deposit(light, toward.emitter, toward.uv, gain * radiance, lit)
        facing = si.n * dr.sign(-dr.dot(si.n, ray.d))
        here = (mi.Point3f(si.p), mi.Normal3f(facing), si.is_valid(), (bsdf.flags() & other) == 0)
        first = tuple(dr.select(surface == 1, a, b) for a, b in zip(here, first, strict=True))
        # The next direction.
        lobe, ends = pair(2)
        sample, gain = bsdf.sample(context, si, lobe, pair(1), active)
        throughput *= gain
        # Russian roulette, as in Mitsuba's path tracer: from five surfaces on.
        strongest = dr.max(throughput)
        chance = dr.select(surface >= 5, dr.minimum(strongest, 0.95), 1)
        active &= (strongest > 0) & (ends < chance)
        throughput *= dr.rcp(dr.select(active, chance, 1))
        ray = si.spawn_ray(si.to_world(sample.wo))
        delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        return surface + 1, ray, throughput, sample.pdf, delta, light, first, active

    nothing = mi.Point3f(0), mi.Normal3f(0), mi.Bool(False), mi.Bool(False)
    state = (
        mi.UInt32(1), ray, mi.Color3f(throughput), mi.Float(0), mi.Bool(False), mi.Color3f(0),
        nothing, mi.Bool(active),
    )  # fmt: skip
    _, _, _, _, _, light, first, *_ = dr.while_loop(state, lambda *state: state[-1], body)
    return light, first
