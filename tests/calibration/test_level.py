import numpy as np
import pytest

from periscopy_sim.calibration.level import SPREAD, Averaged, ResolutionLevel, fitted
from periscopy_sim.calibration.whitening import Whitening
from periscopy_sim.errors import PhotographError, SceneError
from tests.calibration.conftest import PIXELS, ROWS, TRUTH, WALL, SlatMatrices, slat_level


def test_the_slope_is_the_derivative_of_half_the_evidence():
    """By the parameters and by the coefficients of the gain, the penalties included."""
    level = slat_level(start=np.add(TRUTH, [0.01, 0.01]), seed=2)
    random = np.random.default_rng(1)
    point = level.start(TRUTH + 0.003)
    point[2:] = 0.02 * random.standard_normal(len(point) - 2)
    A, changes = level.matrices.linearized(level.values(point))
    about = level.curvature(point, level.explain(point), A, changes)
    for k in range(len(point)):
        h = 1e-5 * np.eye(len(point))[k]
        numeric = (level.explain(point + h).evidence - level.explain(point - h).evidence) / 4e-5
        assert about.slope[k] == pytest.approx(numeric, rel=1e-2, abs=1.0)


def test_the_information_is_the_curvature_of_a_noise_free_evidence():
    """Gauss and Newton's approximation holds where residuals vanish."""
    level = slat_level(errors=(np.inf, np.inf), noise=1e-4)
    point = level.start(TRUTH)
    _, _, about = level.look(point)
    A, changes = level.matrices.linearized(TRUTH)
    about = level.curvature(point, level.explain(point), A, changes)
    h = 2e-5 * np.eye(len(point))[0]
    sides = [level.explain(point + sign * h).evidence for sign in (-1, 0, 1)]
    numeric = (sides[0] - 2 * sides[1] + sides[2]) / (2 * 4e-10)
    assert about.information[0, 0] == pytest.approx(numeric, rel=0.1)


def test_a_gain_is_found_beside_the_parameters():
    gain = 1 + 0.05 * WALL
    level = slat_level(errors=(0.02, 0.015), gain=gain)
    point = level.start(TRUTH)
    for _ in range(3):
        level, _, about = level.look(point)
        point = point + about.step(0.0, np.full(len(point), 1.0), np.ones(len(point), bool))
    found = level.gain(point).reshape(ROWS, PIXELS)[0]
    found = found - found.mean()
    np.testing.assert_allclose(found, gain - gain.mean(), atol=0.01)


def test_the_penalty_counts_parameters_and_gain():
    level = slat_level(start=TRUTH, errors=(0.01, 0.1))
    point = level.start(np.add(TRUTH, [0.01, 0.1]))
    assert level.penalty(point) == pytest.approx(2)
    point[-1] = SPREAD
    assert level.penalty(point) == pytest.approx(3)


def test_points_without_a_scene_or_with_too_much_gain_are_not_physical():
    level = slat_level()
    point = level.start(TRUTH)
    assert level.is_physical(point)
    assert not level.is_physical(level.start(np.array([0.05, 0.95])))
    point[2] = 0.9
    assert not level.is_physical(point)
    with pytest.raises(SceneError):
        level.explain(point)
    assert level.judgement(point) == np.inf


def test_a_misplaced_scene_is_no_discrepancy_but_structured_noise_is():
    aside = slat_level().look(slat_level().start(np.add(TRUTH, [0.004, 0.0])))[0]
    alike = slat_level(alike=12, noise=0.01).look(slat_level().start(TRUTH))[0]
    assert aside.discrepancy < 4 < alike.discrepancy


def test_errors_are_judged_by_a_points_own_spectrum():
    level = slat_level(alike=12, noise=0.01)
    level = level.comparing(level.start(TRUTH))
    point = level.start(TRUTH)
    own = level.noise.whitening(level.explain(point))
    filtered = ResolutionLevel(
        level.averaged, level.matrices, level.prior, level.background, whitening=own
    )
    assert level.judge(point).evidence == pytest.approx(filtered.explain(point).evidence)
    assert isinstance(own, Whitening)


def test_too_few_pixels_are_refused():
    light = np.ones((4, 3))
    averaged = Averaged(
        np.array([[True] * 4 + [False] * (PIXELS - 4)] + [[False] * PIXELS] * 3), light
    )
    with pytest.raises(PhotographError, match="too few"):
        ResolutionLevel.of(averaged, SlatMatrices(), slat_level().prior, TRUTH)


def test_pixels_are_averaged_over_what_the_mask_leaves():
    photograph = np.arange(4 * 6 * 3, dtype=float).reshape(4, 6, 3)
    mask = np.ones((4, 6), bool)
    mask[0, 0] = mask[2:, 2:4] = False
    averaged = Averaged.of(photograph, [2 * photograph], mask, 3)
    np.testing.assert_array_equal(averaged.used, [[True, True, True], [True, False, True]])
    expected = np.mean([photograph[0, 1], photograph[1, 0], photograph[1, 1]], axis=0)
    np.testing.assert_allclose(averaged.light[0], expected)
    np.testing.assert_allclose(averaged.off[0], 2 * averaged.light)
    laid = averaged.picture(averaged.light, outside=-1.0)
    assert (laid[1, 1] == -1).all() and laid.shape == (2, 3, 3)


def test_few_pixels_keep_few_patches():
    averaged = Averaged(np.ones((4, 40), bool), np.ones((160, 3)))
    rows, columns = averaged.hidden_shape((30, 36), 30)
    assert rows * columns <= 0.7 * 160
    assert fitted((30, 36), 12) == (10, 12)
    assert fitted((3, 4), 12) == (3, 4)
