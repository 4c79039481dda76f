import numpy as np
import pytest

from periscopy_sim.calibration.information import Curvature
from tests.calibration.conftest import TRUTH, slat_level


def curvature(information, precision, slope=None, beyond=None):
    count = len(precision)
    slope = np.zeros(count) if slope is None else slope
    beyond = np.zeros((count, 0, 3)) if beyond is None else beyond
    return Curvature(slope, np.asarray(information), beyond, np.asarray(precision), np.zeros(count))


def test_a_step_leads_to_where_the_slope_vanishes():
    H = np.array([[4.0, 1.0], [1.0, 3.0]])
    about = curvature(H, [0.0, 0.0], slope=H @ [0.3, -0.2])
    everything = np.ones(2, bool)
    np.testing.assert_allclose(about.step(0.0, np.ones(2), everything), [-0.3, 0.2], rtol=1e-3)
    np.testing.assert_allclose(
        about.step(0.0, np.array([0.15, 1]), everything), [-0.15, 0.1], rtol=1e-3
    )
    held = about.step(0.0, np.ones(2), np.array([True, False]))
    assert not held[1] and held[0] == pytest.approx(-0.25, rel=1e-3)
    assert about.predicted_gain == pytest.approx(np.array([0.3, -0.2]) @ H @ [0.3, -0.2], rel=1e-3)


def test_what_neither_photograph_nor_ruler_knows_stays_finite():
    about = curvature(np.diag([1.0, 0.0]), [0.0, 0.0], slope=np.array([1.0, 0.0]))
    assert np.isfinite(np.linalg.inv(about.damped())).all()


def test_errors_of_white_noise_are_those_of_the_linear_theory():
    """Blocks of pixels tell the same as counting noise, over many photographs."""
    growths = []
    for seed in range(6):
        level = slat_level(errors=(np.inf, np.inf), seed=seed)
        level, found, about = level.look(level.start(TRUTH))
        scores = about.block_scores(found.residual / found.deviations, level.averaged.used)
        linear = np.sqrt(np.diag(np.linalg.inv(about.damped())))
        growths.append(np.sqrt(np.diag(about.covariance(scores))) / linear)
    assert 1 <= np.mean(growths) < 1.4


def test_errors_alike_over_pixels_are_more_uncertain():
    level = slat_level(alike=8, noise=0.01)
    point = level.start(TRUTH)
    A, changes = level.matrices.linearized(TRUTH)
    found = level.explain(point)
    about = level.curvature(point, found, A, changes)
    scores = about.block_scores(found.residual / found.deviations, level.averaged.used)
    assert about.overdispersion(scores) > 2


def test_values_found_spread_as_their_errors_say():
    values, errors = [], []
    for seed in range(12):
        level = slat_level(errors=(np.inf, np.inf), seed=seed)
        point = level.start(TRUTH)
        for _ in range(3):
            level, found, about = level.look(point)
            free = np.ones(len(point), bool)
            point = point + about.step(0.0, np.full(len(point), 0.1), free)
        scores = about.block_scores(found.residual / found.deviations, level.averaged.used)
        values.append(level.values(point) - TRUTH)
        errors.append(np.sqrt(np.diag(about.covariance(scores)))[:2])
    z = np.array(values) / np.array(errors)
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.5


def test_what_parameters_absorb_leaves_no_pull():
    level = slat_level(errors=(np.inf, np.inf))
    _, found, about = level.look(level.start(TRUTH + 0.002))
    errors = found.residual / found.deviations
    before = np.einsum("pmc,mc->p", about.beyond, errors)
    after = np.einsum("pmc,mc->p", about.beyond, about.absorb(errors))
    assert np.abs(after[:2]).max() < 0.2 * np.abs(before[:2]).max()


def test_a_tempered_photograph_counts_for_less_the_prior_as_it_is():
    level = slat_level()
    _, _, about = level.look(level.start(TRUTH + 0.002))
    half = about.tempered(2.0)
    np.testing.assert_allclose(half.information, about.information / 2)
    np.testing.assert_allclose(half.slope - half.ruled, (about.slope - about.ruled) / 2)
    np.testing.assert_array_equal(half.precision, about.precision)
