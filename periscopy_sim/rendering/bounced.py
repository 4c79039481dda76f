"""Light of the monitor that other surfaces send on to the wall: smooth over it, of low rank.

Paths from a few pixels estimate it in independent replicas. Over the wall it is a polynomial of row
and column, of the powers that err least, times `View.paint`; over the patches it is as estimated.
So to the transport matrix of channel c it adds W X_c: W, (M, K), the same for all, X_c of K rows.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from threadpoolctl import threadpool_limits

from periscopy_sim.errors import SceneError
from periscopy_sim.hidden import Hidden
from periscopy_sim.numerics import Array, machine
from periscopy_sim.numerics.validation import InputError, checked_matrix, checked_number
from periscopy_sim.rendering.load import build_scene
from periscopy_sim.rendering.paths import PathNumbers, trace_paths
from periscopy_sim.rendering.shadow_rays import RenderedTransport
from periscopy_sim.rendering.variant import dr, mi, require_vectorized
from periscopy_sim.rendering.wall import camera_of, is_shape, pointer_to, shape_of
from periscopy_sim.rendering.wall_polynomials import REPLICAS, SITES, best_fit, chosen_sites
from periscopy_sim.view import Geometry

DIRECT = 1
"""Reflections of light that goes from the monitor to the wall and to the camera."""

PATHS = 512
"""Paths from each of these pixels in a round of a replica."""

ROUNDS = 96
"""Most rounds."""

BLOCKS = 4
"""Parts of the monitor along each side, each of whose light the polynomials have to follow."""

FINEST = 2.0**-40
"""Radiance in which light is summed: whole numbers add up alike in any order. A white monitor all
around would send a pixel 1 at most."""


@dataclass(frozen=True, eq=False)
class BouncedLight:
    """The light reflected more than once: its part of the transport matrix, per channel.

    Attributes
    ----------
    over_wall
        (M, K) float32, W: functions of the pixel.
    of_patches
        (3, K, N) float32, X_c: by channel and patch.
    relative_error
        Error of a white image's photograph by this light, chance and what polynomials cannot follow
        together: root mean square over pixels and channels, relative to the whole photograph's root
        mean square. For an image of which only a fraction s is lit, chance errs by about
        1 / sqrt(s) times as much.
    """

    over_wall: NDArray[np.float32]
    of_patches: NDArray[np.float32]
    relative_error: float

    @cached_property
    def mean(self) -> NDArray[np.float32]:
        """(K, N) of the channels' mean."""
        return np.asarray(self.of_patches.mean(axis=0, dtype=np.float64), np.float32)

    def rows(self, rows: slice) -> NDArray[np.float32]:
        """Return what is added to some rows of the channels' mean, (rows, N)."""
        with threadpool_limits(1):  # the last bits follow the number of threads
            return np.asarray(self.over_wall[rows] @ self.mean)

    def added_to(self, A: NDArray[np.float32], bounces: int | None) -> "BouncedTransport":
        """Add this to a direct A, (M, N), in place: it becomes the channels' mean."""
        for start in range(0, len(A), 1024):  # so many rows bound the memory
            rows = slice(start, start + 1024)
            A[rows] += self.rows(rows)
        return BouncedTransport(A, self, bounces)

    @cached_property
    def colour(self) -> NDArray[np.float32]:
        """(3, K, N) by which each channel differs from their mean."""
        return self.of_patches - self.mean


@dataclass(frozen=True, eq=False)
class BouncedTransport:
    """The light transport matrix per channel, where surroundings reflect the monitor's light.

    `A @ f` is the photograph, (M, 3), of a hidden image, (N, 3), each channel by its own matrix,
    before `Geometry.channel_gain`. As an array, `np.asarray(A)`, it is the channels' mean, (M, N),
    by which methods work: what channels differ by is smooth over the wall, as ambient light is. So
    NumPy's functions, `np.dot` for one, take the mean too; its operators take none.

    Attributes
    ----------
    mean
        (M, N) float32, direct light and the channels' mean of bounced light.
    bounced
        What has bounced.
    bounces
        Most reflections of a path, 2 or more; None for any number.
    """

    mean: NDArray[np.float32]
    bounced: BouncedLight
    bounces: int | None

    @property
    def shape(self) -> tuple[int, int]:
        """(M, N)."""
        return self.mean.shape[0], self.mean.shape[1]

    __array_ufunc__ = None  # array * A and array @ A must not take the mean silently

    def __matmul__(self, image: NDArray[np.floating[Any]]) -> Array:
        """Return the photograph, (M, 3), of a hidden image, (N, 3); else raise a ValueError."""
        image = np.asarray(image)
        if image.shape != (self.shape[1], 3):
            raise InputError(
                f"the hidden image has shape {image.shape}; its channels have matrices of their "
                f"own: give ({self.shape[1]}, 3)"
            )
        return np.asarray(self.mean @ image + self.beyond_mean(image))

    def beyond_mean(self, images: NDArray[np.floating[Any]]) -> Array:
        """Return what channels send beyond their mean, (..., M, 3), of images (..., N, 3)."""
        sent = np.einsum("ckn,...nc->...kc", self.bounced.colour, images, dtype=np.float64)
        return np.asarray(self.bounced.over_wall @ sent)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the channels' mean, (M, N)."""
        return np.array(self.mean, dtype=dtype, copy=copy)


