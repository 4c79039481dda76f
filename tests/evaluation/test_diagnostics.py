import numpy as np
import pytest

from periscopy_sim.evaluation.design import condition_number, diagnose, residual_background
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.preconditioned import form_preconditioner
from tests.scenes.penumbrae import kept_basis

FILM = (12, 10)
HIDDEN = (3, 4)
M, N = 120, 12


def transport(seed=0):
    return np.random.default_rng(seed).random((M, N)) ** 4


def backgrounds(count=25):
    """Point lights about 1 to 3 m from a wall of 0.4 m."""
    row, column = np.divmod(np.arange(M), FILM[1])
    points = np.stack([0.04 * column, 0.035 * row, np.zeros(M)], axis=1)
    lights = np.random.default_rng(1).uniform([-2, -2, 1], [2, 2, 3], (count, 3))
    away = lights - points[:, None]
    return away[..., 2] / np.sum(away**2, axis=2) ** 1.5


def projected_pseudoinverse(A, B, tolerance):
    """P and the rank kept of B, from NumPy's decompositions."""
    Q = kept_basis(B, tolerance)
    return np.linalg.pinv(A - Q @ (Q.T @ A)), Q.shape[1]


def residuals(P, B):
    return np.linalg.norm(P @ B, axis=0) / (np.linalg.norm(P, 2) * np.linalg.norm(B, axis=0))


@pytest.mark.parametrize("shape", [(40, 7), (7, 7), (7, 40), (5, 1)])
def test_condition_number_is_the_ratio_of_singular_values(shape):
    A = np.random.default_rng(2).normal(size=shape) * np.logspace(0, 3, shape[1])
    assert condition_number(A) == pytest.approx(np.linalg.cond(A), rel=1e-9)
    single = A.astype(np.float32)
    expected = np.linalg.cond(single.astype(np.float64))
    assert condition_number(single) == pytest.approx(expected, rel=1e-9)


def difference_matrix():
    """D of a photograph, column after column."""
    by_columns = np.eye(M).reshape(*FILM, M).transpose(1, 0, 2).reshape(M, M)
    return np.vstack([by_columns[1:] - by_columns[:-1], by_columns[-1]])


@pytest.mark.parametrize("degrees", [(10.0, 70.0), (0.5, 89.9), (30.0, 30.0)])
def test_angles_are_the_principal_ones_of_a_and_b(degrees):
    rng = np.random.default_rng(5)
    e = np.linalg.qr(rng.normal(size=(20, 5)))[0].T
    first, second = np.deg2rad(degrees)
    A = e[:2].T @ rng.normal(size=(2, 2))
    B = np.stack(
        [
            np.cos(first) * e[0] + np.sin(first) * e[2],
            np.cos(second) * e[1] + np.sin(second) * e[3],
        ],
        axis=1,
    )
    result = diagnose(A, B @ rng.normal(size=(2, 4)), (4, 5), (1, 2))
    assert result.background_rank == 2
    assert result.smallest_angle == pytest.approx(min(degrees), abs=1e-6)
    assert result.largest_angle == pytest.approx(max(degrees), abs=1e-6)


@pytest.mark.parametrize("degrees", [5.0, 45.0])
def test_background_at_an_angle_costs_one_over_its_squared_sine(degrees):
    angle = np.deg2rad(degrees)
    e = np.eye(6)
    A, B = 2 * e[:, :1], (np.cos(angle) * e[:, 0] + np.sin(angle) * e[:, 1])[:, None]
    result = diagnose(A, B, (3, 2), (1, 1))
    assert result.bound_ratio == pytest.approx(np.sin(angle) ** 2, rel=1e-9)
    assert result.bounds.item() == pytest.approx(0.5 / np.sin(angle), rel=1e-9)
    assert result.bounds_without_background.item() == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("part", [0, 0.3])
def test_mask_leaves_out_rows_of_a_b_and_the_differences(part):
    mask = np.random.default_rng(5).random(FILM) > part if part else None
    used = np.ones(M, bool) if mask is None else mask.ravel()
    A, B = transport(), backgrounds()
    given = None if mask is None else Photograph.of(np.ones(FILM), mask=mask)
    found = diagnose(
        np.where(used[:, None], A, np.nan), np.where(used[:, None], B, np.nan), FILM, HIDDEN,
        photograph=given, rank_tolerance=1e-6,
    )  # fmt: skip
    D = difference_matrix()
    D = D[~D[:, ~used].any(axis=1)]
    assert found.condition_A == pytest.approx(np.linalg.cond(A[used]), rel=1e-9)
    assert found.condition_DA == pytest.approx(np.linalg.cond(D @ A), rel=1e-9)
    P, rank = projected_pseudoinverse(A[used], B[used], 1e-6)
    assert found.background_rank == rank
    assert np.allclose(found.bounds.ravel(), np.linalg.norm(P, axis=1), rtol=1e-6)
    alone = np.linalg.pinv(A[used])
    expected = np.linalg.norm(alone, axis=1)
    assert np.allclose(found.bounds_without_background.ravel(), expected, rtol=1e-6)
    assert found.bound_ratio == pytest.approx(np.sum(alone**2) / np.sum(P**2), rel=1e-6)
    assert found.residual_background == pytest.approx(100 * residuals(P, B[used]).mean(), rel=1e-3)
    with pytest.raises(ValueError, match="leaves 11 pixels for 12 patches"):
        few = Photograph.of(np.ones(FILM), mask=np.arange(M).reshape(FILM) < 11)
        diagnose(A, B, FILM, HIDDEN, photograph=few)


def test_photographs_with_the_monitor_off_are_columns_of_b():
    A, B, off = transport(), backgrounds(), np.random.default_rng(1).random((*FILM, 2)) + 1
    given = Photograph.of(np.ones((*FILM, 2)), monitor_off=[off])
    found = diagnose(A, B, FILM, HIDDEN, photograph=given, rank_tolerance=1e-6)
    joined = np.hstack([B, off.reshape(M, 2)])
    expected = diagnose(A, joined, FILM, HIDDEN, rank_tolerance=1e-6)
    assert np.allclose(found.bounds, expected.bounds)
    assert found.background_rank == expected.background_rank


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-4])
def test_residual_background_is_that_of_the_explicit_matrix(tolerance):
    A, B = transport(), backgrounds()
    expected = residuals(projected_pseudoinverse(A, B, tolerance)[0], B)
    assert expected.max() > 1e-7
    P = form_preconditioner(A, B, rank_tolerance=tolerance)
    np.testing.assert_allclose(residual_background(P, B), expected, rtol=1e-6)
    result = diagnose(A, B, FILM, HIDDEN, rank_tolerance=tolerance)
    assert result.residual_background == pytest.approx(100 * expected.mean(), rel=1e-6)


@pytest.mark.parametrize("B", [np.zeros((M, 0)), np.zeros((M, 2))])
def test_no_background_leaves_nothing_and_costs_nothing(B):
    result = diagnose(transport(), B, FILM, HIDDEN)
    assert result.background_rank == 0
    assert result.residual_background == 0
    assert result.smallest_angle == result.largest_angle == 90
    assert result.bound_ratio == 1


def test_a_that_the_background_hides_is_refused():
    A, B = transport(), backgrounds()
    A[:, 2] = B[:, 3]
    with pytest.raises(ValueError, match="not full column rank"):
        diagnose(A, B, FILM, HIDDEN)
