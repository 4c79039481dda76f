import numpy as np
import pytest

from periscopy_sim.reconstruction.matrix_product import times_matrix_transposed


def draw(vectors, rows, columns):
    rng = np.random.default_rng(0)
    shapes = (vectors, columns), (rows, columns)
    return (rng.standard_normal(shape).astype(np.float32) for shape in shapes)


@pytest.mark.parametrize("vectors", [1, 2, 3, 4, 24])
@pytest.mark.parametrize("rows", [1, 3, 4, 5, 6, 7, 8, 41, 103])
@pytest.mark.parametrize("columns", [1, 17, 500])
def test_product_is_that_of_double_precision_to_rounding(vectors, rows, columns):
    x, matrix = draw(vectors, rows, columns)
    product = times_matrix_transposed(x, matrix)
    assert product.dtype == np.float32 and product.shape == (vectors, rows)
    exact = x.astype(np.float64) @ matrix.astype(np.float64).T
    magnitude = np.abs(x).astype(np.float64) @ np.abs(matrix).astype(np.float64).T
    assert (np.abs(product - exact) <= 1e-6 * magnitude).all()


def test_same_product_every_time():
    x, matrix = draw(3, 203, 1000)
    first = times_matrix_transposed(x, matrix)
    for _ in range(20):
        np.testing.assert_array_equal(times_matrix_transposed(x, matrix), first)
