import numpy as np
import pytest
from periscopy_sim.calibration.explanation.evidence import Explanation, explain
from periscopy_sim.calibration.explanation.image_prior import BRIGHTNESS
from periscopy_sim.calibration.explanation.smooth_gain import SmoothGain
from scipy import linalg, optimize

SHAPE = (3, 4)
PIXELS, LIGHTS = 60, 4


def test_what_is_left_is_of_the_photograph_whatever_the_gain(problem):
    A, Q, y, _ = problem
    y = y * np.linspace(0.8, 1.2, PIXELS)[:, None]
    plain = explain(A, Q, y, SHAPE)
    size = np.linalg.norm(y - Q @ (Q.T @ y))
    for found in (plain, plain.with_gain(SmoothGain.none(np.ones((6, 10), bool)), A)):
        assert found.left == pytest.approx(np.linalg.norm(found.residuals) / size, rel=1e-6)
    assert np.abs(found.gain.field - 1).max() > 0.01


@pytest.fixture
def problem():
    random = np.random.default_rng(3)
    A = random.random((PIXELS, 12))
    Q = np.linalg.qr(random.random((PIXELS, LIGHTS)))[0]
    y = A @ (1 + random.random((12, 3))) + Q @ random.random((LIGHTS, 3))
    return A, Q, y + 0.05 * random.standard_normal(y.shape), random.standard_normal(A.shape)


