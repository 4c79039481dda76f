"""The range of backgrounds, beside NumPy's singular vectors.

Passes over A against dense products and NumPy's decompositions.
"""

import numpy as np
import pytest
from scipy.sparse.linalg import LinearOperator

from periscopy_sim.model.transport_operator import (
    TransportOperator,
    background_basis,
    joined_basis,
    wall_profiles,
)
from periscopy_sim.numerics import precision_of
from periscopy_sim.testing import adjoint_test
from tests.scenes import penumbrae
from tests.scenes.penumbrae import kept_basis

M = 400


def backgrounds(count=64):
    return penumbrae.backgrounds((20, 20), count)


@pytest.mark.parametrize("tolerance", [0.9, 1e-4, 1e-8, 1e-12])
def test_basis_is_orthonormal_and_spans_what_numpys_singular_vectors_do(tolerance):
    B = backgrounds()
    Q, oracle = background_basis(B, tolerance), kept_basis(B, tolerance)
    assert Q.shape == oracle.shape
    np.testing.assert_allclose(Q.T @ Q, np.eye(Q.shape[1]), atol=1e-13)
    if tolerance >= 1e-6:
        np.testing.assert_allclose(Q @ Q.T, oracle @ oracle.T, atol=1e-8)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-12])
@pytest.mark.parametrize("bright", [0.0, 1e9])
def test_many_smooth_backgrounds_are_sketched_to_the_same_basis(tolerance, bright):
    B = backgrounds(300)
    B[:, 7] *= bright
    oracle = kept_basis(B[:, B.any(axis=0)], tolerance)
    Q = background_basis(B, tolerance)
    assert Q.shape == oracle.shape
    np.testing.assert_allclose(Q.T @ Q, np.eye(Q.shape[1]), atol=1e-13)
    # What of each background lies outside, beside what does by NumPy's singular vectors.
    unit = B[:, B.any(axis=0)] / np.linalg.norm(B[:, B.any(axis=0)], axis=0)
    found, expected = (np.linalg.norm(unit - q @ (q.T @ unit)) for q in (Q, oracle))
    assert found < 1.01 * expected + 1e-13


@pytest.mark.parametrize("shape", [(M, 9), (12, 40), (12, 12), (1, 3)])
def test_basis_of_an_exact_rank(shape):
    rng = np.random.default_rng(6)
    rank = min(5, *shape)
    B = rng.normal(size=(shape[0], rank)) @ rng.normal(size=(rank, shape[1]))
    Q = background_basis(B)
    assert Q.shape == (shape[0], rank)
    np.testing.assert_allclose(Q.T @ Q, np.eye(rank), atol=1e-13)
    np.testing.assert_allclose(Q @ (Q.T @ B), B, atol=1e-12 * np.abs(B).max())


def test_columns_count_alike_whatever_their_brightness():
    B = backgrounds()
    dimmed = B * np.logspace(0, 9, B.shape[1])
    Q, same = background_basis(B, 1e-6), background_basis(dimmed, 1e-6)
    np.testing.assert_allclose(Q @ Q.T, same @ same.T, atol=1e-8)


@pytest.mark.parametrize("cast", [[np.float32], [np.float32, np.float64], [np.float16]])
def test_rounding_of_backgrounds_counts_as_no_light(cast):
    B = exact = backgrounds(150)
    for kind in cast:
        B = B.astype(kind)
    Q = background_basis(B)
    assert 4 < Q.shape[1] < background_basis(exact).shape[1] < 60
    unit = exact / np.linalg.norm(exact, axis=0)
    assert np.linalg.norm(unit - Q @ (Q.T @ unit), 2) < 3 * np.finfo(cast[0]).eps * np.sqrt(150)
    assert background_basis(np.hstack([exact, B])).shape[1] < 60 or np.float16 in cast
    assert joined_basis(exact_Q := background_basis(exact), B).shape == exact_Q.shape


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.float16])
def test_precision_is_that_of_the_narrowest_type_that_values_went_through(kind):
    values = np.random.default_rng(0).normal(size=(50, 3)).astype(kind)
    assert precision_of(values) == np.finfo(kind).eps
    assert kind == np.float16 or precision_of(values.astype(float)) == np.finfo(kind).eps
    for exact in (np.ones((9, 2)), np.zeros((9, 0)), np.arange(9)[:, None]):
        assert precision_of(exact) == np.finfo(float).eps


@pytest.mark.parametrize("alone", [0.3, 1e-6])
def test_joined_basis_includes_a_column_however_little_of_it_lies_outside(alone):
    rng = np.random.default_rng(3)
    Q = background_basis(rng.normal(size=(M, 4)))
    own = rng.normal(size=(M, 2))
    columns = np.hstack([Q @ rng.normal(size=(4, 2)) + alone * own, Q[:, :1]])
    joined = joined_basis(Q, columns)
    assert joined.shape == (M, 6)
    np.testing.assert_array_equal(joined[:, :4], Q)
    np.testing.assert_allclose(joined.T @ joined, np.eye(6), atol=1e-12)
    np.testing.assert_allclose(joined @ (joined.T @ columns), columns, atol=1e-12)


@pytest.mark.parametrize(("shape", "count"), [((126, 40), 20 + 6 + 1), ((7, 3), 1 + 0 + 1)])
def test_profiles_vary_along_one_side_and_fit_what_is_smooth_there(shape, count):
    profiles = wall_profiles(shape)
    assert profiles.shape == (shape[0] * shape[1], count)
    fields = profiles.T.reshape(count, *shape)
    varies = [np.ptp(field, axis=axis).max() > 0 for field in fields for axis in (0, 1)]
    assert not any(a and b for a, b in np.reshape(varies, (-1, 2)))
    assert np.linalg.matrix_rank(profiles) == count


def test_a_column_in_single_precision_hides_nothing_of_the_others():
    B = np.linalg.qr(np.random.default_rng(2).standard_normal((400, 30)))[0] * 0.3 ** np.arange(30)
    B = B @ np.random.default_rng(3).standard_normal((30, 60))
    photograph = np.random.default_rng(4).uniform(1, 2, (400, 1)).astype(np.float32)
    rank = background_basis(B).shape[1]
    assert background_basis(np.hstack([B, photograph.astype(float)])).shape[1] == rank + 1


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


kinds = pytest.mark.parametrize(
    "kind", [in_memory, read_only, transposed, memory_map], ids=lambda kind: kind.__name__
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