def render_bounced_light(
    scenario: Geometry,
    *,
    bounces: int | None = None,
    target: float = 2e-4,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> BouncedLight:
    """Estimate the light that bounces, until it is as exact as asked for.

    Parameters
    ----------
    scenario
        The scene.
    bounces
        Most reflections of a path, 2 or more; None of any number.
    target
        `BouncedLight.relative_error` at which to stop: a fifth of a 60 dB photograph's noise.
    seed
        Seed of the paths. The same seed and variant give the same bytes.
    progress
        Called with the fraction done, as estimated.

    Warns
    -----
    RuntimeWarning
        The target was not reached: the light is too noisy, or not smooth over the wall, as that by
        way of a mirror.
    """
    if bounces is not None:
        checked_number(bounces, "bounces", DIRECT + 1, whole=True)
    checked_number(target, "target", 0)
    require_vectorized("light that bounces")
    if clear := scenario.scene.transparent:
        raise SceneError(
            f"scene '{scenario.path}': hidden surface '{clear[0]}' is transparent (null), and "
            "bounced light is computed of opaque ones alone; ask for direct light"
        )
    shape, patches, paint = scenario.photograph_shape, scenario.hidden.patches, scenario.view.paint
    scenario = replace(scenario, view=scenario.view.even)  # light is smooth, a texture is not
    sites, everywhere = chosen_sites(shape), scenario.view.numbers
    trace = make_tracer(scenario, sites, bounces)
    rows = np.random.default_rng(seed).choice(len(everywhere), min(SITES, len(everywhere)), False)
    direct = RenderedTransport(scenario, 1, seed=seed).white(rows)
    seeds = np.random.SeedSequence(seed).generate_state(ROUNDS * REPLICAS).reshape(ROUNDS, -1)
    total = np.zeros((REPLICAS, len(sites), patches, 3))
    error, report = np.inf, machine.rising(progress)
    for done, own in enumerate(seeds.tolist(), 1):
        for replica, one in enumerate(own):
            total[replica] += trace(one)
        with threadpool_limits(1):  # the last bits follow the number of threads
            fit = best_fit(_of_blocks(total, scenario.hidden) / done, sites, shape)
            white = fit.functions(everywhere[rows]) @ fit.coefficients[..., :3].mean(axis=1)
        whole = np.mean((direct[:, np.newaxis] + white) ** 2)
        error = float(np.sqrt(fit.squared_error[:3].mean() / whole)) if whole else 0.0
        report(max(done / ROUNDS, min(1.0, (target / error) ** 2) if error else 1.0))
        if error <= target:
            break
    if error > target:
        warnings.warn(
            f"'{scenario.path.stem}': light that bounces is known to {error:.1e} of the photograph "
            f"only, above {target:.1e}: it is noisy, or not smooth over the wall",
            RuntimeWarning,
            stacklevel=2,
        )
    with threadpool_limits(1):
        light = total.mean(axis=0).reshape(len(sites), -1) / done
        X = np.linalg.lstsq(fit.functions(sites), light, rcond=None)[0].reshape(-1, patches, 3)
        W = fit.functions(everywhere) * paint
    return BouncedLight(W.astype(np.float32), X.transpose(2, 0, 1).astype(np.float32), error)


def add_bounces(
    scenario: Geometry,
    A: NDArray[np.float32],
    bounces: int | None = None,
    *,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> BouncedTransport:
    """Add light that bounces to a direct A, (M, N), in place: it becomes the channels' mean.

    A read-only A is copied. Parameters, errors and warnings are those of `render_bounced_light`.
    """
    A = np.require(checked_matrix(A, "A"), requirements="W")
    bounced = render_bounced_light(scenario, bounces=bounces, seed=seed, progress=progress)
    return bounced.added_to(A, bounces)


def channels_mean(A: NDArray[Any] | BouncedTransport) -> NDArray[Any]:
    """Return the channels' mean of a matrix, (M, N), itself if it is one; memory maps stay such."""
    return A.mean if isinstance(A, BouncedTransport) else A


def make_tracer(
    scenario: Geometry,
    sites: NDArray[np.intp],
    bounces: int | None,
    shown: Any = None,
) -> Callable[[int], Array]:
    """Return the function that estimates bounced light at some pixels by `PATHS` paths from each.

    It maps a seed of 32 bits to (S, N, 3): radiance to the camera for each unit of a patch's normal
    radiance. `bounces` is the most reflections of a path, 2 or more; None for any number. If the
    Mitsuba scene `shown` is given, whose hidden surfaces show images, the function returns their
    light and that of every other emitter, (S, 3). Both leave the wall's colour out.
    """
    # Textured, so that Mitsuba samples points of hidden surfaces by their UV coordinates.
    hidden = scenario.hidden
    white = dict.fromkeys(hidden, np.ones((2, 2, 3)))
    scene = shown or build_scene(scenario.scene, hidden, white, only_hidden=True)
    camera = camera_of(scene, scenario.view.camera)
    wall = shape_of(scene, scenario.view.wall)
    # Opaque, so that photographs and hidden images of all sizes share one compiled kernel.
    rows, columns, patches = (
        dr.opaque(mi.UInt32, size) for size in (*scenario.photograph_shape, hidden.patches)
    )
    sizes = {
        name: [dr.opaque(mi.UInt32, n) for n in (*surface.shape, hidden.slices[name].start)]
        for name, surface in hidden.items()
    }
    shapes = {name: pointer_to(shape_of(scene, name)) for name in hidden}
    lanes = len(sites) * PATHS
    path_numbers = PathNumbers(len(sites), (PATHS,))

    def trace(seed: int) -> Array:
        numbers = path_numbers.shifted(seed)
        site = dr.arange(mi.UInt32, lanes) // PATHS
        pixel = dr.gather(mi.UInt32, mi.UInt32(sites.astype(np.uint32)), site)
        x, y = pixel % columns + numbers(0), pixel // columns + numbers(1)
        ray, _ = camera.sample_ray(
            0.0, 0.0, mi.Point2f(x / columns, y / rows), mi.Point2f(numbers(2), numbers(3))
        )
        si = scene.ray_intersect(ray, +mi.RayFlags.All, True)
        active = is_shape(si, wall)
        # Colour is left to the channels' gain.
        where = mi.Point2f(numbers(5), numbers(6))
        if scenario.view.reflectance is None:
            context, gain = mi.BSDFContext(), mi.Color3f(*map(float, scenario.channel_gain))
            sample, weight = wall.bsdf().sample(context, si, numbers(4), where, active)
            direction, throughput = sample.wo, weight / gain
        else:
            direction = mi.warp.square_to_cosine_hemisphere(where)
            direction.z = dr.mulsign(direction.z, si.wi.z)
            throughput = mi.Color3f(float(np.mean(scenario.view.reflectance)))
        onward = si.spawn_ray(si.to_world(direction))
        begin = {"throughput": throughput, "active": active, "most": bounces}
        if shown is not None:
            light, _ = trace_paths(scene, numbers, 7, onward, **begin)
            dr.eval(light)  # the sums over its channels would each trace it anew
            return np.array(dr.block_sum(light, PATHS), np.float64).T / PATHS
        sums = dr.zeros(mi.Int64, len(sites) * hidden.patches * 3)

        def splat(light: Any, emitter: Any, uv: Any, radiance: Any, active: Any) -> Any:
            """Add radiance, (3,), to what comes from a patch."""
            patch, shape = mi.UInt32(0), emitter.get_shape()
            for name, surface in hidden.items():
                R, C, start = sizes[name]
                across = 1 - uv.x if surface.mirrored else uv.x
                row = dr.minimum(mi.UInt32(dr.maximum(1 - uv.y, 0) * R), R - 1)
                column = dr.minimum(mi.UInt32(dr.maximum(across, 0) * C), C - 1)
                own = start + row * C + column
                patch = dr.select(shape == shapes[name], own, patch)
            at = (site * patches + patch) * 3
            for c in range(3):
                whole = mi.Int64(dr.round(radiance[c] / FINEST))
                dr.scatter_reduce(dr.ReduceOp.Add, sums, whole, at + c, active & (radiance[c] > 0))
            return light

        trace_paths(scene, numbers, 7, onward, **begin, deposit=splat)
        return np.asarray(np.array(sums).reshape(len(sites), -1, 3) * (FINEST / PATHS))

    return trace


def _of_blocks(light: Array, hidden: Hidden) -> Array:
    """Return the sums of patches' light, (..., N, 3), of all and of each block: (..., 3 L)."""
    blocks = [
        (k, down * BLOCKS // R, across * BLOCKS // C)
        for k, (R, C) in enumerate(hidden.shapes.values())
        for down, across in np.ndindex(R, C)
    ]
    _, block = np.unique(blocks, axis=0, return_inverse=True)
    parts = [light[..., block == one, :].sum(axis=-2) for one in np.unique(block)]
    return np.concatenate([sum(parts, np.zeros(())), *parts], axis=-1)
