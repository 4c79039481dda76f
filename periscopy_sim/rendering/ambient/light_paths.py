"""Paths from a wall that collect the light of emitters, but for those that their first rays meet.

At every surface that a path meets, points of all emitters are sampled; the path goes on in a
direction that the surface's BSDF samples, and may meet an emitter by chance. The balance heuristic
[1] weighs the two. To ask all of three emitters took a sixth more time than to draw one of them,
which leaves the light of the others to later paths.

References
----------
[1] Veach, Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH
1995.
"""

from __future__ import annotations

from typing import Any

from periscopy_sim.rendering.roulette import survivors

FEW = 8
"""Emitters that are all asked at every surface; of more, one is drawn by their sampling weights.
Timed with three."""


def scatters_alike(flags: Any) -> Any:
    """Return whether a BSDF with these flags scatters alike in all directions."""
    import mitsuba as mi

    # Delta includes what lets light pass straight.
    other = int(mi.BSDFFlags.Glossy) | int(mi.BSDFFlags.Delta) | int(mi.BSDFFlags.Delta1D)
    return (flags & other) == 0


def collected(scene: Any, numbers: Any, first_number: int, ray: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the radiance that paths bring which begin with the rays, and what these meet.

    All are Dr.Jit arrays. `numbers.at` tells each path's number in [0, 1) of a dimension, of which
    those from `first_number` on are used. Emission that the rays themselves meet is left out. What
    they meet is told by positions, normals towards the rays' origins, whether there is a surface at
    all, and whether it scatters alike in all directions.
    """
    import drjit as dr
    import mitsuba as mi

    context = mi.BSDFContext()
    emitters = scene.emitters()
    asked = emitters if len(emitters) <= FEW else [scene]
    each_surface = 2 * len(asked) + 4

    def sampled(emitter: Any, si: Any, sample: Any, active: Any) -> Any:
        """Sample a direction to an emitter, or, by the scene, to one of its emitters."""
        if emitter is scene:
            return scene.sample_emitter_direction(si, sample, False, active)
        return emitter.sample_direction(si, sample, active)

    def pdf_of_met(emitter: Any, origin: Any, met: Any, active: Any) -> Any:
        """Return the density with which it would have been sampled."""
        if asked is emitters:
            return emitter.pdf_direction(origin, met, active)
        return scene.pdf_emitter_direction(origin, met, active)

    def balance(alone: Any, pdf: Any, other: Any) -> Any:
        """Return the weight of what was sampled with a density, and might have been with another.

        It is 1 where the other could not.
        """
        weight = pdf / dr.maximum(pdf + other, dr.smallest(mi.Float))
        return dr.select(alone, 1, dr.select(dr.isfinite(weight), weight, 0))

    def body(
        surface: Any, ray: Any, throughput: Any, pdf: Any, delta: Any, light: Any, first: Any,
        active: Any,
    ) -> tuple[Any, ...]:  # fmt: skip
        """Go on to the next surface, by its number from 1."""
        si = scene.ray_intersect(ray, +mi.RayFlags.All, False, active)
        dimension = first_number + (surface - 1) * each_surface

        def pair(k: int) -> Any:
            """Return the surface's k-th pair of numbers."""
            return mi.Point2f(numbers.at(dimension + 2 * k), numbers.at(dimension + 2 * k + 1))

        # An emitter met by chance.
        emitter = si.emitter(scene, active)
        met = active & (surface > 1) & (emitter != None)  # noqa: E711
        origin = dr.zeros(mi.SurfaceInteraction3f)
        origin.p = ray.o
        there = mi.DirectionSample3f(scene, si, origin)
        weight = balance(delta, pdf, pdf_of_met(emitter, origin, there, met & ~delta))
        light += dr.select(met, throughput * emitter.eval(si, met) * weight, 0)
        active &= si.is_valid()
        # Points of emitters, sampled.
        bsdf = si.bsdf()
        for k, each in enumerate(asked):
            toward, radiance = sampled(each, si, pair(k), active)
            local = si.to_local(toward.d)
            value, bsdf_pdf = bsdf.eval_pdf(context, si, local, active & (toward.pdf > 0))
            lit = active & (toward.pdf > 0) & (dr.max(value * radiance) > 0)
            lit &= ~scene.ray_test(si.spawn_ray_to(toward.p), lit)
            weight = balance(toward.delta, toward.pdf, bsdf_pdf)
            light += dr.select(lit, throughput * value * radiance * weight, 0)
        facing = si.n * dr.sign(-dr.dot(si.n, ray.d))
        here = (mi.Point3f(si.p), mi.Normal3f(facing), si.is_valid(), scatters_alike(bsdf.flags()))
        first = tuple(dr.select(surface == 1, a, b) for a, b in zip(here, first, strict=True))
        # The next direction.
        lobe, ends = pair(len(asked) + 1)
        sample, gain = bsdf.sample(context, si, lobe, pair(len(asked)), active)
        throughput, active = survivors(surface, throughput * gain, ends, active)
        ray = si.spawn_ray(si.to_world(sample.wo))
        delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        return surface + 1, ray, throughput, sample.pdf, delta, light, first, active

    nothing = mi.Point3f(0), mi.Normal3f(0), mi.Bool(False), mi.Bool(False)
    state = (
        mi.UInt32(1), ray, mi.Color3f(1), mi.Float(0), mi.Bool(False), mi.Color3f(0), nothing,
        mi.Bool(True),
    )  # fmt: skip
    _, _, _, _, _, light, first, *_ = dr.while_loop(state, lambda *state: state[-1], body)
    return light, first
