import numpy as np
import pytest
from scipy import optimize

from periscopy_sim.calibration.evidence import BRIGHTNESS, explain, image_precision

SHAPE = (3, 4)
PIXELS, LIGHTS = 60, 4


@pytest.fixture
def problem():
    random = np.random.default_rng(3)
    A = random.random((PIXELS, 12))
    Q = np.linalg.qr(random.random((PIXELS, LIGHTS)))[0]
    y = A @ (1 + random.random((12, 3))) + Q @ random.random((LIGHTS, 3))
    return A, Q, y + 0.05 * random.standard_normal(y.shape), random.standard_normal(A.shape)


def dense(A, Q, y):
    """Evidence, noise and covariances from (M - r, M - r) matrices, the ratio by a plain search."""
    complement = np.linalg.svd(np.eye(PIXELS) - Q @ Q.T)[0][:, : PIXELS - LIGHTS]
    seen = complement.T @ A
    prior = seen @ np.linalg.inv(image_precision(SHAPE)) @ seen.T
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


def slope(found, change):
    motion = found.motion(change @ found.images)
    return found.slope(motion, float(np.vdot(found.volume, change)))


def filtered(errors):
    return 2 * errors + errors[::-1]


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
    found = explain(A, Q, y, SHAPE)
    assert 2 * slope(found, change) == pytest.approx(numeric, rel=1e-4)
    assert np.vdot(found.gradient, change) == pytest.approx(numeric, rel=1e-4)


def test_slope_is_the_derivative_of_a_filtered_evidence(problem):
    A, Q, y, change = problem
    h, κ = 1e-5, 2.0
    ahead, behind = (explain(A + s * h * change, Q, y, SHAPE, filtered, κ) for s in (1, -1))
    numeric = (ahead.evidence - behind.evidence) / (4 * h)
    found = explain(A, Q, y, SHAPE, filtered, κ)
    assert slope(found, change) == pytest.approx(numeric, rel=1e-3)


def test_information_weighs_motions_by_the_dense_inverse_covariance(problem):
    A, Q, y, change = problem
    found = explain(A, Q, y, SHAPE)
    changes = change, np.roll(change, 1, axis=0)
    _, noise, inverses = dense(A, Q, y)
    moves = [each @ found.images for each in changes]
    expected = sum(
        moves[0][:, c] @ inverse @ moves[1][:, c] / noise[c] ** 2
        for c, inverse in enumerate(inverses)
    )
    motions = np.array([found.motion(move) for move in moves])
    assert np.vdot(found.beyond_image(motions)[0], motions[1]) == pytest.approx(expected, rel=1e-3)


def test_ambient_light_of_any_strength_changes_nothing(problem):
    A, Q, y, change = problem
    light = 1e3 * Q @ np.random.default_rng(1).standard_normal((LIGHTS, 3))
    dark, lit = explain(A, Q, y, SHAPE), explain(A, Q, y + light, SHAPE)
    assert lit.evidence == pytest.approx(dark.evidence, abs=1e-4)
    np.testing.assert_allclose(lit.images, dark.images, atol=1e-6)
    assert slope(lit, change) == pytest.approx(slope(dark, change), rel=1e-5)


def test_units_shift_the_evidence_alone(problem):
    A, Q, y, change = problem
    one, other = explain(A, Q, y, SHAPE), explain(A, Q, 1e4 * y, SHAPE)
    shift = 3 * (PIXELS - LIGHTS) * 2 * np.log(1e4)
    assert other.evidence - one.evidence == pytest.approx(shift, rel=1e-9)
    np.testing.assert_allclose(other.images, 1e4 * one.images, rtol=1e-5)
    assert slope(other, change) == pytest.approx(slope(one, change), rel=1e-5)


def test_a_black_channel_is_explained_by_darkness(problem):
    A, Q, y, change = problem
    y[:, 1] = 0
    found = explain(A, Q, y, SHAPE)
    assert np.isfinite(found.evidence)
    assert np.isfinite(slope(found, change))
    assert not found.images[:, 1].any()


def test_negative_light_is_a_fraction_of_all(problem):
    A, Q, y, _ = problem
    assert explain(A, Q, A @ np.ones((12, 3)), SHAPE).darker_than_black == pytest.approx(0)
    assert explain(A, Q, -A @ np.ones((12, 3)), SHAPE).darker_than_black == pytest.approx(1)
    assert explain(A, Q, np.zeros_like(y), SHAPE).darker_than_black == pytest.approx(0)


def test_without_noise_the_noise_is_that_of_single_precision(problem):
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
    assert found.unexplained == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 1), (3, 4)])
def test_an_image_is_as_rough_as_its_differences_in_the_dark(shape):
    image = np.random.default_rng(0).random(shape)
    dark = np.pad(image, 1)
    differences = sum(np.sum(np.diff(dark, axis=axis) ** 2) for axis in (0, 1))
    roughness = image.ravel() @ image_precision(shape) @ image.ravel()
    assert roughness == pytest.approx(differences + BRIGHTNESS * np.sum(image**2))


def shadows(shape, across):
    """A matrix whose patches all cast the same blurred light, moved across by some patches."""
    rows, columns = (np.arange(-6, size + 6) for size in shape)
    down, right = (np.arange(size) for size in shape)
    of_rows = np.exp(-((rows[:, None] - down) ** 2) / 4)
    of_columns = np.exp(-((columns[:, None] - right - across) ** 2) / 4)
    return np.kron(of_rows, of_columns)


def test_an_image_that_touches_the_border_explains_no_more_than_the_right_one():
    """The same photograph by light that is moved, of an image that is moved back."""
    shape, random = (8, 12), np.random.default_rng(2)
    image = np.zeros((*shape, 3))
    image[3:6, 2:9] = random.uniform(0.6, 1, (3, 7, 3))
    y = shadows(shape, 0) @ image.reshape(-1, 3)
    y += 1e-2 * y.mean() * random.standard_normal(y.shape)
    none = np.zeros((len(y), 0))
    right, wrong, farther = (explain(shadows(shape, k), none, y, shape).evidence for k in (0, 2, 4))
    assert abs(wrong - right) < 10
    assert farther > right + 100  # the image would have to leave the monitor
