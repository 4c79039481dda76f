"""A world of one dimension in closed form: a slat before a row of lights, and noisy rendering."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from periscopy_sim.calibration.calibrate_levels import calibrate_levels
from periscopy_sim.calibration.consider_analysis import UncertainParameters
from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.image_fit import fit_image
from periscopy_sim.calibration.explanation.resolution_level import Rays, Resolution, ResolutionLevel
from periscopy_sim.calibration.explanation.smooth_gain import SmoothGain

from periscopy_sim.calibration import calibrate_levels as search
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from periscopy_sim.rendering.variant import is_vectorized, use_variant
from periscopy_sim.shipped import find_scene

PIXELS, PATCHES = 144, 10
HIDDEN = (1, PATCHES)
WALL = np.linspace(-1, 1, PIXELS)
LIGHTS = np.linspace(-0.8, 0.8, PATCHES)
LIGHT = np.linalg.qr(np.stack([np.ones(PIXELS), WALL], axis=1))[0]
TRUTH = np.array([0.05, 0.4])
ERRING = TRUTH + np.array([0.02, -0.015])
NOTHING = UncertainParameters((), np.empty(0), np.empty(0))
NEAREST, WIDTH, PENUMBRA = 0.15, 0.3, 0.05


def transport(values):
    """Irradiance past a slat about x = values[0], values[1] of the way to the lights."""
    middle, distance = values
    lit = np.ones((PIXELS, PATCHES))
    for edge, sign in ((middle - WIDTH / 2, -1), (middle + WIDTH / 2, 1)):
        shadow = LIGHTS + (edge - LIGHTS) / (1 - distance)
        lit += sign / (1 + np.exp(-(WALL[:, None] - shadow) / PENUMBRA))
    return lit / (1 + (WALL[:, None] - LIGHTS) ** 2)


class SlatLevel:
    """What descents ask of a level.

    All rows of the wall are lit alike. Noise is the same over rectangles of `grain` pixels: in what
    a scene leaves unexplained, neighbours err together.
    """

    names = ("middle", "distance")
    path = "slat.xml"
    by_area, overdispersion = False, 1.0

    def __init__(self, noise, seed, rendering=0.0, rows=1, grain=(1, 1)):
        random = np.random.default_rng(seed)
        image = np.exp(0.3 * np.cumsum(random.standard_normal((PATCHES, 3)), axis=0))  # smooth
        self.signal = np.tile(transport(TRUTH) @ image, (rows, 1))
        clean = transport(TRUTH) @ image + LIGHT @ random.standard_normal((2, 3))
        self.seed, self.rendering, self.rows = seed, rendering, rows
        self.photograph_shape = (rows, PIXELS)
        self.used = np.ones(self.photograph_shape, bool)
        self.scale = np.ones(3)
        self.prior = Prior.none(2)
        grains = random.standard_normal((rows // grain[0], PIXELS // grain[1], 3))
        errors = np.repeat(np.repeat(grains, grain[0], axis=0), grain[1], axis=1)
        self.y = np.tile(clean, (rows, 1)) + noise * errors.reshape(-1, 3)

    def differing(self):
        return self

    def reseeded(self, seed):
        other = copy(self)
        other.seed = seed
        return other

    def gained(self, found):
        del found
        return self

    def as_it_comes(self):
        return self.overdispersed(1.0)

    def compared(self, found, left_of):
        del found, left_of
        return self

    def whitened(self, found):
        del found
        return self

    def judged(self, values, seed=None):
        return self.explain(values, seed)

    def levered(self, found, A):
        del found, A
        return self

    def overdispersed(self, overdispersion):
        other = copy(self)
        other.overdispersion = overdispersion
        return other

    def unphysical(self, values):
        try:
            self.matrix(values)
        except SceneError as error:
            return error
        return None

    def matrix(self, values, seed=None):
        if values[1] < NEAREST or values[1] > 0.9:
            raise SceneError(f"the slat is in the wall at distance = {values[1]:.3g}")
        seed = self.seed if seed is None else seed
        key = [seed, *(int(1e6 * (value + 10)) for value in values)]
        random = np.random.default_rng(key)
        A = np.tile(transport(values), (self.rows, 1))
        return A + self.rendering * random.standard_normal(A.shape)

    def explain(self, values, seed=None):
        return self.explained_by(self.matrix(values, seed), values)

    def explained_by(self, A, values, fit=None):
        del values
        light = np.tile(LIGHT, (self.rows, 1)) / np.sqrt(self.rows)
        fit = fit or fit_image(A, light, self.y, HIDDEN)
        return Explanation.of(fit, self.overdispersion)


@pytest.fixture
def slat_level():
    return SlatLevel


@pytest.fixture
def jit():
    """Skip where only the scalar variant works: calibration refuses to crawl."""
    use_variant()
    if not is_vectorized():
        pytest.skip("needs LLVM or CUDA")


@pytest.fixture
def chair_before_a_small_image(jit):  # noqa: ARG001
    """A level of the chair, moved across and up or its monitor turned, all 0; and the scenario.

    The hidden image is black at its border, which would tell by how much it is shifted. Noise of
    the photograph is more than that of the level's few rays.
    """
    prior = Prior(np.zeros(3), np.array([0.01, 0.01, 2.0]))
    hidden, given = (18, 22), {"resolution": "32"}
    scenario = load_scenario(find_scene("chair"), hidden, given)
    image, random = np.zeros((*hidden, 3)), np.random.default_rng(0)
    image[4:12, 6:16] = random.random((8, 10, 3))
    A = render_transport(scenario, samples=16, pixel_samples=16, seed=9)
    y = (A @ image.reshape(-1, 3)).reshape(32, 32, 3)
    y = y + 0.005 * y.mean() * random.standard_normal(y.shape)
    level = ResolutionLevel(
        find_scene("chair"), given, ("occluder_dx", "occluder_dz", "monitor_turn"), prior, y, [],
        None, hidden, Resolution(32, 22, 2, Rays(4, 9), Rays(4, 9)), 0, lambda _: None,
    )  # fmt: skip
    return level, scenario


class Slat(SlatLevel, ResolutionLevel):
    """The slat as a calibration asks for it, with a ruler."""

    explain = ResolutionLevel.explain
    explained_by = ResolutionLevel.explained_by
    judged = ResolutionLevel.judged
    levered = ResolutionLevel.levered
    compared = ResolutionLevel.compared
    gained = ResolutionLevel.gained
    as_it_comes = ResolutionLevel.as_it_comes
    whitened = ResolutionLevel.whitened
    hidden_shape, _off = HIDDEN, ()
    _whitening = _white_noise = _leverage = None

    def __init__(self, start, errors, seed=0):
        super().__init__(noise=0.002, seed=seed, rows=4)
        self.prior, self._y = Prior(np.asarray(start), np.array(errors)), self.y
        self._gain = SmoothGain.none(self.used)

    def background(self, values):
        del values
        return np.tile(LIGHT, (self.rows, 1)) / np.sqrt(self.rows)


def calibrated(start, errors, shift=None, seed=0):
    level = Slat(start, errors, seed)
    return calibrate_levels([level] * 2, np.asarray(start), NOTHING, shift=shift)


@pytest.fixture
def doubted(monkeypatch):
    """Doubt all values but those near the truth."""

    def doubts(_, values, *__):
        return () if np.abs(values - TRUTH).max() < 0.01 else ("it is elsewhere",)

    monkeypatch.setattr(search, "doubts", doubts)


@pytest.fixture
def held(monkeypatch):
    """Have the fine level's search stay where it begins."""
    found = search.search_patches

    def search_patches(level, start, *others):
        best = found(level, start, *others)
        return replace(best, values=start, seen=best.level.judged(start))

    monkeypatch.setattr(search, "search_patches", search_patches)


@pytest.fixture
def failing(monkeypatch):
    """Have the search fail from where is said, by the error that is said; give what was begun."""
    found, begun = search.search_patches, []

    def fail_from(errors):
        def search_patches(level, start, *others):
            begun.append(start)
            for at, error in errors:
                if np.array_equal(start, at):
                    raise error
            return found(level, start, *others)

        monkeypatch.setattr(search, "search_patches", search_patches)
        return begun

    return fail_from
