"""Photographs of the wall, as fine as the noise that they serve; each states its own error.

Light that comes straight from the hidden surfaces has sharp shadows: it is A f on a grid of wall
points of its own, by areas where the scene has them, else by shadow rays, finer until two grids
agree. All other light, bounced or of other emitters, is estimated in independent replicas, and
smoothed as far as these allow, as ambient light is. A path tracer, which is older and slower, does
what this cannot.
"""

import itertools
import math
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from threadpoolctl import threadpool_limits

from periscopy_sim.analytic.area_transport import area_transport, has_areas, points_across
from periscopy_sim.errors import SceneError
from periscopy_sim.hidden import Hidden
from periscopy_sim.measurement import allowed_error
from periscopy_sim.numerics import Array, machine
from periscopy_sim.numerics.validation import InputError, checked, checked_number, checked_scene
from periscopy_sim.rendering import bounced, load, wall
from periscopy_sim.rendering.ambient import DIRECT_SAMPLES, RAY, Part, direct_irradiance, refined
from periscopy_sim.rendering.shadow_rays import RenderedTransport
from periscopy_sim.rendering.variant import dr, mi, require_vectorized
from periscopy_sim.rendering.wall_polynomials import chosen_sites
from periscopy_sim.view import LIFT, Geometry, View, rises

SNR = 60.0
"""SNR, in dB, of the photographs that are made where none is asked for: the paper's."""

WAVEFRONT = 1 << 24
"""Camera samples traced at once, by one kernel, which nothing can interrupt; bounds the memory."""

MOST_POINTS = 1 << 21
"""Wall points, at most, that direct light is averaged over; 330,000 take 2 s (chair, two cores)."""

MOST_ENTRIES = 1 << 31
"""Pairs of a wall point and a patch, at most, on a grid of direct light: 6 s of two cores for the
chair by rays. Images that need more are path traced."""

BLOCK = 1 << 26
"""Entries of A at once: 256 MB."""

MAX_ROUNDS = 32
"""Most rounds of samples of other light, as of `render_background`."""

TRACED = 1024, 1 << 18
"""Camera samples a pixel of the path tracer to begin with, and at most."""


@dataclass(frozen=True, eq=False)
class Rendering:
    """A photograph and its own error.

    Attributes
    ----------
    photograph
        (rows, columns, 3) radiance.
    relative_error
        Root mean square error over all pixels and channels, relative to the photograph's root mean
        square: Monte Carlo noise, and what its grid of wall points cannot follow.
    made_for
        SNR, in dB, that it serves; -inf for a given number of samples.
    """

    photograph: Array = field(repr=False)
    relative_error: float
    made_for: float = -math.inf

    @property
    def snr(self) -> float:
        """Signal-to-noise ratio of the photograph itself, in dB."""
        return -20 * math.log10(self.relative_error) if self.relative_error else math.inf


def excess_of(error: float, snr: float) -> tuple[str, ...]:
    """Return a line if a photograph's own error exceeds a third of its noise, of an SNR in dB."""
    if error <= allowed_error(snr):
        return ()
    return (
        f"the photograph's own error is {100 * error:.2g} % of its root mean square "
        f"({-20 * math.log10(error):.0f} dB): more than a third of the noise at {snr:g} dB",
    )


