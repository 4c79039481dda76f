"""Paths from the wall on, of which each carries light of the monitor's patches to the camera.

A path leaves a point of the wall that the camera sees. At every surface that it meets from there on
a point of the monitor is sampled, and light from there counts for its patch; so does light where
the path itself meets the monitor. The balance heuristic [1] weighs the two. The monitor's light
straight on the wall is not among it: that is A's own.

References
----------
[1] Veach, Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", SIGGRAPH
1995.
[2] M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.rendering.roulette import survivors
from periscopy_sim.rendering.scene.load import build_scene, camera_of, shape_of
from periscopy_sim.rendering.scene.pointwise import surface_at
from periscopy_sim.rendering.transport.kernel import monitor_profile
from periscopy_sim.scenario import Array, Scenario

LATTICE = 6
"""Dimensions of a path that are spread evenly: the pixel's area, the first direction, the first
point of the monitor."""

FINEST = 2.0**-40
"""Radiance in which light is summed: whole numbers add up alike in any order. A white monitor all
around would send a pixel 1 at most."""

Sums = NDArray[np.int64]


def make_tracer(
    scenario: Scenario, sites: NDArray[np.intp], bounces: int | None
) -> Callable[[int, int], Array]:
    """Return the function that estimates bounced light at some pixels by so many paths from each.

    It maps the number of paths and a seed of 32 bits to (S, N, 3): radiance to the camera for each
    unit of a patch's normal radiance, as if the wall reflected its mean albedo there. `bounces` is
    the most reflections of a path, 2 or more; None for any number.
    """
    import drjit as dr
    import mitsuba as mi

    scene = build_scene(scenario)
    camera = camera_of(scene)
    wall, monitor = shape_of(scene, "wall"), shape_of(scene, "monitor")
    profile = monitor_profile(scenario, monitor.emitter())
    context = mi.BSDFContext()
    rows, columns = scenario.photograph_shape
    R, C = scenario.hidden_shape
    pixels = mi.UInt32(sites.astype(np.uint32))
    most = np.uint32(0xFFFFFFFF if bounces is None else bounces)

    def first_surface(site: Any, even: Callable[[int], Any], lens: Any) -> Any:
        """Return where the camera sees the wall in a pixel, and whether it does."""
        pixel = dr.gather(mi.UInt32, pixels, site)
        x, y = pixel % columns + even(0), pixel // columns + even(1)
        film = mi.Point2f(x / columns, y / rows)
        ray, _ = camera.sample_ray(0.0, 0.0, film, lens)
        si = scene.ray_intersect(ray, +mi.RayFlags.All, True)
        return si, si.is_valid() & (si.shape == mi.ShapePtr(wall))

    def leave(si: Any, choice: Any, even: Callable[[int], Any], active: Any) -> tuple[Any, Any]:
        """Sample a direction from the wall; return it and the throughput.

        A texture is left to A's rows, and colour to the channels' gain.
        """
        where = mi.Point2f(even(2), even(3))
        if scenario.wall_reflectance is None:
            sample, weight = wall.bsdf().sample(context, si, choice, where, active)
            return si.to_world(sample.wo), weight / mi.Color3f(*map(float, scenario.channel_gain))
        local = mi.warp.square_to_cosine_hemisphere(where)
        local.z = dr.mulsign(local.z, si.wi.z)
        return si.to_world(local), mi.Color3f(float(np.mean(scenario.wall_reflectance)))

    def column(uv: Any) -> Any:
        """Return the number of the patch at the monitor's coordinates."""
        across = 1 - uv.x if scenario.mirrored else uv.x
        row = dr.minimum(mi.UInt32(dr.maximum(1 - uv.y, 0) * R), R - 1)
        return row * C + dr.minimum(mi.UInt32(dr.maximum(across, 0) * C), C - 1)

    def emitted(light: Any, direction: Any, squared_distance: Any) -> tuple[Any, Any]:
        """Return radiance in a direction, over the normal's, and the pdf of sampling its point.

        Points are spread evenly over the UV square; the pdf is over directions from where light is
        sent.
        """
        cosine = dr.dot(light.n, direction)
        area = dr.norm(dr.cross(light.dp_du, light.dp_dv))
        lit = cosine > 1e-6
        pdf = squared_distance / dr.select(lit, area * cosine, 1)
        towards = profile(mi.SurfaceInteraction3f(light), direction)
        return dr.select(lit, towards, 0), dr.select(lit, pdf, 0)

    def trace(paths: int, seed: int) -> Array:
        lanes = dr.arange(mi.UInt32, len(sites) * paths)
        site, index = lanes // paths, lanes % dr.opaque(mi.UInt32, paths)
        start = dr.opaque(mi.UInt32, seed)
        # Numbers in a row as states would give every lane the same sequence, shifted.
        state, sequence = mi.sample_tea_32(lanes, start, 6)
        rng = mi.PCG32(initstate=mi.UInt64(state), initseq=mi.UInt64(sequence))
        even = _even_points(mi, site, index, start)
        lens = mi.Point2f(rng.next_float32(), rng.next_float32())
        sums = dr.zeros(mi.Int64, len(sites) * R * C * 3)

        def splat(uv: Any, radiance: Any, active: Any) -> None:
            """Add radiance, (3,), to what comes from a patch."""
            at = (site * (R * C) + column(uv)) * 3
            for c in range(3):
                whole = mi.Int64(dr.round(radiance[c] / FINEST))
                dr.scatter_reduce(dr.ReduceOp.Add, sums, whole, at + c, active & (radiance[c] > 0))

        si, active = first_surface(site, even, lens)
        direction, throughput = leave(si, rng.next_float32(), even, active)
        ray = si.spawn_ray(direction)

        def body(
            surface: Any, ray: Any, throughput: Any, pdf: Any, delta: Any, rng: Any, active: Any
        ) -> tuple[Any, ...]:
            """Go on to the next surface, by its number from the wall's point on."""
            si = scene.ray_intersect(ray, +mi.RayFlags.All, False, active)  # not coherent
            active &= si.is_valid()
            # The monitor met by chance. From the wall's point itself it is direct light: its pdf is
            # given as 0, and so is its weight.
            met = active & (si.shape == mi.ShapePtr(monitor))
            radiance, emitter_pdf = emitted(si, -ray.d, dr.square(si.t))
            weight = dr.select(delta, 1, pdf / dr.maximum(pdf + emitter_pdf, dr.smallest(mi.Float)))
            splat(si.uv, throughput * radiance * weight, met & (radiance > 0))
            # A point of the monitor, sampled.
            active &= surface < most
            first = surface == 1
            down = dr.select(first, even(4), rng.next_float32())
            across = dr.select(first, even(5), rng.next_float32())
            light = surface_at(monitor, mi.Point2f(across, down))
            to_light = light.p - si.p
            squared_distance = dr.squared_norm(to_light)
            direction = to_light * dr.rsqrt(squared_distance)
            radiance, emitter_pdf = emitted(light, -direction, squared_distance)
            bsdf = si.bsdf()
            lit = active & light.is_valid() & (radiance > 0)
            value, bsdf_pdf = bsdf.eval_pdf(context, si, si.to_local(direction), lit)
            lit &= dr.max(value) > 0
            lit &= ~scene.ray_test(si.spawn_ray_to(light.p), lit)
            splat(light.uv, throughput * value * radiance / (emitter_pdf + bsdf_pdf), lit)
            # The next direction.
            sample, gain = bsdf.sample(
                context, si, rng.next_float32(),
                mi.Point2f(rng.next_float32(), rng.next_float32()), active,
            )  # fmt: skip
            throughput *= gain
            number = rng.next_float32()
            throughput, active = survivors(surface, throughput, number, active)
            ray = si.spawn_ray(si.to_world(sample.wo))
            delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            return surface + 1, ray, throughput, sample.pdf, delta, rng, active

        state = mi.UInt32(1), ray, throughput, mi.Float(0), mi.Bool(False), rng, active
        dr.while_loop(state, lambda *state: state[-1], body)
        whole: Sums = np.array(sums).reshape(len(sites), R * C, 3)
        return np.asarray(whole * (FINEST / paths))

    return trace


def _even_points(mi: Any, site: Any, index: Any, seed: Any) -> Callable[[int], Any]:
    """Return a function of the dimension: numbers in (0, 1), spread evenly over a site's paths.

    They are of the sequence R of `LATTICE` dimensions [2], shifted at random for each site.
    """
    golden = 2.0
    for _ in range(64):
        golden = (1 + golden) ** (1 / (LATTICE + 1))

    def even(dimension: int) -> Any:
        step = round(2**32 * golden ** -(dimension + 1))
        shift, _ = mi.sample_tea_32(site, seed + mi.UInt32(dimension * 0x9E3779B9 & 0xFFFFFFFF), 6)
        return (mi.Float((shift + index * mi.UInt32(step)) >> 9) + 0.5) / (1 << 23)

    return even
