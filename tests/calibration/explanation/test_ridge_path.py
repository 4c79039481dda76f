import numpy as np
import pytest
from periscopy_sim.calibration.explanation.ridge_path import RidgePath, inverse
from scipy import linalg


@pytest.fixture(params=[1, 2, 40])
def equations(request):
    """A badly conditioned G, a K, and two h."""
    N, random = request.param, np.random.default_rng(request.param)
    root = random.standard_normal((2 * N, N)) * np.geomspace(1, 1e-5, N)
    other = random.standard_normal((2 * N, N))
    return root.T @ root, other.T @ other, random.standard_normal((N, 2))


@pytest.mark.parametrize("α", [1e-8, 1e-3, 10.0])
def test_volume_fit_and_what_it_explains_are_those_of_the_dense_equations(equations, α):
    G, K, h = equations
    path, H = RidgePath.of(G, K, h), G + α * K
    eigenvalues = linalg.eigvalsh(G, K)
    for j in range(2):
        f = np.linalg.solve(H, h[:, j])
        volume, explained = path.volume_and_explained(α, j)
        assert volume == pytest.approx(np.log1p(np.maximum(eigenvalues, 0) / α).sum(), rel=1e-6)
        assert explained == pytest.approx(h[:, j] @ f, rel=1e-6)
        np.testing.assert_allclose(path.fit(α, j), f, rtol=1e-6, atol=1e-6 * np.abs(f).max())


def test_a_weight_below_rounding_has_an_infinite_volume():
    G = -1e-3 * np.eye(4)  # as rounding may leave it, only more so
    assert RidgePath.of(G, np.eye(4), np.ones((4, 1))).volume_and_explained(1e-4, 0) == (np.inf, 0)


def test_the_inverse_of_a_positive_definite_matrix_undoes_it(equations):
    _, K, _ = equations
    np.testing.assert_allclose(inverse(K) @ K, np.eye(len(K)), atol=1e-8)
    np.testing.assert_array_equal(inverse(K), inverse(K).T)
