"""Noise that the channels share: found, and taken in its own axes."""

import itertools

import numpy as np
import pytest
from periscopy_sim.reconstruction.noise_aware.nuisance.common_noise import (
    ALL_SHARED,
    SHARED,
    common_noise,
    noise_covariance,
    shared_part,
)
from periscopy_sim.reconstruction.noise_aware.nuisance.noise_spectrum import NoiseSpectrum
from scipy import ndimage

from periscopy_sim.evaluation.metrics import mean_squared_error
from periscopy_sim.reconstruction.noise_aware import still
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

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
    # Of 200 draws in 100 degrees of freedom, channels of very different noise.
    sizes = np.array([1.0, 5.0, 0.2])[:, None]
    for seed in range(200):
        draw = sizes * np.random.default_rng(seed).standard_normal((3, 100))
        assert shared_part(draw @ draw.T / 100) == 0
    assert shared_part(np.zeros((3, 3))) == 0


@pytest.mark.parametrize(("along", "part"), [(SHARED, 0.0), (0.55, 0.5), (ALL_SHARED, 1), (1, 1)])
def test_noise_is_shared_to_the_part_that_is_along_one_axis(along, part):
    # Of equal correlations r the largest eigenvalue is 1 + 2 r.
    correlations = np.eye(3) + (3 * along - 1) / 2 * (1 - np.eye(3))
    sizes = np.array([0.01, 0.02, 0.03])
    assert shared_part(correlations * np.outer(sizes, sizes)) == pytest.approx(part, abs=1e-9)


def test_covariance_is_that_of_what_the_least_squares_image_leaves():
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.standard_normal((300, 10)))[0]
    curvatures = rng.uniform(0.1, 2, 10)
    y = rng.standard_normal((3, 300))
    left = y - (y @ basis) @ basis.T
    found = noise_covariance(y, (y @ basis) * np.sqrt(curvatures), curvatures, rank=4)
    np.testing.assert_allclose(found, left @ left.T / (300 - 14), rtol=1e-12)


def whole(planes):
    return planes.reshape(len(planes), -1)


@pytest.fixture(scope="module")
def bare():
    """The spectrum where nothing is fitted, and the patterns are a few random directions."""
    rng = np.random.default_rng(3)
    patterns = ndimage.gaussian_filter(rng.standard_normal((60, *SHAPE)), (0, 2, 2)).reshape(60, -1)
    patterns /= np.linalg.norm(patterns, axis=1, keepdims=True)
    spectrum = NoiseSpectrum(SHAPE, None, lambda rows: rows, lambda rows: rows @ patterns.T)
    return patterns, spectrum


def test_axes_are_those_of_the_light(bare):
    left = 0.1 * noise(0) + paint(0, 9) * LIGHT[:, None, None]
    flat = whole(left)
    found = common_noise(flat @ flat.T / flat.shape[1], 1.0, flat, bare[1])
    np.testing.assert_allclose(found.axes @ found.axes.T, np.eye(3), atol=1e-12)
    assert abs(found.axes[0] @ LIGHT) == pytest.approx(np.linalg.norm(LIGHT), rel=1e-3)
    # White in all patterns: smoothed over 15 of 9 draws, in hardly independent directions.
    np.testing.assert_allclose(np.sqrt(found.variances[0]), np.linalg.norm(LIGHT), rtol=0.25)
    np.testing.assert_allclose(np.sqrt(found.variances[1:]), 0.1, rtol=0.25)


def test_nothing_shared_is_noise_of_the_channels_themselves(bare):
    sizes = np.array([3.0, 2.0, 1.0])
    covariance = np.diag(sizes) @ (0.5 * np.eye(3) + 0.5) @ np.diag(sizes)
    found = common_noise(covariance, 1e-9, whole(noise(0)), bare[1])
    np.testing.assert_allclose(np.abs(found.axes), np.eye(3), atol=1e-6)
    np.testing.assert_allclose(found.variances, (sizes**2)[:, None] * np.ones(60), rtol=1e-6)
    np.testing.assert_allclose(found.weights(2.0)[:, 0], (2 / sizes) ** 2, rtol=1e-6)


@pytest.mark.parametrize("scale", [1, 3])
def test_variances_are_those_of_the_patterns_before_slow_noise(bare, scale):
    patterns, spectrum = bare
    field = paint(scale, 1)
    found = spectrum.variances(whole(np.stack([field, 2 * field, noise(2)[0]])))
    drawn = np.stack([paint(scale, seed).ravel() for seed in range(20, 220)])
    expected = np.mean((drawn @ patterns.T) ** 2)
    # The field has few independent blotches: of (40 · 44)/(4π scale²), 140 or 16.
    assert found[0].mean() == pytest.approx(expected, rel=0.2 * scale)
    np.testing.assert_allclose(found[1], 4 * found[0], rtol=1e-9)
    assert found[2].mean() == pytest.approx(1, rel=0.25)


