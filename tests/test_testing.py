"""The public checks pass what is right, and say what is wrong with the rest."""

import doctest

import numpy as np
import pytest
from scipy.sparse.linalg import aslinearoperator

from periscopy_sim import testing
from periscopy_sim.testing import adjoint_test, derivative_test, prox_oracle

RNG = np.random.default_rng(0)
A = RNG.normal(size=(5, 3))


class Pair:
    """An operator whose products have two names."""

    def __init__(self, names, forward, backward, shape=(5, 3)):
        self.shape = shape
        for name, function in zip(names, (forward, backward), strict=True):
            setattr(self, name, function)


def test_examples_are_as_printed():
    assert doctest.testmod(testing).attempted > 8
    assert doctest.testmod(testing).failed == 0


@pytest.mark.parametrize("names", testing.NAMES)
def test_adjoints_are_checked_under_every_name(names):
    adjoint_test(Pair(names, A.__matmul__, A.T.__matmul__), rtol=1e-12)
    for wrong in (1.0001 * A, A * np.where(np.arange(15).reshape(5, 3) == 7, -1, 1)):
        with pytest.raises(AssertionError, match=rf"{names[1]}: <A x, y> = .*, but"):
            adjoint_test(Pair(names, A.__matmul__, wrong.T.__matmul__))


def test_an_operator_of_scipys_is_checked_and_what_is_none_named():
    adjoint_test(aslinearoperator(A), rtol=1e-12)
    with pytest.raises(AssertionError, match="ndarray has none of the pairs"):
        adjoint_test(A)
    with pytest.raises(AssertionError, match=r"A\^T y has shape \(5,\) instead of \(3,\)"):
        adjoint_test((A.__matmul__, lambda y: y), ((3,), (5,)))


def curves(x):
    return np.array([np.sin(x[0]) * x[1], np.exp(x[0]), x[1] ** 3])


def slopes(x):
    return np.array([[np.cos(x[0]) * x[1], np.exp(x[0]), 0], [np.sin(x[0]), 0, 3 * x[1] ** 2]])


def test_derivatives_are_checked_to_one_in_ten_thousand():
    x = np.array([0.3, 2.0])
    derivative_test(curves, slopes(x), x, steps=[1e-3, 1e-2], rtol=1e-8)
    derivative_test(lambda v: curves(v).sum(), slopes(x).sum(axis=1), x)
    for k in (0, 1):
        wrong = slopes(x)
        wrong[k] *= 1.0002
        with pytest.raises(AssertionError, match=rf"derivative {k} is off by .* 0.0002 of"):
            derivative_test(curves, wrong, x)
        derivative_test(curves, wrong, x, rtol=1e-3)
        derivative_test(curves, wrong, x, atol=1e-2)
    with pytest.raises(AssertionError, match=r"shape \(2,\), the function's value \(3,\)"):
        derivative_test(curves, slopes(x)[:, :2], x)
    with pytest.raises(AssertionError, match="1 derivatives by 2 numbers"):
        derivative_test(curves, slopes(x)[:1], x)


def test_differences_that_are_of_no_use_are_told():
    with pytest.raises(AssertionError, match=r"half: [1-9]\.\de[+]\d\d apart"):
        derivative_test(lambda x: np.float32(1 + x[0]), [1.0], [0.0], steps=1e-7)


def soft(g, l1_weight=1.0):
    return np.sign(g) * np.maximum(np.abs(g) - l1_weight, 0)


def sparse(f, g):
    return np.sum((f - g) ** 2) / 2 + np.abs(f).sum()


@pytest.mark.parametrize("wrong", [0.99, 1.01])
def test_results_that_minimize_nothing_are_noticed(wrong):
    g = 2 * RNG.normal(size=(3, 4))
    prox_oracle(soft, sparse, g)
    with pytest.raises(AssertionError, match=r"the objective of the result is .*, of "):
        prox_oracle(lambda g: soft(g, wrong), sparse, g)
    with pytest.raises(AssertionError, match=r"falls to .*, below 0"):
        prox_oracle(soft, sparse, g, lower=0)
    prox_oracle(lambda g: np.maximum(soft(g), 0), sparse, g, lower=0)
    with pytest.raises(AssertionError, match="of "):
        prox_oracle(lambda g: np.maximum(soft(g), 0), sparse, g)
    with pytest.raises(AssertionError, match=r"shape \(12,\)"):
        prox_oracle(np.ravel, sparse, g)
