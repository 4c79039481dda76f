from itertools import product

import numpy as np
import pytest
from numba.core import caching

from periscopy_sim.numerics import products


def mean(values):
    return values.sum() / values.size


def test_a_read_only_home_costs_the_cache_alone(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert products.compiled(mean)(np.arange(5.0)) == 2


PRECISION = {np.float32: 1e-6, np.float64: 1e-14}
MIXED = np.float64, np.float32


def draw(*shapes, dtype=np.float32):
    rng = np.random.default_rng(0)
    return [rng.standard_normal(shape).astype(dtype) for shape in shapes]


def assert_product(product, x, matrix):
    exact = x.astype(np.float64) @ matrix.astype(np.float64).T
    magnitude = np.abs(x).astype(np.float64) @ np.abs(matrix).astype(np.float64).T
    assert product.dtype == x.dtype and product.shape == exact.shape
    assert (np.abs(product - exact) <= PRECISION[x.dtype.type] * magnitude).all()


@pytest.mark.parametrize("types", [*((dtype, dtype) for dtype in PRECISION), MIXED])
def test_products_with_rows_are_exact_to_rounding(types):
    for vectors, rows, columns in product([1, 3, 4, 24], [1, 3, 4, 5, 7, 8, 41], [1, 17, 2500]):
        x, matrix = draw((vectors, columns), (rows, columns), dtype=np.float64)
        x, matrix = x.astype(types[0]), matrix.astype(types[1])
        assert_product(products.times_rows(x, matrix), x, matrix)


def test_large_products_on_threads_are_the_same_every_time():
    x, matrix = draw((24, 5000), (403, 5000))
    first = products.times_rows(x, matrix)
    assert_product(first, x, matrix)
    for _ in range(5):
        np.testing.assert_array_equal(products.times_rows(x, matrix), first)


def test_combinations_of_rows_are_subtracted():
    for vectors, rows, columns in product([3, 6, 24], [0, 1, 3, 4, 9, 44], [1, 17, 2500]):
        x, coefficients, matrix = draw(
            (vectors, columns), (vectors, rows), (rows, columns), dtype=np.float64
        )
        expected = x - coefficients @ matrix
        products.subtract_combinations(x, coefficients, matrix)
        np.testing.assert_allclose(x, expected, atol=1e-12)


def test_products_of_three_vectors_are_the_same_bytes_among_many():
    x, matrix = draw((24, 3100), (41, 3100))
    among_many = products.times_rows(x, matrix)
    for k in range(0, 24, 3):
        np.testing.assert_array_equal(
            products.times_rows(x[k : k + 3].copy(), matrix), among_many[k : k + 3]
        )


@pytest.mark.parametrize("dtype", PRECISION)
@pytest.mark.parametrize("vectors", [1, 3])
@pytest.mark.parametrize(("rows", "columns"), [(0, 17), (1, 1), (9, 17), (44, 1044)])
def test_rows_are_combined_by_filtered_products(dtype, vectors, rows, columns):
    x, matrix, gain, offset = draw(
        (vectors, columns), (rows, columns), (vectors, rows), (vectors, rows), dtype=dtype
    )
    found = products.filter_rows(x, matrix, gain, offset)
    x, matrix, gain, offset = (array.astype(np.float64) for array in (x, matrix, gain, offset))
    exact = (gain * (x @ matrix.T) + offset) @ matrix
    size = (np.abs(gain) * (np.abs(x) @ np.abs(matrix).T) + np.abs(offset)) @ np.abs(matrix)
    assert found.dtype == dtype
    assert (np.abs(found - exact) <= PRECISION[dtype] * size).all()


def test_halves_of_a_large_matrix_are_filtered_as_the_whole(monkeypatch):
    x, matrix, gain, offset = draw((3, 17), (9, 17), (3, 9), (3, 9), dtype=np.float64)
    whole = products.filter_rows(x, matrix, gain, offset)
    monkeypatch.setattr(products, "LARGE", 1)
    np.testing.assert_allclose(products.filter_rows(x, matrix, gain, offset), whole, atol=1e-12)


@pytest.mark.parametrize("vectors", [1, 3, 18])
def test_combinations_of_rows_are_a_product(vectors):
    x, rows = draw((vectors, 9), (9, 2500))
    assert_product(products.combine_rows(x, rows), x, np.ascontiguousarray(rows.T))


@pytest.mark.parametrize(("vectors", "rank"), [(1, 0), (3, 1), (7, 5), (18, 44)])
@pytest.mark.parametrize("types", [(np.float32,) * 2, (np.float64,) * 2, (np.float32, np.float64)])
def test_rejected_vectors_have_no_part_in_the_basis_and_keep_the_rest(vectors, rank, types):
    x, random = draw((vectors, 2500), (2500, rank), dtype=np.float64)
    basis = np.ascontiguousarray(np.linalg.qr(random)[0].T).astype(types[1])
    given = x.astype(types[0])
    left = products.project_out(given, basis)
    assert left.dtype == types[1] and np.array_equal(given, x.astype(types[0]))
    exact = x - (x @ basis.astype(np.float64).T) @ basis
    assert np.abs(left - exact).max() < (1e-5 if np.float32 in types else 1e-13)