@pytest.fixture(scope="module")
def method():
    return NoiseAware(A, B, hidden_shape=HIDDEN, photograph_shape=SHAPE)


@pytest.mark.parametrize("σ", [1e-3, 1e-2])
def test_nothing_changes_where_noise_is_independent(method, σ, monkeypatch):
    y = photograph(0, σ=σ)
    found = method.solve(y)
    assert found.evidence.common is None
    monkeypatch.setattr(still, "shared_part", lambda _: 0.0)
    np.testing.assert_array_equal(method.solve(y).image, found.image)


def test_image_before_uneven_paint_is_better_and_knows_its_errors(method, monkeypatch):
    errors, known = [], []
    for seed in range(6):
        y = photograph(seed, 0.004 * paint(1.5, seed)[..., None])
        found = method.solve(y)
        assert found.evidence.common is not None
        z = (found.image - image(seed)) / method.standard_errors(found)
        known.append([np.mean(z**2), np.mean(np.abs(z) < 2)])
        with monkeypatch.context() as without:
            without.setattr(still, "shared_part", lambda _: 0.0)
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
    assert found.evidence.common is not None
    assert method.doubt(found) == ""
    # Noise is told of the channels, in each as the paint there has it, but for what is so smooth
    # that it is taken for ambient light, on a wall of so few pixels.
    left = np.sqrt(np.mean(residual.light**2, axis=(0, 1)))
    np.testing.assert_allclose(found.noise, left, rtol=0.2)


def test_pixels_left_out_do_not_count():
    mask = V < 0.6
    masked = NoiseAware(A, B, hidden_shape=HIDDEN, photograph_shape=SHAPE, mask=mask)
    y = photograph(2, 0.004 * paint(1.5)[..., None])
    found = masked.solve(y)
    y[~mask] = np.nan
    assert found.evidence.common is not None
    np.testing.assert_array_equal(masked.solve(y).image, found.image)


def grey(seed):
    """An image of one hue of fine structure, which the wall's light has, too."""
    checks = (np.indices(HIDDEN).sum(axis=0) + seed) % 2 * 0.6 + 0.2
    return checks[..., None] * LIGHT / LIGHT.max()


@pytest.mark.parametrize("scale", [0.0, 1.5])
def test_grey_image_before_uneven_paint_is_no_worse(method, scale, monkeypatch):
    errors = []
    for seed in range(6):
        light = (A @ grey(seed).reshape(-1, 3) + 20 * B[:, :1] * LIGHT).reshape(*SHAPE, 3)
        y = light * (1 + 0.002 * paint(scale, seed)[..., None])
        y += 1e-3 * light.mean() * np.moveaxis(noise(seed), 0, -1)
        found = method.solve(y)
        assert found.evidence.common is not None
        with monkeypatch.context() as without:
            without.setattr(still, "shared_part", lambda _: 0.0)
            before = method.solve(y)
        errors.append([mean_squared_error(each.image, grey(seed)) for each in (before, found)])
    before, after = np.mean(errors, axis=0)
    assert after < 10**0.03 * before  # 0.3 dB


def test_picture_changes_gradually_as_the_channels_begin_to_share_noise(method, monkeypatch):
    y = photograph(1, 0.004 * paint(1.5)[..., None])
    images = []
    for part in (0.0, 1e-6, 1e-3, 1.0):
        monkeypatch.setattr(still, "shared_part", lambda _, part=part: part)
        images.append(method.reconstruct(y))
    size = np.linalg.norm(images[0])
    steps = [np.linalg.norm(b - a) / size for a, b in itertools.pairwise(images)]
    assert steps[0] < 1e-3 and steps[1] < 5e-3 and steps[2] > 0.05


def test_channels_that_are_copies_are_no_other_case(method):
    """From noise that is nearly the same in the channels to a photograph of one channel."""
    y = photograph(0, 0.004 * paint(1.5)[..., None])
    one = np.repeat(y[..., :1], 3, axis=2)
    other = 0.004 * y.mean() * (y - one) / np.std(y - one)
    images = [method.reconstruct(one + part * other) for part in (0.0, 1e-3, 3e-3, 1e-2)]
    np.testing.assert_allclose(images[0], images[0][..., :1] * np.ones(3), rtol=1e-3)
    steps = [np.linalg.norm(each - images[0]) / np.linalg.norm(images[0]) for each in images[1:]]
    assert steps[0] < 0.02 and steps[1] < 0.04 and steps[2] < 0.1


def test_weight_asked_for_goes_with_the_weight_found(method):
    y = photograph(1, 0.004 * paint(1.5)[..., None])
    twice = NoiseAware(A, B, hidden_shape=HIDDEN, photograph_shape=SHAPE, regularization=0.04)
    assert twice.solve(y).weight == pytest.approx(2 * method.solve(y).weight, rel=1e-9)