def rendering_of(
    scenario: Geometry,
    image: NDArray[np.floating[Any]] | Mapping[str, NDArray[np.floating[Any]]],
    *,
    snr: float = SNR,
    samples: int | None = None,
    bounces: int | None = None,
    only_monitor: bool = False,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Rendering:
    """Return the photograph of `render_photograph`, which has the parameters, and its error."""
    require_vectorized("a photograph")
    checked_scene(scenario)
    images = scenario.hidden.images(image)
    for each in images.values():
        is_image = each.ndim == 3 and each.shape[2] == 3 and each.size > 0
        if not (is_image and 0 <= each.min() <= each.max() < np.inf):
            raise InputError("give the hidden image as (rows, columns, 3), finite and not negative")
    if not any(each.any() for each in images.values()):
        raise InputError("the hidden image is black: no light reaches the wall; show another one")
    kinds = ("samples", samples, "camera samples"), ("bounces", bounces, "bounces")
    for name, number, kind in kinds:
        if number is not None:
            checked(name, number, kind)
    seed = int(checked_number(seed, "seed", 0, 2**32 - 1, whole=True))
    snr = checked_number(snr, "snr")  # it may be that of faint light beside ambient light
    report, target = machine.rising(progress), allowed_error(snr)
    scene = scenario.scene
    # Pictures have the film's pixels.
    scenario = Geometry(View.of(scene, camera=scenario.view.camera), scenario.hidden)
    other_lights = bool(scene.lights) and not only_monitor
    shown = partial(
        load.build_scene,
        scene,
        scenario.hidden,
        images,
        only_hidden=only_monitor or not other_lights,
    )
    # Rays of other light would take a transparent surface for opaque.
    is_plain, is_clear = scenario.view.reflectance is not None, bool(scene.transparent)
    needs_paths = (other_lights and not is_plain) or (
        is_clear and (other_lights or bounces != bounced.DIRECT)
    )
    direct, error = np.zeros(0), math.inf
    if samples is None and not needs_paths:
        direct, error = _direct_light(scenario, images, target, seed)
    if error == math.inf:
        traced = _path_traced(scenario, shown(), bounces, samples, target, seed, report)
        return Rendering(*traced, -math.inf if samples else snr)
    report(0.5)
    light, rest = np.zeros_like(direct), 0.0
    if bounces != bounced.DIRECT or other_lights:
        parts = _other_light(scenario, shown(), other_lights=other_lights, bounces=bounces)
        within = math.sqrt(max(target**2 - error**2, (target / 3) ** 2))
        light, rest = _smoothed(
            parts, scenario, direct, within, seed, lambda done: report((1 + done) / 2)
        )
    picture = np.maximum(direct + scenario.channel_gain * scenario.view.paint * light, 0)
    error *= math.sqrt(np.mean(direct**2) / np.mean(picture**2))
    report(1.0)
    return Rendering(picture.reshape(*scenario.photograph_shape, 3), math.hypot(error, rest), snr)


def render_photograph(
    scenario: Geometry,
    image: NDArray[np.floating[Any]] | Mapping[str, NDArray[np.floating[Any]]],
    *,
    snr: float = SNR,
    samples: int | None = None,
    bounces: int | None = None,
    only_monitor: bool = False,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Render a photograph of the wall while hidden surfaces show images.

    Parameters
    ----------
    scenario
        The scene.
    image
        (R, C, 3) linear radiance along the monitor's normal, of any R and C; of several hidden
        surfaces a mapping of such by id.
    snr
        Signal-to-noise ratio, in dB, of the noise that the photograph will be given: its own error
        is at most a third of that, within a budget of some 20 s. No noise is added.
    samples
        Camera samples a pixel of Mitsuba's path tracer, which then renders the photograph, whatever
        the `snr`; rounded up to twice a square number. None lets the `snr` decide.
    bounces
        Reflections a path may have: 1 is the wall alone, as in A; None traces on until Russian
        roulette ends the path.
    only_monitor
        Remove every other emitter of the scene.
    seed
        Seed of all samples. The same seed and variant give the same bytes.
    progress
        Called with the fraction done.

    Returns
    -------
    ndarray
        (rows, columns, 3) float64 radiance; `rendering_of` also returns its error.

    Warns
    -----
    RuntimeWarning
        The photograph's own error exceeds a third of the noise.
    """
    rendering = rendering_of(
        scenario, image, snr=snr, samples=samples, bounces=bounces, only_monitor=only_monitor,
        seed=seed, progress=progress,
    )  # fmt: skip
    for line in excess_of(rendering.relative_error, rendering.made_for):
        warnings.warn(line, RuntimeWarning, stacklevel=2)
    return rendering.photograph


def bounced_light(scenario: Geometry, images: Mapping[str, Array], seed: int = 0) -> Array:
    """Return the light on a grey wall, (M, C), that images send by way of other surfaces, roughly.

    A direct A lacks it. Images are (rows, columns, C) by id; negative values are black. Surfaces
    reflect three channels as red, green and blue; any other channel as the mean of these.
    """
    seeds = (_seed(seed, number) for number in itertools.count())
    light, channels = list[Array](), next(iter(images.values())).shape[2]
    for some in [[0, 1, 2]] if channels == 3 else [[channel] * 3 for channel in range(channels)]:
        shown = {name: np.maximum(image[..., some], 0) for name, image in images.items()}
        scene = load.build_scene(scenario.scene, scenario.hidden, shown, only_hidden=True)
        (part,) = _other_light(scenario, scene, other_lights=False, bounces=None)
        part.add_round(seeds)
        of_three = part.fit.replicas.mean(axis=0)
        light.append(of_three if channels == 3 else of_three.mean(axis=1, keepdims=True))
    return np.asarray(np.hstack(light) * scenario.view.paint)


def detail_light(scenario: Geometry, images: Mapping[str, NDArray[np.floating[Any]]]) -> Array:
    """Return the light on a grey wall, (M, C), of detail within patches that images suggest.

    Images are (rows, columns, C) by id. The detail is a linear interpolation to half as large
    patches, less its mean in each patch. Its light is rough: on the first grid of `_direct_light`.
    """
    details = {}
    for name, image in images.items():
        fine = ndimage.zoom(image, (2, 2, 1), order=1, mode="nearest", grid_mode=True)
        mean = fine.reshape(len(image), 2, -1, 2, image.shape[2]).mean(axis=(1, 3))
        details[name] = fine - mean.repeat(2, axis=0).repeat(2, axis=1)
    finer = scenario.averaged(points_across(scenario.photograph_shape))
    return _by_channel(_light_by_areas, *_shown(finer, details))


def _direct_light(
    scenario: Geometry, images: Mapping[str, Array], target: float, seed: int
) -> tuple[Array, float]:
    """Return the light, (M, 3), that comes straight from hidden surfaces, and its relative error.

    It is averaged over the points of a grid in each pixel. By areas the last two grids bound the
    finer one's error, which falls as the points' number^-0.75 at edges of shadows. By rays two
    independent renderings on different grids show the error of their mean. The error is infinite
    where two grids exceed the budget, or an edge of a pixel misses the wall.
    """
    scenario, f = _shown(scenario, images)
    (M, N), first = scenario.transport_shape, points_across(scenario.photograph_shape)

    def light_of(across: int, way: Callable[[Geometry, Array], Array] = _light_by_areas) -> Array:
        return _by_channel(way, scenario.averaged(across), f) * scenario.channel_gain

    light, error = np.zeros((M, 3)), math.inf
    with suppress(SceneError):
        if has_areas(scenario.averaged(3 * first)):
            across, finer, most = 0, first, MOST_ENTRIES // N
            while error > target and M * finer**2 <= most:
                coarse, light = light, light_of(finer)
                if across:
                    fall, most = (finer / across) ** 1.5, min(most, MOST_POINTS)
                    error = 2 * _half_difference(light, coarse, light) / (fall - 1)
                # Odd multiples of the first grid: A, by default, has the first or even ones.
                times = min((error / target) ** (2 / 3), 3.0)
                across, odd = finer, finer // first
                finer = first * (odd + 2 * max(1, math.ceil(odd * (times - 1) / 2)))
            return light, error
        grids, samples = (2 * first, 2 * first + 1), 1
        most = MOST_ENTRIES // (M * N * sum(each**2 for each in grids))
        while error > target and samples < 2 * most:
            one, other = (
                light_of(each, partial(_light_by_rays, samples, _seed(seed, number)))
                for number, each in enumerate(grids)
            )
            light = (one + other) / 2
            error = _half_difference(one, other, light)
            # At edges of shadows the error falls as samples^-0.75.
            wanted = samples * max(4.0, (error / target) ** (4 / 3))
            samples = 2 ** math.ceil(math.log2(max(min(wanted, most), 2 * samples)))
    return light, error


def _shown(scenario: Geometry, images: Mapping[str, Array]) -> tuple[Geometry, Array]:
    """Return a scenario in the patches of images, and these, (N, C)."""
    sizes = {name: (each.shape[0], each.shape[1]) for name, each in images.items()}
    finer = replace(scenario, hidden=Hidden.of_scene(scenario.scene, sizes))
    return finer, np.concatenate([each.reshape(-1, each.shape[2]) for each in images.values()])


def _half_difference(one: Array, other: Array, light: Array) -> float:
    """Return the root mean square of half the difference of two lights, relative to that of one."""
    scale = 2 * float(np.sqrt(np.mean(light**2))) or 1.0
    return float(np.sqrt(np.mean((one - other) ** 2))) / scale


def _by_channel(light: Callable[[Geometry, Array], Array], scenario: Geometry, f: Array) -> Array:
    """Return light, (M, C), before the wall's gain; of a texture's three by an A for each."""
    view = scenario.view
    if view.texture is None or f.shape[1] != 3:
        return light(scenario, f)
    each = (replace(scenario, view=view.of_channel(channel)) for channel in range(3))
    return np.hstack([light(s, f[:, [c]]) for c, s in enumerate(each)]) / view.channel_gain


def _light_by_areas(scenario: Geometry, f: Array) -> Array:
    """Return A f, (M, C), by areas, a block of pixels at a time."""
    view, M = scenario.view, scenario.transport_shape[0]
    rows = max(1, BLOCK // len(f) // view.shape[1]) * view.shape[1]
    light = []
    for start in range(0, M, rows):
        some = np.zeros(M, bool)
        some[start : start + rows] = True
        part = Geometry(view.of_pixels(some.reshape(view.shape)), scenario.hidden)
        light.append(area_transport(part).astype(np.float64) @ f)
    return np.concatenate(light)


def _light_by_rays(samples: int, seed: int, scenario: Geometry, f: Array) -> Array:
    """Return A f, (M, C), by shadow rays from each wall point to each patch."""
    rays = RenderedTransport(scenario, samples, seed=seed)
    return np.concatenate([block.astype(np.float64) @ f for _, block in rays.row_blocks()])


def _seed(seed: int, number: int) -> int:
    """Return the seed of 32 bits of one of several independent parts."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def _other_light(
    scenario: Geometry, scene: Any, *, other_lights: bool, bounces: int | None
) -> list[Part]:
    """Return the parts of light that do not come straight from hidden surfaces, on an even wall."""
    scenario = replace(scenario, view=scenario.view.even)
    view, shape, parts = scenario.view, scenario.photograph_shape, list[Part]()
    everywhere, M = np.arange(len(view.points)), len(view.points)
    if other_lights:
        gain = float(view.albedo.mean()) / np.pi
        lift = LIFT * float(np.linalg.norm(np.ptp(view.centers, axis=0)))
        height = np.maximum(lift, rises(view.centers, view.center_normals, shape))
        points = view.centers + height[:, None] * view.center_normals
        surface = points, view.center_normals, view.edges, DIRECT_SAMPLES
        own = [wall.shape_of(scene, name).emitter() for name in scenario.hidden]

        def reflected(emitter: Any, seed: int) -> Array:
            return np.asarray(gain * direct_irradiance(scene, emitter, *surface, seed))

        others = (emitter for emitter in scene.emitters() if emitter not in own)
        work = M * DIRECT_SAMPLES
        parts += [Part(partial(reflected, each), everywhere, shape, work) for each in others]
    if bounces != bounced.DIRECT:
        sites = chosen_sites(shape)
        tracer = bounced.make_tracer(scenario, sites, bounces, scene)
        parts.append(Part(tracer, sites, shape, len(sites) * bounced.PATHS * RAY))
    return parts


def _smoothed(
    parts: list[Part],
    scenario: Geometry,
    direct: Array,
    target: float,
    seed: int,
    progress: Callable[[float], None],
) -> tuple[Array, float]:
    """Return the light of parts on an even wall, (M, 3), and its error relative to all light."""
    painted = scenario.channel_gain * scenario.view.paint

    def errors_of(replicas: Array, squared_bias: Array) -> tuple[float, ...]:
        whole = direct + replicas.mean(axis=0) * painted
        variance = replicas.var(axis=0, ddof=1) / len(replicas) + squared_bias
        return (float(np.sqrt((variance * painted**2).mean() / (whole**2).mean())),)

    seeds = (_seed(seed, number) for number in itertools.count())
    with threadpool_limits(1):  # the last bits follow the number of threads
        light, (error,) = refined(parts, target, MAX_ROUNDS, seeds, progress, errors_of)
    return light, error


def _path_traced(
    scenario: Geometry,
    scene: Any,
    bounces: int | None,
    samples: int | None,
    target: float,
    seed: int,
    progress: Callable[[float], None],
) -> tuple[Array, float]:
    """Return a photograph by Mitsuba's path tracer, of so many samples, or as the target asks.

    Its error, too: half the difference of two renderings of half the samples.
    """
    # Mitsuba's plain path tracer takes a null BSDF for opaque where it samples emitters.
    kind = "volpath" if scenario.scene.transparent else "path"
    depth = -1 if bounces is None else bounces + 1
    camera, count = wall.camera_of(scene, scenario.view.camera), samples or TRACED[0]

    def half(number: int) -> Array:
        return path_trace(
            scene, depth, samples=-(-count // 2), seed=_seed(seed, number),
            progress=lambda done: progress((number + done) / 2), sensor=camera, integrator=kind,
        )  # fmt: skip

    while True:
        first, second = half(0), half(1)
        picture = (first + second) / 2
        error = _half_difference(first, second, picture)
        # The error falls as the samples' root at least.
        wanted = min(math.ceil(1.2 * count * (error / target) ** 2), TRACED[1])
        if samples is not None or error <= target or wanted <= count:
            return picture, error
        count = wanted


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
    camera = wall.camera_of(scene) if sensor is None else sensor
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
