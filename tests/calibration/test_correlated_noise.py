from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.calibration.evidence import CorrelatedNoise
from periscopy_sim.numerics import Array

PIXELS = np.ones((40, 50), bool)
PIXELS[:9, 30:] = False
BACKGROUND = np.linalg.qr(np.ones((np.count_nonzero(PIXELS), 1)))[0]


@pytest.fixture
def white() -> CorrelatedNoise:
    return CorrelatedNoise.white(PIXELS, BACKGROUND)


def drawn(noise: CorrelatedNoise, seed: int) -> Array:
    """Return three channels of noise, of deviations 1, 2, 3."""
    random = np.random.default_rng(seed)
    flat = random.standard_normal((len(noise.waves), 3))
    shared = np.sqrt(noise.excess)[:, None] * random.standard_normal((len(noise.excess), 3))
    return np.asarray((flat + noise.waves @ shared) * [1, 2, 3])


def test_waves_are_orthonormal_and_beyond_the_ambient_light(white: CorrelatedNoise) -> None:
    every = np.hstack([BACKGROUND, white.waves])
    assert every.T @ every == pytest.approx(np.eye(every.shape[1]), abs=1e-5)


def test_the_whitened_have_no_covariance(white: CorrelatedNoise) -> None:
    """By a dense inverse of the covariance."""
    noise = white.like(drawn(white.like(np.exp(np.cumsum(drawn(white, 0), axis=0) / 50)), 1))
    assert noise.excess.max() > 1
    covariance = np.eye(len(noise.waves)) + (noise.waves * noise.excess) @ noise.waves.T
    y = drawn(white, 2)
    assert np.sum(noise.whitened(y) ** 2) == pytest.approx(
        np.sum(y * np.linalg.solve(covariance, y)), rel=1e-5
    )


def test_the_variance_of_octaves_is_found(white: CorrelatedNoise) -> None:
    """Of 20 draws, each octave's mean excess within 5 of its own deviations; and white noise's."""
    true = np.where(white.octaves == white.octaves.min(), 60.0, 5.0)
    for excess in (true, 0 * true):
        noise = replace(white, excess=excess)
        found = [white.like(drawn(noise, seed)).excess for seed in range(20)]
        for octave in np.unique(white.octaves):
            waves = np.flatnonzero(white.octaves == octave)
            tolerance = 5 * (1 + excess[waves[0]]) * np.sqrt(2 / 60 / len(waves))
            mean = np.mean(found, axis=0)[waves[0]]
            assert mean == pytest.approx(excess[waves[0]], abs=tolerance)


def test_a_small_wall_and_a_dark_channel_have_no_excess_by_chance() -> None:
    """Of 20 draws, an octave of a third of 64 pixels exceeds 4 times the white noise never."""
    small = CorrelatedNoise.white(np.ones((8, 8), bool), np.full((64, 1), 1 / 8))
    found = [small.like(drawn(small, seed) * [1, 1, 0]).excess for seed in range(20)]
    assert 0 < np.max(found) < 3
