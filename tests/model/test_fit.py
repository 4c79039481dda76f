"""A scene fitted to the pixels used, against the formulas with dense matrices."""

import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.fit import (
    LARGEST_NOISE_RATIO,
    Fit,
    FittedPhotograph,
    camera_noise,
    residual_noise,
    second_differences,
)
from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.model.uncertainty import UncertainTransport
from periscopy_sim.photograph import Photograph

SIZES = np.array([1.0, 2.0, 0.5])[:, None, None]
V, U = np.meshgrid(*(np.linspace(-1, 1, 63),) * 2, indexing="ij")
PENUMBRAE = 100 * (1 / (1 + np.exp(-12 * U)) + 0.3 * V**2 + 0.2 * np.sin(3 * V * U))


def noise(shape, seed):
    return SIZES * np.random.default_rng(seed).standard_normal((3, *shape))


def test_differences_remove_linear_light_and_keep_the_variance_of_noise():
    assert np.abs(second_differences(np.stack([U, 3 * V + 1, U * V]))).max() < 1e-12
    found = np.mean(second_differences(noise(V.shape, 0)) ** 2, axis=(1, 2))
    np.testing.assert_allclose(found, SIZES.ravel() ** 2, rtol=0.15)
    y = noise(V.shape, 0)
    y[:, 30, 30] = np.nan
    assert np.isnan(second_differences(y)).sum(axis=(1, 2)).tolist() == [9, 9, 9]


@pytest.mark.parametrize("shape", [(24, 24), (40, 61)])
def test_estimate_is_unbiased(shape):
    found = np.array([camera_noise(noise(shape, seed)) for seed in range(120)]) / SIZES.ravel()
    # Five standard errors of the mean, and what so few differences cost.
    error = found.std(axis=0) / np.sqrt(120)
    assert (np.abs(found.mean(axis=0) - 1) < 5 * error + 0.01).all()
    assert found.std() < 2 / np.sqrt(np.prod(shape))


def test_light_of_the_scene_is_no_noise():
    found = camera_noise(noise(V.shape, 0) + PENUMBRAE)
    assert np.abs(found / SIZES.ravel() - 1).max() < 0.12


def test_edge_of_a_poster_and_dead_lines_are_no_noise():
    y = noise(V.shape, 1)
    y[:, 20:40, 10:30] += 50
    y[:, :, 50] = -30
    assert np.abs(camera_noise(y) / SIZES.ravel() - 1).max() < 0.15


def test_more_explained_than_there_is_does_not_pass_silently():
    energy = np.ones(3)
    assert residual_noise(energy, energy + 1e-7, 10).max() < 1e-6
    with pytest.warns(UserWarning, match="rounding explains more"):
        residual_noise(energy, energy + 1e-5 * np.eye(3)[0], 10)


HIDDEN, PHOTOGRAPH = (3, 4), (12, 15)
M, N = 180, 12
RNG = np.random.default_rng(0)
A = RNG.random((M, N)) + 0.1
B = RNG.random((M, 3))
OFF = RNG.uniform(0.5, 1.5, (M, 3))
MASK = RNG.random(PHOTOGRAPH) > 0.2
USED = MASK.ravel()
GAIN = np.array([1.2, 1.0, 0.8])
NOISE = np.array([0.05, 0.1, 0.2])
TRUTH = RNG.uniform(0.2, 1, (N, 3))
SIGNAL = A @ TRUTH + B @ RNG.random((3, 3)) + 0.5 * OFF
Y = (SIGNAL + NOISE * RNG.standard_normal((M, 3))) * GAIN


def fitted(A=A, B=B, mask=MASK, off=OFF, hidden=HIDDEN, **settings):
    dark = None if off is None else {"off": (off * GAIN).reshape(*PHOTOGRAPH, 3)}
    given = Photograph.of(Y.reshape(*PHOTOGRAPH, 3), mask=mask, monitor_off=dark)
    known = {"hidden": Hidden.of(hidden), "channel_gain": GAIN, "conditions": given}
    return Fit(A, B, **known, **settings)


@pytest.fixture(scope="module")
def fit():
    return fitted()


@pytest.fixture(scope="module")
def measured(fit):
    return FittedPhotograph(fit.planes(Y[None])[0], fit)


AMBIENT = np.hstack([B, OFF])[USED]
Q = np.linalg.qr(AMBIENT)[0]
PROJECTED = A[USED] - Q @ (Q.T @ A[USED])
GREY = (Y / GAIN)[USED]
REJECTED = GREY - Q @ (Q.T @ GREY)


def unexplained_by(columns, y):
    return y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]