def precision():
    """K of the prior, patch by patch."""
    K = (BRIGHTNESS + 4) * np.eye(12)  # four neighbours each, those beyond the border dark
    for i in range(12):
        for j in range(12):
            down, across = abs(i // 4 - j // 4), abs(i % 4 - j % 4)
            if down + across == 1:
                K[i, j] -= 1
    return K


def dense(A, Q, y):
    """Evidence, noise and covariances from (M - r, M - r) matrices, the ratio by a plain search."""
    complement = np.linalg.svd(np.eye(PIXELS) - Q @ Q.T)[0][:, : PIXELS - LIGHTS]
    seen = complement.T @ A
    prior = seen @ np.linalg.inv(precision()) @ seen.T
    unit = np.sum(seen**2) / 12
    total, noise, inverses = 0.0, [], []
    for rest in (complement.T @ y).T:

        def parts(log_ratio, rest=rest):
            S = np.eye(len(rest)) + prior / (unit * np.exp(log_ratio))
            misfit = rest @ np.linalg.solve(S, rest)
            return len(rest) * np.log(misfit) + np.linalg.slogdet(S)[1], misfit, S

        best = optimize.minimize_scalar(lambda v: parts(v)[0], bounds=(-15, 3), method="bounded")
        value, misfit, S = parts(best.x)
        total += value
        noise.append(np.sqrt(misfit / len(rest)))
        inverses.append(complement @ np.linalg.inv(S) @ complement.T)
    return total, np.array(noise), inverses


def test_evidence_and_noise_are_those_of_the_dense_gaussian(problem):
    A, Q, y, _ = problem
    found = explain(A, Q, y, SHAPE)
    evidence, noise, _ = dense(A, Q, y)
    assert found.evidence == pytest.approx(evidence, abs=1e-5)
    np.testing.assert_allclose(found.noise, noise, rtol=1e-4)


def test_slope_is_the_derivative_of_the_dense_evidence(problem):
    A, Q, y, change = problem
    h = 1e-5
    numeric = (dense(A + h * change, Q, y)[0] - dense(A - h * change, Q, y)[0]) / (2 * h)
    assert explain(A, Q, y, SHAPE).slope(change) == pytest.approx(numeric, rel=1e-4)


def test_information_weighs_moves_by_the_dense_inverse_covariance(problem):
    A, Q, y, change = problem
    found = explain(A, Q, y, SHAPE)
    other = np.roll(change, 1, axis=0)
    _, noise, inverses = dense(A, Q, y)
    moves = change @ found.images, other @ found.images
    expected = sum(
        moves[0][:, c] @ inverse @ moves[1][:, c] / noise[c] ** 2
        for c, inverse in enumerate(inverses)
    )
    assert np.vdot(found.projected(found.jacobian(change)), found.jacobian(other)) == pytest.approx(
        expected, rel=1e-3
    )


def test_the_gradient_by_entries_and_information_of_light_are_those_of_changes(problem):
    A, Q, y, change = problem
    found = explain(A, Q, y, SHAPE)
    other = np.roll(change, 1, axis=0)
    assert np.vdot(found.gradient, change) == pytest.approx(found.slope(change), rel=1e-9)
    light = np.array([each @ found.images for each in (change, other)])
    moved = found.moved(light)
    np.testing.assert_allclose(moved[1], found.jacobian(other), rtol=1e-9)
    expected = [
        [np.vdot(found.fit.beyond_image(a), b) for b in moved] for a in moved
    ]  # fmt: skip
    np.testing.assert_allclose(found.fit.information(moved), expected, rtol=1e-8)


@pytest.mark.parametrize("whitening", [None, lambda errors: 2 * errors + errors[::-1]])
def test_of_several_moves_each_is_as_it_is_alone(problem, whitening):
    A, Q, y, change = problem
    terms = np.random.default_rng(5).random((2, PIXELS))
    gain = SmoothGain(terms, np.array([0.05, -0.02]))
    found = explain(gain.field[:, None] * A, Q, y, SHAPE, 2.0, whitening).with_gain(gain, A)
    light = np.array([change @ found.images, np.roll(change, 1, axis=0) @ found.images])
    for several in (found.moved, found.projected, found.left_of):
        for one, alone in zip(several(light), light, strict=True):
            np.testing.assert_allclose(one, several(alone), rtol=1e-9, atol=1e-12)


def test_ambient_light_of_any_strength_changes_nothing(problem):
    A, Q, y, change = problem
    light = 1e3 * Q @ np.random.default_rng(1).standard_normal((LIGHTS, 3))
    dark, lit = explain(A, Q, y, SHAPE), explain(A, Q, y + light, SHAPE)
    assert lit.evidence == pytest.approx(dark.evidence, abs=1e-4)
    np.testing.assert_allclose(lit.images, dark.images, atol=1e-6)
    assert lit.slope(change) == pytest.approx(dark.slope(change), rel=1e-5)


def test_units_shift_the_evidence_alone(problem):
    A, Q, y, change = problem
    one, other = explain(A, Q, y, SHAPE), explain(A, Q, 1e4 * y, SHAPE)
    shift = 3 * (PIXELS - LIGHTS) * 2 * np.log(1e4)
    assert other.evidence - one.evidence == pytest.approx(shift, rel=1e-9)
    np.testing.assert_allclose(other.images, 1e4 * one.images, rtol=1e-5)
    assert other.slope(change) == pytest.approx(one.slope(change), rel=1e-5)


def test_a_black_channel_is_explained_by_darkness(problem):
    A, Q, y, change = problem
    y[:, 1] = 0
    found = explain(A, Q, y, SHAPE)
    assert np.isfinite(found.evidence)
    assert np.isfinite(found.slope(change))
    np.testing.assert_array_equal(found.images[:, 1], 0)


def test_patches_that_would_shine_negatively_are_integrated_over_like_all(problem):
    A, Q, y, change = problem
    y = y - 1.5 * A[:, [2]] - 1.2 * A[:, [7]]  # patches 2 and 7 would have to
    found = explain(A, Q, y, SHAPE)
    assert found.images.min() < 0
    evidence, _, inverses = dense(A, Q, y)
    assert found.evidence == pytest.approx(evidence, abs=1e-5)
    h, moved = 1e-5, found.jacobian(change)
    numeric = (dense(A + h * change, Q, y)[0] - dense(A - h * change, Q, y)[0]) / (2 * h)
    assert found.slope(change) == pytest.approx(numeric, rel=1e-4)
    expected = sum(moved[:, c] @ left @ moved[:, c] for c, left in enumerate(inverses))
    assert np.vdot(found.projected(moved), moved) == pytest.approx(expected, rel=1e-3)


def test_negative_light_is_told_as_a_part_of_all(problem):
    A, Q, y, _ = problem
    lit = explain(A, Q, A @ np.ones((12, 3)), SHAPE)
    assert lit.darker_than_black == 0
    found = explain(A, Q, y - 1.5 * A[:, [2]] - 1.2 * A[:, [7]], SHAPE)
    parts = [np.abs(found.images[sign * found.images > 0]).sum() for sign in (-1, 1)]
    assert found.darker_than_black == pytest.approx(parts[0] / sum(parts)) and parts[0] > 0
    assert explain(A, Q, -A @ np.ones((12, 3)), SHAPE).darker_than_black == 1
    assert explain(A, Q, np.zeros_like(y), SHAPE).darker_than_black == 0


def test_without_noise_there_is_that_of_single_precision(problem):
    A, Q, _, _ = problem
    y = A @ np.ones((12, 3))
    found = explain(A, Q, y, SHAPE)
    rounding = 1e-7 * np.sqrt(np.mean(y**2))
    assert np.isfinite(found.evidence)
    assert (found.noise > 0.5 * rounding).all() and (found.noise < 20 * rounding).all()


def test_what_shows_nothing_of_the_scene_is_explained_by_darkness(problem):
    A, Q, y, _ = problem
    shown = explain(A, Q, y, SHAPE)
    assert shown.darkness - shown.evidence > 100
    both = np.linalg.qr(np.hstack([Q, A]))[0]
    nothing = 1e-3 * (y - both @ (both.T @ y))
    found = explain(A, Q, nothing, SHAPE)
    assert found.darkness - found.evidence < 1
    expected = (PIXELS - LIGHTS) * np.log(np.sum(nothing**2, axis=0)).sum()
    assert found.darkness == pytest.approx(expected)


def test_what_image_and_light_absorb_of_errors_is_undone_among_some_pixels(problem):
    A, Q, y, _ = problem
    found = explain(A, Q, y, SHAPE)
    _, _, inverses = dense(A, Q, y)
    pixels = np.array([3, 4, 10, 11, 17])
    errors = found.unabsorbed(pixels)
    for c, left in enumerate(inverses):  # (I + A Σ Aᵀ)⁻¹ beyond range(B) is I − L
        expected = (
            linalg.sqrtm(linalg.inv(left[np.ix_(pixels, pixels)])) @ found.residuals[pixels, c]
        )
        np.testing.assert_allclose(errors[:, c], expected / found.noise[c], rtol=1e-3)


def test_errors_that_are_absorbed_entirely_stay_finite(problem):
    A, Q, y, _ = problem
    errors = explain(A, Q, y, SHAPE).unabsorbed(np.arange(PIXELS))
    assert np.isfinite(errors).all()


def test_errors_of_another_spread_need_no_other_fit(problem):
    A, Q, y, change = problem
    gain = SmoothGain.none(np.ones((6, 10), bool))
    white = explain(A, Q, y, SHAPE).with_gain(gain, A)
    tempered = Explanation.of(white.fit, 5.0).with_gain(gain, A)
    again = explain(A, Q, y, SHAPE, 5.0).with_gain(gain, A)
    assert tempered.evidence == pytest.approx(again.evidence, rel=1e-12)
    assert tempered.slope(change) == pytest.approx(again.slope(change), rel=1e-9)
    assert tempered.gain.coefficients != pytest.approx(white.gain.coefficients, rel=1e-3)


def test_a_leverage_that_is_known_is_not_found_again(problem, monkeypatch):
    A, Q, y, _ = problem
    gain = SmoothGain.none(np.ones((6, 10), bool))
    found = explain(A, Q, y, SHAPE)
    expected, leverage = found.with_gain(gain, A).evidence, found.leverage(A)
    monkeypatch.setattr(Explanation, "leverage", None)
    assert found.with_gain(gain, A, leverage).evidence == expected
    assert found.with_gain(gain, A, 2 * leverage).evidence != pytest.approx(expected, abs=1e-3)
