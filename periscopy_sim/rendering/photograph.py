"""The wall as the camera sees it, path traced."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.rendering.scene.load import build_scene
from periscopy_sim.rendering.scene.wall import camera_of
from periscopy_sim.rendering.variant import dr, mi, require_vectorized
from periscopy_sim.scenario import Scenario

WAVEFRONT = 1 << 24
"""Camera samples traced at once, by one kernel, which nothing can interrupt; bounds the memory."""


def render_photograph(
    scenario: Scenario,
    image: NDArray[np.floating[Any]] | Mapping[str, NDArray[np.floating[Any]]],
    *,
    samples: int = 4096,
    bounces: int | None = None,
    only_monitor: bool = False,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Path trace a photograph of the wall while hidden surfaces show images.

    Parameters
    ----------
    scenario
        The scene.
    image
        (R, C, 3) linear radiance along the monitor's normal, of any R and C; of several hidden
        surfaces a mapping of such by id.
    samples
        Camera samples a pixel, multi-jittered over its area; rounded up to a square number.
    bounces
        Reflections a path may have: 1 is the wall alone, as in A; None traces on until Russian
        roulette ends the path.
    only_monitor
        Remove every other emitter of the scene.
    seed
        Seed of the sampler. The same seed and variant give the same bytes.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray
        (rows, columns, 3) float64 radiance.
    """
    require_vectorized("a photograph")
    images = scenario.hidden.images(image)
    for each in images.values():
        is_image = each.ndim == 3 and each.shape[2] == 3 and each.size > 0
        if not (is_image and 0 <= each.min() <= each.max() < np.inf):
            raise InputError("give the hidden image as (rows, columns, 3), finite and not negative")
    if samples < 1 or (bounces is not None and bounces < 1):
        raise InputError("samples and bounces must be at least 1")
    scene = build_scene(scenario.scene, scenario.hidden, images, only_hidden=only_monitor)
    depth = -1 if bounces is None else bounces + 1
    # Mitsuba's plain path tracer takes a null BSDF for opaque where it samples emitters.
    kind = "volpath" if scenario.scene.transparent else "path"
    camera = camera_of(scene, scenario.view.camera)
    return path_trace(
        scene,
        depth,
        samples=samples,
        seed=seed,
        progress=progress,
        sensor=camera,
        integrator=kind,
    )


def path_trace(
    scene: Any,
    depth: int,
    *,
    samples: int,
    seed: int,
    progress: Callable[[float], None] | None = None,
    sensor: Any = None,
    integrator: str = "path",
) -> Array:
    """Render what a sensor of a Mitsuba scene sees, (rows, columns, 3) radiance, in bounded memory.

    `depth` is Mitsuba's: 2 for one reflection, -1 for any number. The sensor, if not that of id
    ``camera``, needs a sampler that takes square numbers. Its side² strata of a pixel are traced as
    by `mi.render`, but in several wavefronts: independent renderings of fewer samples would have
    larger strata, and larger errors.
    """
    camera = camera_of(scene) if sensor is None else sensor
    tracer = mi.load_dict({"type": integrator, "max_depth": depth})
    columns, rows = (int(n) for n in camera.film().crop_size())
    pixels = rows * columns
    # The multi-jittered sampler takes square numbers: wavefronts, in number a divisor of the side.
    side = math.ceil(math.sqrt(samples))
    wavefronts = min(side, math.ceil(side**2 * pixels / WAVEFRONT))
    side = math.ceil(side / wavefronts) * wavefronts
    at_once = side**2 // wavefronts
    sampler = camera.sampler().clone()
    sampler.set_sample_count(side**2)
    sampler.set_samples_per_wavefront(at_once)
    sampler.seed(dr.opaque(mi.UInt32, seed % 2**32), pixels * at_once)
    pixel = dr.arange(mi.UInt32, pixels * at_once) // dr.opaque(mi.UInt32, at_once)
    corner = mi.Point2f(pixel % columns, pixel // columns)
    total = np.zeros((3, pixels))
    for done in range(1, wavefronts + 1):
        sampler.schedule_state()
        dr.eval()  # one kernel serves all wavefronts
        position = (corner + sampler.next_2d()) / mi.ScalarPoint2f(columns, rows)
        aperture = sampler.next_2d() if camera.needs_aperture_sample() else mi.Point2f(0.5)
        time = camera.shutter_open()
        if camera.shutter_open_time() > 0:
            time += sampler.next_1d() * camera.shutter_open_time()
        ray, weight = camera.sample_ray_differential(time, 0.0, position, aperture)
        light, *_ = tracer.sample(scene, sampler, ray)
        light *= weight
        dr.eval(light)  # the sums over its channels would each trace it anew
        total += np.array(dr.block_sum(light, at_once))
        sampler.advance()
        if progress is not None:
            progress(done / wavefronts)
    return (total.T / side**2).reshape(rows, columns, 3)
