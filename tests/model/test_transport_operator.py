"""Passes over A against dense products and NumPy's decompositions."""

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator

from periscopy_sim.model import transport_operator
from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.testing import adjoint_test
from tests.scenes.blocks import Blocks


def matrix(pixels=41, patches=1031, dtype=np.float32, seed=0):
    return np.random.default_rng(seed).random((pixels, patches)).astype(dtype)


def basis(pixels=41, dimensions=4):
    return np.linalg.qr(np.random.default_rng(1).normal(size=(pixels, dimensions)))[0]


def projected(A, Q):
    return A.astype(np.float64) - Q @ (Q.T @ A.astype(np.float64))


def in_memory(A, _):
    return A


def read_only(A, _):
    A = A.copy()
    A.flags.writeable = False
    return A


def transposed(A, _):
    return np.asfortranarray(A)


def memory_map(A, folder):
    np.save(folder / "A.npy", A)
    return np.load(folder / "A.npy", mmap_mode="r")


def in_blocks(A, _):
    return Blocks(A)


kinds = pytest.mark.parametrize(
    "kind",
    [in_memory, read_only, transposed, memory_map, in_blocks],
    ids=lambda kind: kind.__name__,
)


@kinds
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_products_are_those_of_the_dense_matrix(kind, dtype, tmp_path):
    A, Q = matrix(dtype=dtype), basis()
    dense = projected(A, Q)
    operator = TransportOperator(kind(A, tmp_path), Q)
    rng = np.random.default_rng(2)
    f = rng.normal(size=(dense.shape[1], 3))
    assert isinstance(operator, LinearOperator) and operator.shape == A.shape
    np.testing.assert_allclose(operator @ f, dense @ f, atol=1e-11)
    np.testing.assert_allclose(operator @ f[:, 0], dense @ f[:, 0], atol=1e-11)
    np.testing.assert_allclose(operator.quick_light(f), operator.light(f), atol=1e-3)
    adjoint_test(operator, rtol=1e-12)
    assert operator.squared_norm == pytest.approx(np.sum(dense**2), rel=1e-12)


def test_rows_may_be_a_list():
    rows = np.random.default_rng(0).random((8, 3))
    operator = TransportOperator(rows.tolist(), np.zeros((8, 0)))
    np.testing.assert_allclose(operator.matmat(np.eye(3)), rows)


def test_backgrounds_of_another_size_are_refused():
    with pytest.raises(ValueError, match="B has 7 rows"):
        TransportOperator(matrix(), basis(7))


def test_a_matrix_with_nan_is_refused():
    A = matrix()
    A[3, 4] = np.nan
    with pytest.raises(ValueError, match="A must be finite"):
        TransportOperator(A, basis())


def test_a_matrix_that_the_backgrounds_explain_is_refused():
    Q = basis()
    with pytest.raises(ValueError, match="B explains all of A"):
        TransportOperator(Q @ np.ones((4, 6)), Q)


@kinds
def test_used_rows_are_those_of_the_mask(kind, tmp_path):
    A, mask = matrix(patches=300), np.random.default_rng(2).random(41) < 0.6
    mask[3:9] = False  # two blocks of three in which nothing is used
    used = transport_operator.used_rows(kind(A, tmp_path), mask)
    np.testing.assert_array_equal(used, A[mask])
