"""A world of one dimension in closed form: a slat before a row of lights."""

from dataclasses import dataclass

import numpy as np
import pytest

from periscopy_sim.calibration.level import Averaged, ResolutionLevel
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.variant import is_vectorized, use_variant

ROWS, PIXELS, PATCHES = 4, 144, 10
WALL = np.linspace(-1, 1, PIXELS)
LIGHTS = np.linspace(-0.8, 0.8, PATCHES)
TRUTH = np.array([0.05, 0.4])
RULER = np.array([0.02, 0.015])
NEAREST, WIDTH, PENUMBRA = 0.15, 0.3, 0.05


def transport(values):
    """Irradiance past a slat about x = values[0], values[1] of the way to the lights."""
    middle, distance = values
    lit = np.ones((PIXELS, PATCHES))
    for edge, sign in ((middle - WIDTH / 2, -1), (middle + WIDTH / 2, 1)):
        shadow = LIGHTS + (edge - LIGHTS) / (1 - distance)
        lit += sign / (1 + np.exp(-(WALL[:, None] - shadow) / PENUMBRA))
    return np.tile(lit / (1 + (WALL[:, None] - LIGHTS) ** 2), (ROWS, 1))


@dataclass(frozen=True)
class SlatMatrices:
    """All rows of the wall are lit alike."""

    names: tuple[str, ...] = ("middle", "distance")
    hidden_shape: tuple[int, int] = (1, PATCHES)

    def matrix(self, values):
        if not self.is_physical(values):
            raise SceneError(f"the slat is in the wall at distance = {values[1]:.3g}")
        return transport(values)

    def is_physical(self, values):
        return bool(NEAREST < values[1] < 0.9)

    def linearized(self, values):
        sides = [(transport(values + h), transport(values - h)) for h in 1e-5 * np.eye(2)]
        return self.matrix(values), np.array([[(a - b) / 2e-5 for a, b in sides]])

    def point_lights(self, values):
        del values
        return np.tile(np.stack([np.ones(PIXELS), WALL], axis=1), (ROWS, 1))


def slat_level(start=TRUTH, errors=RULER, seed=0, noise=0.002, gain=None, alike=1):
    """A photograph of the slat at the truth, and a ruler that has it at a start.

    Noise is the same over `alike` pixels side by side.
    """
    random = np.random.default_rng(seed)
    image = np.exp(0.3 * np.cumsum(random.standard_normal((PATCHES, 3)), axis=0))  # smooth
    light = transport(TRUTH) @ image
    if gain is not None:
        light = np.tile(gain, ROWS)[:, None] * light
    light += SlatMatrices().point_lights(TRUTH) @ random.standard_normal((2, 3))
    grains = random.standard_normal((ROWS, PIXELS // alike, 3))
    light += noise * np.repeat(grains, alike, axis=1).reshape(-1, 3)
    averaged = Averaged(np.ones((ROWS, PIXELS), bool), light)
    prior = Prior(np.asarray(start, float), np.asarray(errors, float))
    return ResolutionLevel.of(averaged, SlatMatrices(), prior, TRUTH, seed)


@pytest.fixture
def jit():
    """Skip where only the scalar variant works: calibration refuses to crawl."""
    use_variant()
    if not is_vectorized():
        pytest.skip("needs LLVM or CUDA")
