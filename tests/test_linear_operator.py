"""The light transport as SciPy takes it, against dense NumPy."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse.linalg import lsqr

from periscopy_sim.adapters import transport_operator
from periscopy_sim.testing import adjoint_test

SCENE = {"photograph_shape": (5, 6), "hidden": (3, 4), "channel_gain": [1.2, 1.0, 0.8]}


def scene_of(**more):
    return SimpleNamespace(**SCENE | more)


@pytest.fixture(name="A")
def matrix():
    return np.random.default_rng(0).random((30, 12))


def blocks_of(A):
    halves = [(slice(0, 13), A[:13]), (slice(13, 30), A[13:])]
    return SimpleNamespace(shape=A.shape, dtype=A.dtype, row_blocks=lambda: iter(halves))


@pytest.mark.parametrize("kept", [np.asarray, blocks_of])
@pytest.mark.parametrize("gain", [None, [1.2, 1.0, 0.8], [0.7], [1, 2, 3, 4, 5]])
def test_products_and_adjoint_are_those_of_the_dense_matrix(A, kept, gain):
    operator = transport_operator(kept(A), gain and scene_of(channel_gain=gain))
    dense = np.kron(A, np.diag([1.0] * 3 if gain is None else gain))
    rng = np.random.default_rng(1)
    x, y = (rng.normal(size=(size, 2)) for size in dense.shape[::-1])
    np.testing.assert_allclose(operator @ x, dense @ x)
    np.testing.assert_allclose(operator @ x[:, 0], dense @ x[:, 0])
    np.testing.assert_allclose(operator.H @ y, dense.T @ y)
    np.testing.assert_allclose(operator.T @ y[:, 0], dense.T @ y[:, 0])
    adjoint_test(operator, rtol=1e-12)


def test_vectors_are_images(A):
    operator = transport_operator(A, scene_of(channel_gain=[1, 1, 1]))
    image = np.random.default_rng(2).random((3, 4, 3))
    photograph = operator.photograph(operator @ image.ravel())
    np.testing.assert_allclose(photograph[..., 1].ravel(), A @ image[..., 1].ravel())
    np.testing.assert_array_equal(operator.image(image.ravel()), image)
    found = lsqr(operator, photograph.ravel(), atol=1e-14, btol=1e-14)[0]
    np.testing.assert_allclose(operator.image(found), image, atol=1e-8)


def test_single_precision_stays_single(A):
    operator = transport_operator(A.astype(np.float32))
    assert operator.dtype == np.float32
    assert (operator @ np.ones(36)).dtype == np.float32
    assert (operator.T @ np.ones(90)).dtype == np.float32
    assert operator.hidden.shape == (1, 12)


@pytest.mark.parametrize(
    ("given", "says"), [({"hidden": (3, 5)}, "3x5"), ({"photograph_shape": (5, 5)}, r"\(5, 5\)")]
)
def test_what_does_not_fit_is_refused(A, given, says):
    with pytest.raises(ValueError, match=says):
        transport_operator(A, scene_of(**given))