def test_errors_of_the_scene_are_followed_once_for_an_image():
    asked = []

    def slopes(image):
        asked.append(image)
        return image.reshape(1, N, -1).repeat(M // N, axis=1)

    fit = fitted(uncertain=UncertainTransport(("dx",), np.array([[2.0]]), slopes))
    image = TRUTH.reshape(*HIDDEN, 3)
    expected = 2 * slopes(image)[:, USED].transpose(0, 2, 1)
    for _ in range(2):
        np.testing.assert_array_equal(fit.motions(image.copy()), expected)
    assert len(asked) == 2
    np.testing.assert_array_equal(fit.motions(3 * image), 3 * expected)


def test_gram_norm_and_operator_are_those_of_the_projected_matrix(fit):
    gram = PROJECTED.T @ PROJECTED
    np.testing.assert_allclose(fit.operator.gram, gram, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fit.factor.T @ fit.factor, gram, atol=1e-6 * np.trace(gram))
    np.testing.assert_allclose(fit.lights @ PROJECTED, fit.factor, atol=1e-5)
    assert fit.norm == pytest.approx(np.linalg.norm(PROJECTED))
    assert fit.unit == pytest.approx(np.linalg.norm(PROJECTED) / np.sqrt(N))
    assert fit.pixels == USED.sum() and len(fit.background) == 6 and fit.smooth_rank == 3
    smooth = fit.background[:3]
    np.testing.assert_allclose(unexplained_by(B[USED], smooth.T), 0, atol=1e-12)
    np.testing.assert_allclose(fit.operator @ np.eye(N), PROJECTED, atol=1e-6)


@pytest.fixture(scope="module")
def blurred():
    """A wall that shows patterns down to a millionth of the strongest one's light."""
    (V, U), (v, u) = (np.mgrid[-1:1:20j, -1:1:26j], np.mgrid[-1:1:12j, -1:1:16j])
    across = U.reshape(-1, 1) - u.ravel(), V.reshape(-1, 1) - v.ravel()
    A = np.exp(-2 * (across[0] ** 2 + across[1] ** 2)).astype(np.float32)
    return Fit(A, hidden=Hidden.of((12, 16)), photograph_shape=(20, 26))


def test_light_of_patterns_is_orthonormal_to_single_precision(blurred):
    assert blurred.curvatures[0] < 1e-11 * blurred.curvatures[-1]
    light = blurred.lights.astype(np.float64)
    np.testing.assert_allclose(light @ light.T, np.eye(len(light)), atol=3e-7)


@pytest.mark.parametrize("snr", [50, 60, 70, 80])
def test_noise_far_below_the_light_is_found(blurred, snr):
    rng = np.random.default_rng(snr)
    y = rng.uniform(0.2, 1, (3, 192)) @ blurred.A.T.astype(np.float64)
    size = 10 ** (-snr / 20) * y.mean()
    y += size * rng.standard_normal(y.shape)
    evidence = FittedPhotograph(y, blurred).evidence
    np.testing.assert_allclose(evidence.noise * evidence.level, size, rtol=0.15)


def test_faint_shadow_has_no_negative_energy():
    """Rounding of all the light must not make A⊥ᵀA⊥ of the faint shadow indefinite."""
    rng = np.random.default_rng(1)
    faint = B @ rng.random((3, N)) + 1e-4 * rng.random((M, 2)) @ rng.random((2, N))
    fit = fitted(A=faint, off=None)
    for gram in (fit.operator.gram, TransportOperator(faint[USED], fit.background.T).gram):
        assert np.linalg.eigvalsh(gram).min() > -1e-12 * np.trace(gram)
    assert np.isfinite(fit.operator.unexplained(GREY)).all()


def test_all_ambient_light_is_projected_out_and_nothing_else(fit):
    rows = np.vstack([AMBIENT.T, GREY.T])
    found = fit.project_out(rows)
    np.testing.assert_allclose(found[:6], 0, atol=1e-10)
    np.testing.assert_allclose(found[6:], REJECTED.T, atol=1e-10)


def test_noise_is_the_residual_of_least_squares_over_its_freedom(measured):
    evidence = measured.evidence
    rest = unexplained_by(np.hstack([A[USED], AMBIENT]), GREY)
    expected = np.sqrt(np.sum(rest**2, axis=0) / (USED.sum() - 6 - N))
    np.testing.assert_allclose(evidence.level * evidence.noise, expected, rtol=1e-4)
    assert evidence.level == pytest.approx(np.sqrt(np.mean(REJECTED**2)))
    np.testing.assert_allclose(measured.y * evidence.level, REJECTED.T, atol=1e-10)
    energy = (USED.sum() - 6) * np.sum(expected**2)
    ratio = energy / (np.sum(REJECTED**2) - energy)
    assert evidence.noise_to_signal == pytest.approx(ratio, rel=1e-3)


@pytest.mark.parametrize("most", [N, N - 3])
def test_evidence_needs_no_light_of_patterns(monkeypatch, most):
    monkeypatch.setattr("periscopy_sim.model.fit.MOST_PATTERNS", most)
    fit = fitted()
    found, expected = (
        fit.single_evidence(fit.planes(Y[None])[0]),
        fit.evidence(fit.planes(Y[None]))[0][0],
    )
    for name in ("coefficients", "noise", "level", "noise_to_signal"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-3)


def test_coefficients_explain_what_least_squares_does(fit, measured):
    evidence = measured.evidence
    expected = fit.patterns.rows @ PROJECTED.T @ REJECTED / (evidence.level * fit.unit)
    np.testing.assert_allclose(evidence.coefficients, expected.T, rtol=1e-4, atol=1e-4)
    explained = np.sum((REJECTED - unexplained_by(PROJECTED, REJECTED)) ** 2, axis=0)
    found = np.sum(fit.coordinates(evidence) ** 2, axis=1) * evidence.level**2
    np.testing.assert_allclose(found, explained, rtol=1e-4)


def test_response_is_a_product_with_the_projected_matrix(fit):
    light = np.random.default_rng(1).random((2, 3, fit.pixels))
    found = fit.response(light) @ fit.factor
    np.testing.assert_allclose(found, light @ PROJECTED, rtol=1e-4, atol=1e-3)


def test_unexplained_is_what_no_image_and_no_ambient_light_explain(fit):
    found = fit.unexplained(GREY.T)
    expected = unexplained_by(np.hstack([A[USED], AMBIENT]), GREY)
    np.testing.assert_allclose(found.T, expected, atol=1e-4)


def test_patterns_that_the_wall_does_not_show_are_not_counted():
    dark = A.copy()
    dark[:, 7] = 0
    fit = fitted(dark)
    assert len(fit.curvatures) == N - 1
    (evidence,), _ = fit.evidence(fit.planes(Y[None]))
    rest = unexplained_by(np.hstack([dark[USED], AMBIENT]), GREY)
    expected = np.sqrt(np.sum(rest**2, axis=0) / (USED.sum() - 6 - N + 1))
    np.testing.assert_allclose(evidence.level * evidence.noise, expected, rtol=1e-4)


def test_channel_of_hardly_any_noise_is_believed_up_to_a_ratio():
    fit = fitted(off=None)
    quiet = SIGNAL - 0.5 * OFF + [1e-7, 0.1, 0.2] * np.random.default_rng(1).normal(size=(M, 3))
    noise = FittedPhotograph(fit.planes(quiet[None] * GAIN)[0], fit).evidence.noise
    assert noise[0] == pytest.approx(noise[2] / LARGEST_NOISE_RATIO)


def test_noise_is_never_below_rounding():
    fit = fitted(off=None)
    exact = FittedPhotograph((A[USED] @ TRUTH).T, fit).evidence
    assert 1e-8 < exact.mean_noise < 1e-3 and exact.noise_to_signal < 1e-6  # single precision
    black = FittedPhotograph(np.zeros((3, fit.pixels)), fit).evidence
    ambient = FittedPhotograph(1e9 * np.tile(B[USED].sum(axis=1), (3, 1)), fit).evidence
    for evidence in (black, ambient):
        assert evidence.level == 1 and (evidence.noise > 0).all()
        assert not evidence.coefficients.any()


def test_signal_of_noise_alone_is_at_least_its_own_standard_error(fit):
    # The energy of N patterns in three channels has variance 2 · 3 N σ⁴.
    draws = np.random.default_rng(2).standard_normal((200, 3, fit.pixels))
    ratios = [evidence.noise_to_signal for evidence in fit.evidence(draws)[0]]
    most = 3 * (fit.pixels - 6) / np.sqrt(2 * 3 * N)
    assert max(ratios) == pytest.approx(most, rel=0.05)


def test_profiles_join_the_smooth_light_where_rows_and_columns_are_known():
    plain, more = fitted(), fitted(profiles=True)
    assert plain.smooth_rank < more.smooth_rank == len(more.background) - 3
    down = np.repeat(np.linspace(-1, 1, 12) ** 2, 15)[USED]
    assert np.abs(more.project_out(down[None])).max() < 1e-10
    assert np.abs(plain.project_out(down[None])).max() > 0.1
    assert Fit(A, B, hidden=Hidden.of(HIDDEN), profiles=True).smooth_rank == 3
    assert fitted(B=None, off=None, profiles=True).smooth_rank == 0


def test_matrices_that_cannot_be_used_are_refused():
    with pytest.raises(ValueError, match="B explains all"):
        _ = fitted(A=np.hstack([B, B, B, B]), off=None).norm
    for name in "AB":
        broken = {"A": A, "B": B}[name].copy()
        broken[np.flatnonzero(USED)[3], 1] = np.nan
        with pytest.raises(ValueError, match=f"{name} must be finite"):
            _ = fitted(**{name: broken}).norm
    with pytest.raises(ValueError, match="B has 179 rows"):
        fitted(B=B[1:])
