"""A background photograph in which the monitor was left on is refused, and no other is."""

from functools import partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import periscopy_sim as ps
from periscopy_sim.reconstruction.large_scale.transport_operator import UsedRows
from periscopy_sim.reconstruction.monitor_left_on import (
    check_monitor_off,
    coarse_transport,
    monitor_doubt,
)
from periscopy_sim.reconstruction.observation import observation_of

SIZE, HIDDEN = (30, 30), (8, 10)


@pytest.fixture(scope="module")
def chair():
    """A, an orthonormal basis of B, and overcast light of A's mean, of a small chair scene."""
    scene = ps.load_scenario("chair", HIDDEN, photograph=SIZE)
    A = ps.analytic_transport(scene).astype(np.float64)
    B = ps.point_light_backgrounds(scene)
    return A, np.linalg.svd(B, full_matrices=False)[0][:, :30], B[:, ::60].sum(axis=1)


def grains(rms, size, seed):
    u = gaussian_filter(np.random.default_rng(seed).normal(size=SIZE), size).reshape(-1, 1)
    return 1 + rms * u / u.std()


def refusal(chair, light, mask=None, **paint):
    A, smooth, _ = chair
    noise = 0.001 * light.mean() * np.random.default_rng(9).normal(size=(900, 3))
    seen = (grains(**paint) if paint else 1) * light[:, None] + noise
    observation = observation_of(A, HIDDEN, None, mask, SIZE, {"off.exr": seen})
    used = slice(None) if mask is None else mask.ravel()
    smooth = np.linalg.qr(smooth[used])[0]
    check_monitor_off(A, smooth, observation)


MASK = np.ones(SIZE, bool)
MASK[:6, :9] = False


@pytest.mark.parametrize("mask", [None, MASK])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("share", [1.0, 0.3])
def test_monitor_is_seen_beside_paint(chair, share, seed, mask):
    A, _, lamp = chair
    image = np.zeros(HIDDEN)
    image[seed : seed + 4, 2 + seed : 7] = 1
    monitor = A @ image.ravel()
    light = lamp / lamp.mean() + share * monitor / monitor.mean()
    with pytest.raises(
        ValueError, match=r"^off\.exr: still shows the monitor.*switch the monitor off"
    ):
        refusal(chair, light, mask, rms=0.004, size=1, seed=seed)


@pytest.mark.parametrize("mask", [None, MASK])
@pytest.mark.parametrize("size", [0, 1, 3, 6])
def test_paint_of_any_grain_is_not_taken_for_the_monitor(chair, size, mask):
    for seed in range(5):
        refusal(chair, chair[2] / chair[2].mean(), mask, rms=0.01, size=size, seed=seed)


@pytest.mark.parametrize("turned", [np.s_[::-1], np.s_[:, ::-1], np.s_[::-1, ::-1]])
def test_shadows_that_other_lamps_cast_are_not_taken_for_the_monitor(chair, turned):
    A, _, lamp = chair
    shadows = A.sum(axis=1).reshape(SIZE)[turned].ravel()
    for share in (1.0, 0.1):
        refusal(chair, lamp / lamp.mean() + share * shadows / shadows.mean())


@pytest.mark.parametrize("mask", [None, MASK])
def test_coarse_transport_is_that_of_images_of_few_patches(mask):
    rng = np.random.default_rng(0)
    A = rng.random((900, 24 * 30))
    coarse = rng.random((8, 10))
    image = np.kron(coarse, np.ones((3, 3)))
    used = slice(None) if mask is None else mask.ravel()
    observation = observation_of(A, (24, 30), None, mask, SIZE)
    expected = A[used] @ image.ravel()
    for matrix in (A, UsedRows(A, np.ones(900, bool))):
        light = coarse_transport(matrix, observation) @ coarse.ravel()
        np.testing.assert_allclose(light, expected)


@pytest.mark.parametrize(
    "method",
    [
        ps.NoiseAware,
        ps.IterativePeriscope,
        partial(ps.Periscope, explicit=False),
        ps.Differencing,
        ps.TruncatedSVD,
    ],
)
def test_methods_refuse_it(chair, method):
    A, _, lamp = chair
    off = (A @ np.eye(80)[25] / A[:, 25].mean() + lamp / lamp.mean())[:, None] * np.ones(3)
    settings = {"hidden_shape": HIDDEN, "photograph_shape": SIZE}
    with pytest.raises(ValueError, match="photograph 1 of 1: still shows the monitor"):
        method(A, lamp[:, None] * np.ones((1, 2)), backgrounds=[off], **settings)


@pytest.mark.parametrize("mask", [None, MASK])
@pytest.mark.parametrize("seed", range(3))
def test_photograph_whose_monitor_is_off_is_doubted_and_no_other(chair, mask, seed):
    A, smooth, lamp = chair
    used = slice(None) if mask is None else mask.ravel()
    smooth = np.linalg.qr(smooth[used])[0]
    observation = observation_of(A, HIDDEN, None, mask, SIZE)
    image = np.zeros(HIDDEN)
    image[seed : seed + 4, 2 + seed : 7] = 1
    monitor = A @ image.ravel()
    noise = 0.001 * np.random.default_rng(seed).normal(size=(900, 3))
    wall = grains(rms=0.004, size=1, seed=seed)
    for share in (0.0, 0.3, 1.0):
        light = lamp / lamp.mean() + share * monitor / monitor.mean()
        seen = (wall * light[:, None]) + noise
        doubt = monitor_doubt(A, smooth, observation, seen.reshape(*SIZE, 3))
        assert ("hardly shows a hidden image: " in doubt) == (share == 0)


def test_nothing_is_doubted_where_photographs_cannot_be_turned(chair):
    A, smooth, lamp = chair
    observation = observation_of(A, HIDDEN)
    seen = (lamp[:, None] + 0.01 * np.random.default_rng(0).normal(size=(900, 3))).reshape(900, 3)
    assert monitor_doubt(A, smooth, observation, seen) == ""
