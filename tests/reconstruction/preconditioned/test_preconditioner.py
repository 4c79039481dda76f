import numpy as np
import pytest
from scipy import linalg

from periscopy_sim.model.ambient import RANK_TOLERANCE
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner
from tests.scenes import penumbrae
from tests.scenes.penumbrae import kept_basis, relative_error

PHOTOGRAPH = (20, 20)
HIDDEN = (5, 6)
M, N = 400, 30
OPACITIES = [1.0, 0.1, 0.02]  # of the occluder: condition numbers of about 30, 400 and 2000
TOLERANCES = [1e-2, 1e-4, 1e-8, 1e-10, 1e-12]


def transport(opacity=1.0):
    return penumbrae.transport(PHOTOGRAPH, HIDDEN, opacity)


def backgrounds():
    return penumbrae.backgrounds(PHOTOGRAPH, 64)


def pseudoinverse_top(A, Q):
    """[I 0] [A, s Q]^+, with s to balance the two."""
    s = np.linalg.norm(A) / max(Q.shape[1], 1) ** 0.5
    return np.linalg.pinv(np.hstack([A, s * Q]), rcond=1e-14)[: A.shape[1]]


def measurements(A, B, channels=3):
    """Hidden images and photographs of them drowned in background light."""
    rng = np.random.default_rng(2)
    f, e = rng.random((A.shape[1], channels)), rng.random((B.shape[1], channels))
    return f, A @ f + B @ e * (np.linalg.norm(A) / np.linalg.norm(B))


@pytest.mark.parametrize("opacity", OPACITIES)
@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_p_is_the_top_of_the_pseudoinverse_of_a_beside_a_background_basis(opacity, tolerance):
    """It inverts A, and leaves of each background no more than the tolerance."""
    A, B = transport(opacity), backgrounds()
    P = form_preconditioner(A, B, rank_tolerance=tolerance)
    oracle = pseudoinverse_top(A, kept_basis(B, tolerance))
    photographs = np.hstack([measurements(A, B)[1], np.random.default_rng(3).normal(size=(M, 3))])
    for y in photographs.T:
        assert relative_error(P.apply(y), oracle @ y) < 1e-6
    assert relative_error(P.matrix(), oracle) < 1e-6
    np.testing.assert_allclose(P.matrix() @ A, np.eye(N), atol=1e-8)
    np.testing.assert_allclose(P.apply(A), np.eye(N), atol=1e-8)
    unit = B / np.linalg.norm(B, axis=0)
    # What lies outside the range kept is at most the first singular value dropped.
    bound = tolerance * np.linalg.norm(unit, 2) + 1e-11
    norm = np.linalg.norm(P.matrix(), 2)
    assert np.linalg.norm(P.apply(unit), axis=0).max() / norm < bound
    assert np.linalg.norm(P.matrix() @ unit, axis=0).max() / norm < bound


def test_p_inverts_an_a_whose_gram_matrix_has_lost_its_smallest_values():
    A = transport(1e-4)
    assert np.linalg.cond(A) > 1e5
    """Refined, without forming P; P itself serves in single precision."""
    P = form_preconditioner(A)
    np.testing.assert_allclose(P.matrix() @ A, np.eye(N), atol=1e-5)
    np.testing.assert_allclose(P.apply(A), np.eye(N), atol=1e-8)


def weighted_minimizer(A, B, ω):
    """Least-norm minimizer of Eq. 7, ‖P B‖² + ω ‖P A − I‖², by brute-force least squares."""
    stacked = np.vstack([B.T, ω**0.5 * A.T])
    target = np.vstack([np.zeros((B.shape[1], A.shape[1])), ω**0.5 * np.eye(A.shape[1])])
    return np.linalg.lstsq(stacked, target, rcond=1e-13)[0].T


def well_separated():
    rng = np.random.default_rng(4)
    return rng.random((M, N)), rng.random((M, 6))


@pytest.mark.parametrize("ω", [1e-3, 1.0, 1e3])
def test_the_weight_of_eq_7_is_inert_while_the_ranges_meet_only_in_0(ω):
    A, B = well_separated()
    assert relative_error(form_preconditioner(A, B).matrix(), weighted_minimizer(A, B, ω)) < 1e-9


