"""Rows of least l1 norm against linear programming."""

import numpy as np
import pytest
from scipy import optimize

from experiments.studies.l1_rows import l1_minimal_rows
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner


def random_problem(pixels, patches, lights):
    rng = np.random.default_rng(0)
    A, B = rng.normal(size=(pixels, patches)), rng.normal(size=(pixels, lights))
    return A, B, form_preconditioner(A, B)


def test_l1_minimal_row_is_the_solution_of_the_linear_program():
    A, B, P = random_problem(40, 5, 2)
    rows = l1_minimal_rows(P, [0, 3], tolerance=1e-8)
    conditions = np.hstack([A, B])
    for patch, row in zip([0, 3], rows, strict=True):
        # p = a − b with a, b ≥ 0; the sum of both is least.
        program = optimize.linprog(
            np.ones(80),
            A_eq=np.hstack([conditions.T, -conditions.T]),
            b_eq=np.eye(7)[patch],
            method="highs",
        )
        expected = program.x[:40] - program.x[40:]
        assert np.abs(row).sum() == pytest.approx(program.fun, rel=1e-6)
        np.testing.assert_allclose(row, expected, atol=1e-5)
        assert np.sum(np.abs(row) > 1e-5) == 7


def test_l1_minimal_rows_fulfil_the_conditions():
    A, B, P = random_problem(40, 5, 2)
    rows = l1_minimal_rows(P, range(5), tolerance=1e-3)
    np.testing.assert_allclose(rows @ A, np.eye(5), atol=1e-10)
    np.testing.assert_allclose(rows @ B, 0, atol=1e-10)


def test_too_few_iterations_are_an_error():
    P = random_problem(40, 5, 2)[2]
    with pytest.raises(RuntimeError, match="not converged in 2"):
        l1_minimal_rows(P, [0], tolerance=1e-12, max_iterations=2)
