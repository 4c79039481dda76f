"""The array API implementation against the compiled one, in several libraries' arrays."""

import importlib

import numpy as np
import pytest

from periscopy_sim.reconstruction.preconditioned import portable_denoising as portable
from periscopy_sim.reconstruction.preconditioned.repair import repair
from periscopy_sim.reconstruction.total_variation.prox import (
    prox_total_variation,
    prox_total_variation_l1,
)


@pytest.fixture(
    params=["numpy", "array_api_strict", pytest.param("torch", marks=pytest.mark.torch)]
)
def xp(request):
    return pytest.importorskip(request.param)


def draw(*shape, seed=0):
    return np.random.default_rng(seed).random(shape)


def planes(images):
    """Channels before rows, as the portable code has them."""
    return np.moveaxis(images, -1, -3)


def test_modules_import_no_other_array_library():
    module = importlib.import_module(
        "periscopy_sim.reconstruction.preconditioned.portable_denoising"
    )
    assert not {"torch", "cupy", "numba"} & set(vars(module))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_total_variation_of_a_batch_is_the_compiled_ones(xp, dtype):
    images, weight = draw(4, 9, 7, 3), draw(4, 3, seed=1)
    expected = prox_total_variation(images, weight, tolerance=1e-9)
    g, λ = (xp.asarray(part.astype(dtype)) for part in (planes(images), weight))
    found = portable.prox_total_variation(g, λ, tolerance=1e-9 if dtype == "float64" else 1e-6)
    assert type(found) is type(g) and found.dtype == g.dtype
    atol = 2e-5 if dtype == "float64" else 1e-3
    np.testing.assert_allclose(np.asarray(found), planes(expected), atol=atol)


@pytest.mark.parametrize("temporal_weight", [1.0, 0.3])
def test_total_variation_in_time_is_the_compiled_ones(xp, temporal_weight):
    video, weight = draw(4, 9, 7, 3), draw(3, seed=1)
    expected = prox_total_variation(video, weight, temporal_weight=temporal_weight, tolerance=1e-9)
    found = portable.prox_total_variation(
        xp.asarray(np.ascontiguousarray(np.moveaxis(video, -1, 0))),
        xp.asarray(weight),
        temporal_weight=temporal_weight,
        tolerance=1e-9,
    )
    np.testing.assert_allclose(np.asarray(found), np.moveaxis(expected, -1, 0), atol=2e-5)


@pytest.mark.parametrize("l1_weight", [0.0, 0.1, 10.0])
def test_pull_towards_the_previous_frame_is_the_compiled_ones(xp, l1_weight):
    image, previous, weight = draw(9, 7, 3), draw(9, 7, 3, seed=2), draw(3, seed=1)
    expected = prox_total_variation_l1(image, previous, weight, l1_weight, tolerance=1e-9)
    found = portable.prox_total_variation(
        xp.asarray(np.ascontiguousarray(planes(image))),
        xp.asarray(weight),
        previous=xp.asarray(np.ascontiguousarray(planes(previous))),
        l1_weight=xp.asarray(np.full(3, l1_weight)),
        tolerance=1e-9,
    )
    np.testing.assert_allclose(np.asarray(found), planes(expected), atol=2e-5)


def test_no_weight_gives_the_image_and_a_large_one_its_mean(xp):
    images = draw(3, 2, 5, 6)
    weight = np.array([[0.0, 0.0], [1e6, 1e6], [0.1, 0.1]])
    found = np.asarray(portable.prox_total_variation(xp.asarray(images), xp.asarray(weight)))
    np.testing.assert_allclose(found[0], images[0], rtol=1e-12)
    mean = images[1].mean(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(found[1], np.broadcast_to(mean, images[1].shape), rtol=1e-12)
    assert np.ptp(found[2]) < np.ptp(images[2])


def test_uniform_images_stay(xp):
    images = np.full((2, 3, 4, 5), 0.25)
    found = portable.prox_total_variation(xp.asarray(images), xp.asarray(np.ones((2, 3))))
    np.testing.assert_array_equal(np.asarray(found), images)


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (2, 2), (6, 7)])
@pytest.mark.parametrize("in_video", [False, True])
def test_repair_is_the_compiled_one_at_borders_and_within(xp, size, in_video):
    images, before = draw(3, *size, 3), draw(3, *size, 3, seed=5)
    threshold = np.array([0.0, 0.15, 0.4])
    previous = before if in_video else None
    expected = [
        repair(image, κ, None if previous is None else previous[k])
        for k, (image, κ) in enumerate(zip(images, threshold, strict=True))
    ]
    found = portable.repair(
        xp.asarray(images), xp.asarray(threshold), xp.asarray(before) if in_video else None
    )
    np.testing.assert_allclose(np.asarray(found), np.stack(expected), rtol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 7, 1044])
def test_percentile_is_numpys(xp, count):
    values = draw(4, count)
    found = np.asarray(portable.percentile(xp.asarray(values), 99))
    np.testing.assert_allclose(found, np.percentile(values, 99, axis=1), rtol=1e-12)
