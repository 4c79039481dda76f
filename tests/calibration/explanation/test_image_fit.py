import numpy as np
import pytest
from periscopy_sim.calibration.explanation.image_fit import fit_image, nonnegative_fit
from scipy import optimize

SHAPE = (3, 4)


@pytest.fixture
def problem():
    """A matrix, a basis of ambient light, a photograph that two patches darken, and a change."""
    random = np.random.default_rng(3)
    A = random.random((60, 12))
    Q = np.linalg.qr(random.random((60, 4)))[0]
    y = A @ (1 + random.random((12, 3))) + Q @ random.random((4, 3))
    y += 0.05 * random.standard_normal(y.shape) - 1.5 * A[:, [2]] - 1.2 * A[:, [7]]
    return A, Q, y, random.standard_normal((60, 3))


def test_nonnegative_images_explain_less_and_none_shines_negatively(problem):
    A, Q, y, _ = problem
    free, found = (fit_image(A, Q, y, SHAPE, nonnegative=each) for each in (False, True))
    assert free.images.min() < 0 and found.images.min() == 0
    lost = 2 * found.freedom * np.log(found.noise / free.noise)
    assert (lost > -1e-6).all() and lost.max() > 1
    assert found.evidence == pytest.approx(free.evidence + lost.sum(), rel=1e-9)


def test_patches_that_are_dark_follow_nothing(problem):
    A, Q, y, moved = problem
    found = fit_image(A, Q, y, SHAPE, nonnegative=True)
    assert (found.images == 0).any()
    moved = found.without_background(moved)
    told = found.beyond_image(moved)
    seen = A - Q @ (Q.T @ A)
    for c in range(3):
        lit = found.images[:, c] > 0
        response = np.linalg.lstsq(seen[:, lit], moved[:, c] - told[:, c], rcond=None)[0]
        np.testing.assert_allclose(
            found._hessians[c][lit][:, lit] @ response, seen[:, lit].T @ moved[:, c], atol=1e-8
        )


def test_a_matrix_that_lets_no_light_through_explains_what_darkness_does(problem):
    A, Q, y, _ = problem
    found = fit_image(0 * A, Q, y, SHAPE)
    assert found.evidence == pytest.approx(found.darkness)
    assert not found.images.any()


@pytest.mark.parametrize("seed", range(20))
def test_nonnegative_quadratic_programs_meet_their_optimality_conditions(seed):
    random = np.random.default_rng(seed)
    root = random.standard_normal((40, 25)) * np.geomspace(1, 1e-3, 25)
    H, h = root.T @ root + 1e-8 * np.eye(25), random.standard_normal(25)
    f = nonnegative_fit(H, h, random.standard_normal(25))
    slope = H @ f - h
    assert (f >= 0).all()
    np.testing.assert_allclose(slope[f > 0], 0, atol=1e-6)
    assert (slope[f == 0] >= -1e-9).all()


@pytest.mark.parametrize("seed", [577, 759, 1946])
def test_exchanges_that_would_go_round_in_circles_end(seed):
    # With these, to exchange all patches on the wrong side at once never ends.
    random = np.random.default_rng(seed)
    root = random.standard_normal((5, 5))
    H, h = root.T @ root + 1e-3 * np.eye(5), random.standard_normal(5)
    f = nonnegative_fit(H, h, random.standard_normal(5))
    expected = optimize.nnls(np.linalg.cholesky(H).T, np.linalg.solve(np.linalg.cholesky(H), h))[0]
    np.testing.assert_allclose(f, expected, atol=1e-9)
