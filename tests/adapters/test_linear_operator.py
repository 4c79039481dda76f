"""The light transport as SciPy takes it, against dense NumPy."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse.linalg import lsqr

from periscopy_sim.adapters.linear_operator import transport_operator
from periscopy_sim.testing import adjoint_test

SCENE = SimpleNamespace(photograph_shape=(5, 6), hidden_shape=(3, 4), channel_gain=(1.2, 1.0, 0.8))


@pytest.fixture(name="A")
def matrix():
    return np.random.default_rng(0).random((30, 12))


def blocks_of(A):
    halves = [(slice(0, 13), A[:13]), (slice(13, 30), A[13:])]
    return SimpleNamespace(shape=A.shape, dtype=A.dtype, row_blocks=lambda: iter(halves))


@pytest.mark.parametrize("kept", [np.asarray, blocks_of])
@pytest.mark.parametrize("scene", [None, SCENE])
def test_products_and_adjoint_are_those_of_the_dense_matrix(A, kept, scene):
    operator = transport_operator(kept(A), scene)
    dense = np.kron(A, np.eye(3) if scene is None else np.diag(scene.channel_gain))
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(36, 2)), rng.normal(size=(90, 2))
    np.testing.assert_allclose(operator @ x, dense @ x)
    np.testing.assert_allclose(operator @ x[:, 0], dense @ x[:, 0])
    np.testing.assert_allclose(operator.H @ y, dense.T @ y)
    np.testing.assert_allclose(operator.T @ y[:, 0], dense.T @ y[:, 0])
    adjoint_test(operator, rtol=1e-12)


def test_vectors_are_images(A):
    operator = transport_operator(A, SCENE)
    image = np.random.default_rng(2).random((3, 4, 3))
    photograph = operator.photograph(operator @ image.ravel())
    np.testing.assert_allclose(photograph[..., 0].ravel(), 1.2 * A @ image[..., 0].ravel())
    np.testing.assert_array_equal(operator.image(image.ravel()), image)
    found = lsqr(operator, photograph.ravel(), atol=1e-14, btol=1e-14)[0]
    np.testing.assert_allclose(operator.image(found), image, atol=1e-8)


def test_single_precision_stays_single(A):
    operator = transport_operator(A.astype(np.float32))
    assert operator.dtype == np.float32
    assert (operator @ np.ones(36)).dtype == np.float32
    assert (operator.T @ np.ones(90)).dtype == np.float32
    assert operator.hidden_shape == (1, 12, 3)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"hidden_shape": (3, 5)}, r"\(3, 5\)"),
        ({"photograph_shape": (5, 5)}, r"\(5, 5\)"),
        ({"channel_gain": [1.0, 2.0]}, "each of 3 channels"),
    ],
)
def test_what_does_not_fit_is_refused(A, given, says):
    with pytest.raises(ValueError, match=says):
        transport_operator(A, SimpleNamespace(**vars(SCENE) | given))
