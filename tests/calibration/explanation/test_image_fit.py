import numpy as np
import pytest
from scipy import optimize

from periscopy_sim.calibration.explanation.image_fit import nonnegative


@pytest.mark.parametrize("seed", range(20))
def test_nonnegative_quadratic_programs_meet_their_optimality_conditions(seed):
    random = np.random.default_rng(seed)
    root = random.standard_normal((40, 25)) * np.geomspace(1, 1e-3, 25)
    H, h = root.T @ root + 1e-8 * np.eye(25), random.standard_normal(25)
    f = nonnegative(H, h, random.standard_normal(25))
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
    f = nonnegative(H, h, random.standard_normal(5))
    expected = optimize.nnls(np.linalg.cholesky(H).T, np.linalg.solve(np.linalg.cholesky(H), h))[0]
    np.testing.assert_allclose(f, expected, atol=1e-9)
