import numpy as np
import pytest

from periscopy_sim.reconstruction.baselines.differencing import neighbour_differences

SHAPES = [(3, 2), (2, 3), (4, 4), (5, 1), (1, 5)]


def published_d(shape):
    """D over a photograph vectorized by columns, and the order of the row-major pixels in it."""
    order = [i * shape[1] + j for j in range(shape[1]) for i in range(shape[0])]
    D = np.zeros((len(order), len(order)))
    for k in range(len(order) - 1):
        D[k, order[k]], D[k, order[k + 1]] = -1, 1
    D[-1, order[-1]] = 1
    return D


def d_within_columns(shape):
    rows = []
    for j in range(shape[1]):
        for i in range(shape[0] - 1):
            row = np.zeros(shape)
            row[i, j], row[i + 1, j] = -1, 1
            rows.append(row.ravel())
    return np.array(rows).reshape(-1, shape[0] * shape[1])


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("wrap", "matrix"), [(True, published_d), (False, d_within_columns)])
def test_differences_are_the_product_with_the_matrix_d(shape, wrap, matrix):
    A = np.random.default_rng(0).normal(size=(shape[0] * shape[1], 4))
    for values in (A, A[:, 0]):
        before = values.copy()
        differences = neighbour_differences(values, shape, wrap=wrap)
        np.testing.assert_allclose(differences, matrix(shape) @ values, atol=1e-15)
        np.testing.assert_array_equal(values, before)


def test_matrix_that_does_not_fit_the_photograph_is_refused():
    with pytest.raises(ValueError, match=r"3x4 pixels does not fit the 11 rows"):
        neighbour_differences(np.zeros((11, 2)), (3, 4))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("wrap", "matrix"), [(True, published_d), (False, d_within_columns)])
@pytest.mark.parametrize("seed", range(4))
def test_difference_counts_only_if_both_pixels_are_used(shape, wrap, matrix, seed):
    rng = np.random.default_rng(seed)
    mask = rng.random(shape) < 0.7
    before = mask.copy()
    A = rng.normal(size=(mask.size, 4))
    D = matrix(shape)
    kept = ~(D != 0)[:, ~mask.ravel()].any(axis=1)
    for values in (A, A[:, 0]):
        for form in (mask, mask.ravel(), np.asfortranarray(mask)):
            found = neighbour_differences(values[mask.ravel()], shape, wrap=wrap, mask=form)
            np.testing.assert_allclose(found, D[kept] @ values, atol=1e-15)
    np.testing.assert_array_equal(mask, before)
