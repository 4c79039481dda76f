"""The merit of a scene: the bound by its definition, and what must not change it."""

from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.merit import Comparison, merit_of

HIDDEN, SIDE = (3, 4), 12
LEVEL, TIME = Comparison(), Comparison(equal_time=True)
RNG = np.random.default_rng(0)
A = RNG.uniform(0.2, 1, (SIDE * SIDE, 12))
B = RNG.uniform(0.2, 1, (SIDE * SIDE, 5))


@pytest.fixture(scope="module")
def scenario():
    return ps.load_scenario("chair", HIDDEN, {"resolution": SIDE})


def test_bound_is_that_of_least_squares_beside_the_ambient_light(scenario):
    """By the definition: the noise of the photograph, through the pseudoinverse of [A, B]."""
    merit, _ = merit_of(scenario, A, B, LEVEL)
    light = (B / np.linalg.norm(B, axis=0)).sum(axis=1)
    white = A.sum(axis=1)
    photograph = white + light / light.mean() * white.mean() / 0.5
    σ = 1e-3 * np.sqrt(np.mean(photograph**2))
    P = np.linalg.pinv(np.hstack([A, B]))[:12]
    assert merit.bound == pytest.approx(σ * np.sqrt(np.mean(np.sum(P**2, axis=1))), rel=1e-6)
    alone = np.linalg.pinv(A)
    expected = σ * np.sqrt(np.mean(np.sum(alone**2, axis=1)))
    assert merit.bound_without_ambient == pytest.approx(expected, rel=1e-6)
    assert (merit.light, merit.exposure_time) == pytest.approx((1, 1))
    assert merit.told_error is None


def test_nothing_is_won_by_units_at_an_equal_level(scenario):
    """Twice the light everywhere: the same photograph, exposed for half as long."""
    first, reference = merit_of(scenario, A, B, LEVEL)
    brighter, _ = merit_of(scenario, 2 * A, B, LEVEL, reference=reference)
    assert brighter.bound == pytest.approx(first.bound, rel=1e-9)
    assert brighter.light == pytest.approx(2)


def test_light_counts_in_equal_time(scenario):
    """Without ambient light twice the light is twice the electrons, and half the time."""
    dark = replace(TIME, sbr=np.inf)
    first, reference = merit_of(scenario, A, B, dark)
    brighter, _ = merit_of(scenario, 2 * A, B, dark, reference=reference)
    assert brighter.bound == pytest.approx(first.bound / np.sqrt(2), rel=1e-9)
    assert brighter.exposure_time == pytest.approx(1 / 2, rel=1e-9)
    # Much ambient light stays as it is: then the time falls with the square of the signal.
    bright = replace(TIME, sbr=1e-6)
    _, reference = merit_of(scenario, A, B, bright)
    brighter, _ = merit_of(scenario, 2 * A, B, bright, reference=reference)
    assert brighter.exposure_time == pytest.approx(1 / 4, rel=1e-4)


@pytest.mark.parametrize("comparison", [LEVEL, TIME])
def test_nothing_is_won_by_cutting_pixels_in_two(scenario, comparison):
    """Each half has half of the electrons: the same information."""
    first, reference = merit_of(scenario, A, B, comparison)
    finer = ps.load_scenario("chair", HIDDEN, {}, photograph=(2 * SIDE, SIDE))
    halves = np.repeat(A, 2, axis=0), np.repeat(B, 2, axis=0)
    cut, _ = merit_of(finer, *halves, comparison, reference=reference)
    assert cut.bound == pytest.approx(first.bound, rel=1e-9)
    assert cut.exposure_time == pytest.approx(1, rel=1e-9)


def test_exposure_time_brings_the_bound_of_the_scene_as_it_stands(scenario):
    """So many times the electrons, 10 log₁₀ dB more, and the two bounds are equal."""
    first, reference = merit_of(scenario, A, B, TIME)
    other = np.random.default_rng(5).uniform(0.4, 1, A.shape)
    merit, _ = merit_of(scenario, other, B, TIME, reference=reference)
    longer = replace(TIME, snr=TIME.snr + 10 * np.log10(merit.exposure_time))
    repeated, _ = merit_of(scenario, other, B, longer, reference=reference)
    assert merit.exposure_time > 1.1
    assert repeated.bound == pytest.approx(first.bound, rel=1e-9)


def test_undetermined_patches_have_an_infinite_bound(scenario):
    _, reference = merit_of(scenario, A, B, LEVEL)
    blind = A * (np.arange(12) != 3)
    merit, _ = merit_of(scenario, blind, B, LEVEL, reference=reference)
    assert merit.bound == merit.exposure_time == np.inf
    assert merit_of(scenario, blind, B, LEVEL)[0].exposure_time is None
    of_blind = merit_of(scenario, blind, B, LEVEL)[1]
    assert merit_of(scenario, A, B, LEVEL, reference=of_blind)[0].exposure_time is None


def test_errors_are_of_the_noise_aware_method_and_the_same_again(scenario):
    A, B = ps.render_transport(scenario, samples=4), ps.point_light_backgrounds(scenario)
    images = {"half": np.full((*HIDDEN, 3), 0.5), "one": np.eye(3, 4)[..., None] * np.ones(3)}
    quiet, loud = (Comparison(snr=snr) for snr in (80.0, 40.0))
    merits = [merit_of(scenario, A, B, each, images)[0] for each in (quiet, quiet, loud)]
    assert merits[0] == merits[1]
    assert 0 < merits[0].error < merits[2].error
    assert 0 < merits[0].told_error < merits[2].told_error


@pytest.mark.parametrize("given", [{"snr": np.nan}, {"sbr": 0.0}, {"sbr": np.nan}])
def test_impossible_conditions_are_rejected(given):
    with pytest.raises(PeriscopyError):
        Comparison(**given)