def test_the_weight_of_eq_7_matters_where_the_ranges_meet_and_p_is_refused():
    A, B = well_separated()
    A[:, 3] = B @ np.arange(1.0, 7.0)
    light, heavy = (weighted_minimizer(A, B, ω) for ω in (1e-3, 1e3))
    assert relative_error(light[3], heavy[3]) > 0.9
    others = np.arange(N) != 3
    assert relative_error(light[others], heavy[others]) < 1e-9
    with pytest.raises(ValueError, match=r"not full column rank .* the noise-aware method"):
        form_preconditioner(A, B)


def test_patch_nearly_like_background_is_resolved_at_the_price_of_its_noise():
    A, B = well_separated()
    alone = form_preconditioner(A, B).noise_gain[3]
    A[:, 3] = B @ np.arange(1.0, 7.0) + 0.1 * A[:, 3]
    P = form_preconditioner(A, B)
    np.testing.assert_allclose(P.apply(A), np.eye(N), atol=1e-8)
    assert P.noise_gain[3] == pytest.approx(100 * alone, rel=1e-6)


@pytest.mark.parametrize("opacity", OPACITIES)
@pytest.mark.parametrize("with_background", [True, False])
def test_noise_gain_is_the_diagonal_of_p_times_its_transpose(opacity, with_background):
    A, B = transport(opacity), backgrounds() if with_background else None
    Q = kept_basis(B, RANK_TOLERANCE) if with_background else np.zeros((M, 0))
    oracle = pseudoinverse_top(A, Q)
    P = form_preconditioner(A, B)
    np.testing.assert_allclose(P.noise_gain, np.sum(oracle**2, axis=1), rtol=1e-6)
    np.testing.assert_allclose(P.noise_gain, np.diag(P.matrix() @ P.matrix().T), rtol=1e-6)


@pytest.mark.parametrize("B", [None, np.zeros((M, 0)), np.zeros((M, 4))])
def test_no_background_gives_the_pseudoinverse_of_a(B):
    A = transport(0.1)
    P = form_preconditioner(A, B)
    assert P.Q.shape == (M, 0)
    assert relative_error(P.matrix(), np.linalg.pinv(A)) < 1e-9
    y = np.random.default_rng(0).random(M)
    np.testing.assert_array_equal(P.project_out(y), y)


def scattered(seed, rows=M, columns=N):
    return np.random.default_rng(seed).random((rows, columns))


@pytest.mark.parametrize("seed", range(8))
def test_patch_that_is_a_sum_of_others_is_refused(seed):
    A = scattered(seed)
    A[:, 3] = A[:, 5] + 0.5 * A[:, 7]
    for B in (None, scattered(seed + 100, columns=6)):
        with pytest.raises(ValueError, match=r"not full column rank \(30 patches, 0 of them"):
            form_preconditioner(A, B)


@pytest.mark.parametrize("dark", [1, 3, N])
def test_patches_that_the_wall_does_not_see_are_refused_and_counted(dark):
    A = transport()
    A[:, :dark] = 0
    message = rf"\(30 patches, {dark} of them invisible from the wall\): use fewer patches"
    for B in (None, backgrounds()):
        with pytest.raises(ValueError, match=message):
            form_preconditioner(A, B)


def test_cholesky_factor_is_that_of_a_with_the_background_projected_out():
    A, B = transport(), backgrounds()
    P = form_preconditioner(A, B)
    orthogonal = linalg.null_space(kept_basis(B, RANK_TOLERANCE).T)
    gram = (orthogonal.T @ A).T @ (orthogonal.T @ A)
    np.testing.assert_allclose(P.cholesky.T @ P.cholesky, gram, atol=1e-12 * gram.max())
    np.testing.assert_array_equal(P.cholesky, np.triu(P.cholesky))


def test_bad_arguments_are_rejected():
    A, B = transport(), backgrounds()
    with pytest.raises(ValueError, match="rows"):
        form_preconditioner(A[: N - 1])
    with pytest.raises(ValueError, match="rows"):
        form_preconditioner(A, B[1:])
    with pytest.raises(ValueError, match="tolerance"):
        form_preconditioner(A, B, rank_tolerance=1.0)
    for name, array in (("A", A), ("B", B)):
        array[7, 2] = np.nan
        with pytest.raises(ValueError, match=f"{name} must be finite"):
            form_preconditioner(*((A, B) if name == "A" else (transport(), B)))
