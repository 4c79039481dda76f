"""What a scene is worth: the bound as it is defined, and what must not change it."""

from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.design.comparison import Comparison, Equal
from periscopy_sim.evaluation.design.merit import Assessment, assessment_of

HIDDEN, SIDE = (3, 4), 12
LEVEL, TIME = (Comparison(equal=equal) for equal in (Equal.level, Equal.time))


@pytest.fixture(scope="module")
def scenario():
    return ps.load_scenario("chair", HIDDEN, {"resolution": SIDE})


@pytest.fixture(scope="module")
def A():  # noqa: N802
    rng = np.random.default_rng(0)
    return rng.uniform(0.2, 1, (SIDE * SIDE, 12))


@pytest.fixture(scope="module")
def B():  # noqa: N802
    rng = np.random.default_rng(1)
    return rng.uniform(0.2, 1, (SIDE * SIDE, 5))


def test_bound_is_that_of_least_squares_beside_the_ambient_light(scenario, A, B):
    """By the definition: the noise of the photograph, through the pseudoinverse of [A, B]."""
    _, merit = assessment_of(scenario, A, B, LEVEL)
    light = (B / np.linalg.norm(B, axis=0)).sum(axis=1)
    white = A.sum(axis=1)
    photograph = white + light / light.mean() * white.mean() / 0.5
    σ = 1e-3 * np.sqrt(np.mean(photograph**2))
    P = np.linalg.pinv(np.hstack([A, B]))[:12]
    assert merit.bound == pytest.approx(σ * np.sqrt(np.mean(np.sum(P**2, axis=1))), rel=1e-6)
    alone = np.linalg.pinv(A)
    expected = σ * np.sqrt(np.mean(np.sum(alone**2, axis=1)))
    assert merit.bound_without_ambient == pytest.approx(expected, rel=1e-6)
    assert (merit.light, merit.exposure_time) == (1, 1)
    assert merit.told_error is None


def test_nothing_is_won_by_units_at_an_equal_level(scenario, A, B):
    """Twice the light everywhere: the same photograph, exposed for half as long."""
    assessment, first = assessment_of(scenario, A, B, LEVEL)
    brighter = assessment.merit(scenario, 2 * A, B)
    assert brighter.bound == pytest.approx(first.bound, rel=1e-9)
    assert brighter.light == pytest.approx(2)


def test_light_counts_in_equal_time(scenario, A, B):
    """Without ambient light twice the light is twice the electrons, and half the time."""
    dark = replace(TIME, sbr=np.inf)
    assessment, first = assessment_of(scenario, A, B, dark)
    brighter = assessment.merit(scenario, 2 * A, B)
    assert brighter.bound == pytest.approx(first.bound / np.sqrt(2), rel=1e-9)
    assert brighter.exposure_time == pytest.approx(1 / 2, rel=1e-9)
    # Much ambient light stays as it is: then the time falls with the square of the signal.
    bright = replace(TIME, sbr=1e-6)
    assessment, first = assessment_of(scenario, A, B, bright)
    brighter = assessment.merit(scenario, 2 * A, B)
    assert brighter.exposure_time == pytest.approx(1 / 4, rel=1e-4)


@pytest.mark.parametrize("comparison", [LEVEL, TIME])
def test_nothing_is_won_by_cutting_pixels_in_two(scenario, A, B, comparison):
    """Each half has half of the electrons: the same information."""
    assessment, first = assessment_of(scenario, A, B, comparison)
    finer = ps.load_scenario("chair", HIDDEN, {}, photograph=(2 * SIDE, SIDE))
    cut = assessment.merit(finer, np.repeat(A, 2, axis=0), np.repeat(B, 2, axis=0))
    assert cut.bound == pytest.approx(first.bound, rel=1e-9)
    assert cut.exposure_time == pytest.approx(1, rel=1e-9)


def test_exposure_time_brings_the_bound_of_the_scene_as_it_stands(scenario, A, B):
    """So many times the electrons, 10 log₁₀ dB more, and the two bounds are equal."""
    assessment, first = assessment_of(scenario, A, B, TIME)
    other = np.random.default_rng(5).uniform(0.4, 1, A.shape)
    merit = assessment.merit(scenario, other, B)
    longer = replace(TIME, snr=TIME.snr + 10 * np.log10(merit.exposure_time))
    repeated = Assessment(longer, {}, 0, assessment.reference).merit(scenario, other, B)
    assert merit.exposure_time > 1.1
    assert repeated.bound == pytest.approx(first.bound, rel=1e-9)


def test_patches_that_are_not_told_have_an_infinite_bound(scenario, A, B):
    assessment, _ = assessment_of(scenario, A, B, LEVEL)
    blind = A.copy()
    blind[:, 3] = 0
    merit = assessment.merit(scenario, blind, B)
    assert merit.bound == merit.exposure_time == np.inf
    alike, merit = assessment_of(scenario, blind, B, LEVEL)
    assert merit.exposure_time is None
    assert alike.merit(scenario, A, B).exposure_time is None


def test_errors_are_of_the_noise_aware_method_and_the_same_again(scenario):
    A, B = ps.render_transport(scenario, samples=4), ps.point_light_backgrounds(scenario)
    images = {"half": np.full((*HIDDEN, 3), 0.5), "one": np.eye(3, 4)[..., None] * np.ones(3)}
    quiet, loud = (Comparison(snr=snr) for snr in (80.0, 40.0))
    merits = [assessment_of(scenario, A, B, each, images)[1] for each in (quiet, quiet, loud)]
    assert merits[0] == merits[1]
    assert 0 < merits[0].error < merits[2].error
    assert 0 < merits[0].told_error < merits[2].told_error


@pytest.mark.parametrize(
    ("given", "words"),
    [({"snr": np.nan}, "finite"), ({"sbr": 0.0}, "positive"), ({"sbr": np.nan}, "positive")],
)
def test_conditions_that_are_none_are_refused(given, words):
    with pytest.raises(PeriscopyError, match=words):
        Comparison(**given)
