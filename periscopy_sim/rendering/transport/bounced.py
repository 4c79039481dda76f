"""Light of the monitor that other surfaces send on to the wall: smooth over it, of low rank.

Paths from a few pixels estimate it in independent replicas. Over the wall it is a polynomial of
row and column, of the degree that these replicas say is best (see `rendering.ambient.smoothing`);
over the patches it is as estimated. So to the transport matrix of channel c it adds W X_c: W, (M,
K), the same for all, X_c of K rows.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import VariantError
from periscopy_sim.rendering.ambient.replicas import REPLICAS, SITES
from periscopy_sim.rendering.ambient.smoothing import best_estimate, chosen_sites, polynomials
from periscopy_sim.rendering.transport.kernel import make_kernel
from periscopy_sim.rendering.transport.paths import make_tracer
from periscopy_sim.rendering.variant import is_vectorized, use_variant
from periscopy_sim.scenario import Array, Scenario

TARGET = 2e-4
"""Error of a white image's photograph by what has bounced, over the photograph: a fifth of a 60 dB
photograph's noise."""

PATHS = 512
"""Paths from each of the few pixels in a round of a replica."""

ROUNDS = 32
"""Most rounds."""

BLOCKS = 4
"""Parts of the monitor along each side, each of whose light the polynomials have to follow."""


@dataclass(frozen=True, eq=False)
class BouncedLight:
    """What light that is reflected more than once adds to the transport matrix of each channel.

    Attributes
    ----------
    over_wall
        (M, K) float32, W: functions of the pixel.
    of_patches
        (3, K, N) float32, X_c: by channel and patch.
    relative_error
        Standard error and bias of a white image's photograph by this light, root mean square over
        pixels and channels, relative to the whole photograph's root mean square. Of an image of
        which only a part s is lit it is up to 1 / sqrt(s) times that.
    """

    over_wall: NDArray[np.float32]
    of_patches: NDArray[np.float32]
    relative_error: float

    @cached_property
    def mean(self) -> NDArray[np.float32]:
        """(K, N) of the channels' mean."""
        return self.of_patches.mean(axis=0, dtype=np.float64).astype(np.float32)

    def rows(self, rows: slice) -> NDArray[np.float32]:
        """Return what is added to some rows of the channels' mean, (rows, N)."""
        added: NDArray[np.float32] = self.over_wall[rows] @ self.mean
        return added

    @cached_property
    def colour(self) -> NDArray[np.float32]:
        """(3, K, N) by which each channel differs from their mean."""
        return self.of_patches - self.mean


def render_bounced_light(
    scenario: Scenario,
    *,
    bounces: int | None = None,
    target: float = TARGET,
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
        `BouncedLight.relative_error` at which to stop.
    seed
        Seed of the paths. The same seed and variant give the same bytes.
    progress
        Called with the fraction done, as estimated.

    Returns
    -------
    BouncedLight

    Raises
    ------
    VariantError
        In scalar variants.

    Warns
    -----
    RuntimeWarning
        The target was not reached: the light is too noisy, or not smooth over the wall, as that by
        way of a mirror.
    """
    require_paths()
    report = progress or (lambda _: None)
    shape, hidden = scenario.photograph_shape, scenario.hidden_shape
    sites = chosen_sites(shape, SITES)
    trace = make_tracer(scenario, sites, bounces)
    direct = _direct(scenario, sites, seed)
    unit = float(direct.mean())
    seeds = np.random.SeedSequence(seed).generate_state(ROUNDS * REPLICAS).reshape(ROUNDS, -1)
    total = np.zeros((REPLICAS, len(sites), hidden[0] * hidden[1], 3))
    error, fraction = np.inf, 0.0
    for done, own in enumerate(seeds.tolist(), 1):
        for replica, one in enumerate(own):
            total[replica] += trace(PATHS, one, unit)
        error, basis = _fitted(total / done, sites, scenario, direct)
        near = min(1.0, (target / error) ** 2) if error else 1.0
        fraction = max(fraction, near, done / ROUNDS)
        report(fraction)
        if error <= target:
            break
    if error > target:
        warnings.warn(
            f"'{scenario.path.stem}': light that bounces is known to {error:.1e} of the photograph "
            f"only, above {target:.1e}: it is noisy, or not smooth over the wall",
            RuntimeWarning,
            stacklevel=2,
        )
    seen = total.mean(axis=0).reshape(len(sites), -1) / done
    of_patches = np.linalg.lstsq(basis[sites], seen, rcond=None)[0]
    texture = 1.0 if scenario.wall_texture is None else scenario.wall_texture[:, np.newaxis]
    return BouncedLight(
        (basis * texture).astype(np.float32),
        of_patches.reshape(basis.shape[1], -1, 3).transpose(2, 0, 1).astype(np.float32),
        error,
    )


def require_paths() -> None:
    """Set the variant, and refuse a scalar one by a VariantError."""
    use_variant()
    if not is_vectorized():
        raise VariantError(
            "light that bounces is rendered in llvm_ad_rgb or cuda_ad_rgb only; in scalar variants "
            "take direct light, bounces=1"
        )


def _direct(scenario: Scenario, sites: NDArray[np.intp], seed: int) -> Array:
    """Return what a white image sends straight, (S,)."""
    import drjit as dr
    import mitsuba as mi

    patches = scenario.transport_shape[1]
    entries = make_kernel(scenario, 1, "jittered", 1)
    pixel = mi.UInt32(np.repeat(sites, patches).astype(np.uint32))
    patch = dr.arange(mi.UInt32, len(sites) * patches) % patches
    light = np.array(entries(pixel, patch, dr.opaque(mi.UInt32, seed)), np.float64)
    return np.asarray(light.reshape(len(sites), patches).sum(axis=1))


def _fitted(
    replicas: Array, sites: NDArray[np.intp], scenario: Scenario, direct: Array
) -> tuple[float, Array]:
    """Return the relative error of replicas' mean, (K, S, N, 3), and functions over the wall.

    The functions, (M, K), have to follow the light of the whole monitor and of each of its parts.
    """
    (R, C), shape = scenario.hidden_shape, scenario.photograph_shape
    part = (np.arange(R) * BLOCKS // R)[:, None] * BLOCKS + np.arange(C) * BLOCKS // C
    lights = [replicas.sum(axis=2)]
    lights += [replicas[:, :, part.ravel() == one].sum(axis=2) for one in np.unique(part)]
    found = best_estimate(np.concatenate(lights, axis=-1), sites, shape)
    white = found.replicas[:, sites, :3]
    squared = white.var(axis=0, ddof=1) / len(white) + found.squared_bias[:3]
    whole = direct[:, np.newaxis] + white.mean(axis=0)
    error = float(np.sqrt(np.mean(squared) / np.mean(whole**2)))
    if found.degree is None:  # every pixel was sampled, and is best left alone
        return error, np.eye(len(sites))
    basis, degrees = polynomials(shape)
    return error, basis[:, degrees <= found.degree]
