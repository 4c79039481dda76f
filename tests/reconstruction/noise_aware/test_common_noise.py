"""Noise that the channels share: found, and taken in its own axes."""

import numpy as np
import pytest
from scipy import ndimage

from periscopy_sim.evaluation.metrics import mean_squared_error
from periscopy_sim.reconstruction.noise_aware import still
from periscopy_sim.reconstruction.noise_aware.common_noise import (
    common_noise,
    is_shared,
    noise_covariance,
)
from periscopy_sim.reconstruction.noise_aware.still import NoiseAware

SHAPE, HIDDEN = (40, 44), (6, 7)
V, U = np.meshgrid(*(np.linspace(-1, 1, size) for size in SHAPE), indexing="ij")
LIGHT = np.array([1.0, 2.0, 0.7])


def noise(seed, shape=SHAPE):
    return np.random.default_rng(seed).standard_normal((3, *shape))


def paint(scale, seed=0):
    field = np.random.default_rng(seed).standard_normal(SHAPE)
    smooth = ndimage.gaussian_filter(field, scale, mode="wrap") if scale else field
    return smooth / smooth.std()


def transport():
    """Columns of A: light that falls off, with the soft shadow of a block."""
    columns = []
    for i in range(HIDDEN[0]):
        for j in range(HIDDEN[1]):
            u, v = U - 0.15 * (j - 3), V - 0.15 * (i - 2.5)
            shadow = np.prod([1 / (1 + np.exp(-12 * t)) for t in (u + 0.3, 0.3 - u, v + 0.4)], 0)
            columns.append((1 - shadow) / (1 + 0.3 * (U - 0.1 * j) ** 2 + 0.3 * (V - 0.1 * i) ** 2))
    return np.array(columns).reshape(42, -1).T


A = transport()
B = np.stack([np.ones(V.size), U.ravel(), V.ravel(), (U * V).ravel(), (U**2).ravel()], axis=1)


def image(seed):
    f = np.full((*HIDDEN, 3), 0.15)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        i, j = rng.integers(0, 4), rng.integers(0, 4)
        f[i : i + 3, j : j + 3] = rng.uniform(0.1, 1, 3)
    return f


def photograph(seed, wall=0.0, σ=1e-3):
    light = (A @ image(seed).reshape(-1, 3) + 20 * B[:, :1] * LIGHT).reshape(*SHAPE, 3)
    return light * (1 + wall) + σ * light.mean() * np.moveaxis(noise(100 + seed), 0, -1)


def test_independent_noise_is_never_taken_for_shared():
    # Of 200 draws in 42 degrees of freedom, channels of very different noise.
    sizes = np.array([1.0, 5.0, 0.2])[:, None]
    for seed in range(200):
        draw = sizes * np.random.default_rng(seed).standard_normal((3, 42))
        assert not is_shared(draw @ draw.T / 42)
    assert not is_shared(np.zeros((3, 3)))


def test_grey_photograph_is_reconstructed_as_one_channel(method):
    y = np.repeat(photograph(0, 0.004 * paint(1.5)[..., None])[..., :1], 3, axis=2)
    found = method.solve(y)
    assert found.evidence.axes is None
    np.testing.assert_allclose(found.image, found.image[..., :1] * np.ones(3), rtol=1e-4)


def test_covariance_is_that_of_what_the_least_squares_image_leaves():
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.standard_normal((300, 10)))[0]
    curvatures = rng.uniform(0.1, 2, 10)
    y = rng.standard_normal((3, 300))
    left = y - (y @ basis) @ basis.T
    found = noise_covariance(y, (y @ basis) * np.sqrt(curvatures), curvatures, rank=4)
    np.testing.assert_allclose(found, left @ left.T / (300 - 14), rtol=1e-12)


def test_axes_are_those_of_the_light_and_white_noise_is_not_slow():
    left = 0.1 * noise(0) + paint(0, 9) * LIGHT[:, None, None]
    flat = left.reshape(3, -1)
    found = common_noise(flat @ flat.T / flat.shape[1], left, noise(1))
    np.testing.assert_allclose(found.axes @ found.axes.T, np.eye(3), atol=1e-12)
    assert abs(found.axes[0] @ LIGHT) == pytest.approx(np.linalg.norm(LIGHT), rel=1e-3)
    assert found.σ[0] == pytest.approx(np.linalg.norm(LIGHT), rel=0.05)
    np.testing.assert_allclose(found.σ[1:], 0.1, rtol=0.05)
    assert (found.slow >= 1).all() and (found.slow < 1.4).all()


def test_slow_noise_is_told_by_its_spectrum():
    left = 0.1 * noise(0) + paint(2, 9) * LIGHT[:, None, None]
    flat = left.reshape(3, -1)
    found = common_noise(flat @ flat.T / flat.shape[1], left, noise(1))
    # Of a Gaussian of 2 pixels, the energy at frequency 0 is 4 π 2² times the mean; smoothed by
    # another of s pixels, s²/(s² + 2²) of that.
    expected = 4 * np.pi * 2**2 * 4**2 / (4**2 + 2**2)
    assert found.slow[0] == pytest.approx(expected, rel=0.4)
    assert (found.slow[1:] < 2).all()


@pytest.fixture(scope="module")
def method():
    return NoiseAware(A, B, hidden_shape=HIDDEN, photograph_shape=SHAPE)


@pytest.mark.parametrize("σ", [1e-3, 1e-2])
def test_nothing_changes_where_noise_is_independent(method, σ, monkeypatch):
    y = photograph(0, σ=σ)
    found = method.solve(y)
    assert found.evidence.axes is None
    monkeypatch.setattr(still, "is_shared", lambda _: False)
    np.testing.assert_array_equal(method.solve(y).image, found.image)


def test_image_before_uneven_paint_is_better_and_knows_its_errors(method, monkeypatch):
    errors, known = [], []
    for seed in range(6):
        y = photograph(seed, 0.004 * paint(1.5, seed)[..., None])
        found = method.solve(y)
        assert found.evidence.axes is not None
        z = (found.image - image(seed)) / method.standard_errors(found)
        known.append([np.mean(z**2), np.mean(np.abs(z) < 2)])
        with monkeypatch.context() as without:
            without.setattr(still, "is_shared", lambda _: False)
            before = method.solve(y)
        errors.append([mean_squared_error(each.image, image(seed)) for each in (before, found)])
    before, after = np.mean(errors, axis=0)
    assert after < 0.6 * before
    squares, within_two = np.mean(known, axis=0)
    assert squares < 2.5 and within_two > 0.8


def test_photograph_is_explained_alike_in_either_axes(method):
    y = photograph(1, 0.004 * paint(1.5)[..., None])
    found = method.solve(y)
    residual = method.residual(y, found)
    assert found.evidence.axes is not None
    assert method.doubt(found) == ""
    # Noise is told of the channels, in each as the paint there has it.
    left = np.sqrt(np.mean(residual.light**2, axis=(0, 1)))
    np.testing.assert_allclose(found.noise, left, rtol=0.15)


def test_pixels_left_out_do_not_count():
    mask = V < 0.6
    masked = NoiseAware(A, B, hidden_shape=HIDDEN, photograph_shape=SHAPE, mask=mask)
    y = photograph(2, 0.004 * paint(1.5)[..., None])
    found = masked.solve(y)
    y[~mask] = np.nan
    assert found.evidence.axes is not None
    np.testing.assert_array_equal(masked.solve(y).image, found.image)
