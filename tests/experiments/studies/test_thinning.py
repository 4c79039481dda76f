"""The sparse preconditioner against brute force."""

import itertools

import numpy as np
import pytest
from scipy import sparse

from experiments.studies.thinning import (
    sparse_preconditioner,
)
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner


def random_problem(pixels, patches, lights, seed=0):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(pixels, patches)), rng.normal(size=(pixels, lights))
    return A, B, form_preconditioner(A, B)


def row_of_least_noise(A, B, support, patch):
    """The least-norm solution of p [A, B] = [e, 0] on a support, by NumPy's pseudoinverse."""
    conditions = np.hstack([A, B])[support]
    wanted = np.eye(len(conditions.T))[patch]
    return np.linalg.pinv(conditions.T) @ wanted


@pytest.mark.parametrize("density", [1.0, 0.7, 0.3, 0.15, 13 / 120])
def test_recovers_the_hidden_image_exactly_and_rejects_the_background(density):
    A, B, P = random_problem(120, 10, 3)
    sparse_P = sparse_preconditioner(P, density)
    assert sparse.issparse(sparse_P) and sparse_P.format == "csr"
    assert sparse_P.shape == (10, 120)
    assert (np.diff(sparse_P.indptr) == int(density * 120)).all()
    np.testing.assert_allclose(sparse_P @ A, np.eye(10), atol=1e-9)
    np.testing.assert_allclose(sparse_P @ B, 0, atol=1e-9)


def test_conditions_hold_where_there_are_nearly_as_many_patches_as_pixels():
    A, B, P = random_problem(60, 45, 3)
    sparse_P = sparse_preconditioner(P, 50 / 60)
    np.testing.assert_allclose(sparse_P @ A, np.eye(45), atol=1e-8)
    np.testing.assert_allclose(sparse_P @ B, 0, atol=1e-8)


def test_full_density_is_the_pseudoinverse():
    A, B, P = random_problem(60, 8, 3)
    expected = np.linalg.pinv(np.hstack([A, B]))[:8]
    np.testing.assert_allclose(sparse_preconditioner(P, 1.0).toarray(), expected, atol=1e-12)


@pytest.mark.parametrize("density", [0.9, 0.4, 0.2])
def test_each_row_has_the_least_noise_on_its_support(density):
    A, B, P = random_problem(80, 6, 2)
    for patch, row in enumerate(sparse_preconditioner(P, density).toarray()):
        support = np.flatnonzero(row)
        expected = row_of_least_noise(A, B, support, patch)
        np.testing.assert_allclose(row[support], expected, atol=1e-10)


def test_indices_are_sorted_and_narrow_so_that_products_run_through_memory():
    _, _, P = random_problem(80, 6, 2)
    sparse_P = sparse_preconditioner(P, 0.3)
    assert sparse_P.has_sorted_indices
    assert sparse_P.indices.dtype == sparse_P.indptr.dtype == np.int32


def test_a_removed_entry_costs_the_noise_that_the_refit_without_it_has_more():
    from experiments.studies.thinning import _removal_cost, coordinates_of

    A, B, P = random_problem(30, 4, 2)
    U, coordinates = coordinates_of(P)
    cost = _removal_cost(U, coordinates[1])
    noise = np.sum(row_of_least_noise(A, B, np.arange(30), 1) ** 2)
    for left_out in range(30):
        support = np.delete(np.arange(30), left_out)
        dearer = np.sum(row_of_least_noise(A, B, support, 1) ** 2) - noise
        assert cost[left_out] == pytest.approx(dearer, rel=1e-8)


def test_noise_is_near_the_least_of_all_supports():
    A, B, P = random_problem(12, 3, 1)
    found = sparse_preconditioner(P, 5 / 12).toarray()
    least = [
        min(
            np.sum(row_of_least_noise(A, B, list(support), patch) ** 2)
            for support in itertools.combinations(range(12), 5)
        )
        for patch in range(3)
    ]
    everything = [np.sum(row_of_least_noise(A, B, np.arange(12), k) ** 2) for k in range(3)]
    noise = np.sum(found**2, axis=1)
    assert (noise >= np.array(least) * (1 - 1e-9)).all()
    assert (noise <= 2 * np.array(least)).all()
    assert (np.array(least) > np.array(everything)).all()


def test_elimination_beats_keeping_the_largest_entries():
    A, B, P = random_problem(400, 40, 5)
    size = 60
    noise = np.sum(sparse_preconditioner(P, size / 400).toarray() ** 2)
    largest = np.argsort(-np.abs(P.matrix()), axis=1)[:, :size]
    refitted = [row_of_least_noise(A, B, largest[k], k) for k in range(40)]
    assert noise < 0.8 * np.sum(np.square(refitted))


def test_going_on_from_a_denser_result_only_leaves_entries_out():
    A, _, P = random_problem(120, 10, 3)
    denser = sparse_preconditioner(P, 0.5)
    thinner = sparse_preconditioner(P, 0.2, start=denser)
    assert set(zip(*thinner.nonzero(), strict=True)) < set(zip(*denser.nonzero(), strict=True))
    np.testing.assert_allclose(thinner @ A, np.eye(10), atol=1e-9)


def test_entries_that_the_start_has_not_stay_zero():
    A, _, P = random_problem(120, 10, 3)
    allowed = np.zeros((10, 120))
    allowed[:, 40:] = 1
    thinner = sparse_preconditioner(P, 0.2, start=sparse.csr_array(allowed)).toarray()
    assert not thinner[:, :40].any()
    np.testing.assert_allclose(thinner @ A, np.eye(10), atol=1e-9)


def test_progress_ends_at_one():
    _, _, P = random_problem(40, 5, 2)
    seen = []
    sparse_preconditioner(P, 0.5, progress=seen.append)
    assert seen == [0.2, 0.4, 0.6, 0.8, 1.0]


@pytest.mark.parametrize("density", [12 / 120, 1.01, float("nan")])
def test_a_density_at_which_the_conditions_cannot_hold_is_refused(density):
    _, _, P = random_problem(120, 10, 3)
    with pytest.raises(ValueError, match=r"give at least 0\.1083"):
        sparse_preconditioner(P, density)


def test_a_sparser_start_is_refused():
    _, _, P = random_problem(120, 10, 3)
    with pytest.raises(ValueError, match="go on from a denser one"):
        sparse_preconditioner(P, 0.5, start=sparse_preconditioner(P, 0.3))
