"""Paint that background photographs show multiplies the hidden image's light, too; edges do not."""

from functools import partial

import numpy as np
import pytest

from periscopy_sim.reconstruction import unevenness
from periscopy_sim.reconstruction.large_scale.iterative import IterativePeriscope
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
from periscopy_sim.reconstruction.noise_aware.video import NoiseAwareVideo
from periscopy_sim.reconstruction.preconditioned.still import Periscope
from periscopy_sim.reconstruction.preconditioned.video import Video

PHOTOGRAPH, HIDDEN = (30, 36), (3, 4)
M, N = 1080, 12
RNG = np.random.default_rng(80)
A = RNG.uniform(0.1, 1, (M, N))
DOWN, ACROSS = (axis.ravel() for axis in np.mgrid[-1:1:30j, -1:1:36j])
B = np.stack([np.ones(M), 1 + 0.5 * DOWN, 1 + 0.5 * ACROSS, 2 - DOWN**2 + ACROSS], axis=1)
TRUTH = RNG.uniform(0.2, 1, (N, 3))
LAMP, OTHER = B @ RNG.uniform(0.5, 1, (4, 3)), B @ RNG.uniform(0.5, 1, (4, 3))
PAINT = 0.02 * RNG.normal(size=(M, 1)) * [1.0, 0.8, 1.2]
NOISE = 0.004
SCENE = {"hidden_shape": HIDDEN, "photograph_shape": PHOTOGRAPH}
METHODS = {
    "noise-aware": partial(NoiseAware, **SCENE, wall_gain=False),
    "periscope": partial(Periscope, **SCENE, repair_threshold=np.inf),
    "factored": partial(Periscope, **SCENE, repair_threshold=np.inf, explicit=False),
    "iterative": partial(IterativePeriscope, **SCENE),
}


def photograph(light, paint=PAINT, noise=NOISE, seed=0):
    return (1 + paint) * light + noise * np.random.default_rng(seed).normal(size=(M, 3))


Y = photograph(A @ TRUTH + LAMP)
OFF = photograph(2 * LAMP, seed=1)


def without(monkeypatch):
    """Leave the photographs to the columns of B alone."""
    monkeypatch.setattr(unevenness, "WORTH", np.inf)


@pytest.mark.parametrize("method", METHODS)
def test_wall_is_made_even_and_the_image_is_better_for_it(method, monkeypatch):
    fitted = METHODS[method](A, B, backgrounds=[OFF])
    left = fitted.evenness(Y).T * (1 + PAINT) - 1
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(PAINT**2))
    found = fitted.solve(Y)
    without(monkeypatch)
    np.testing.assert_array_equal(fitted.evenness(Y), 1)
    columns = fitted.solve(Y)
    truth = TRUTH.reshape(*HIDDEN, 3)
    assert np.sum((found.image - truth) ** 2) < 0.5 * np.sum((columns.image - truth) ** 2)
    assert (found.noise < 0.7 * columns.noise).all()


@pytest.mark.parametrize("method", METHODS)
def test_shares_are_those_of_joint_least_squares(method):
    off = [OFF, photograph(OTHER, seed=2)]
    evenness = METHODS[method](A, B, backgrounds=off).evenness(Y)
    smooth = B @ np.linalg.lstsq(B, np.hstack(off))[0]
    d = 1 - smooth / np.hstack(off)
    for channel in range(3):
        y = Y[:, channel]
        explaining = np.hstack([d * y[:, None], A, B, *off])
        shares = np.linalg.lstsq(explaining / np.linalg.norm(explaining, axis=0), y)[0][:6]
        shares /= np.linalg.norm(d * y[:, None], axis=0)
        np.testing.assert_allclose(evenness[channel], 1 - d @ shares, atol=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_edges_in_the_light_are_not_taken_for_paint(method):
    bars = 0.05 * (np.sin(9 * ACROSS + 4 * DOWN) > 0)[:, None]
    fitted = METHODS[method](A, B, backgrounds=[photograph((1 + bars) * LAMP, 0, seed=1)])
    evenness = fitted.evenness(photograph(A @ TRUTH + (1 + bars) * LAMP, 0))
    assert np.abs(evenness - 1).max() < 0.1 * bars.max()


def test_paint_is_told_from_edges_by_photographs_under_several_lights():
    bars = 0.2 * (np.sin(9 * ACROSS + 4 * DOWN) > 0)[:, None]
    y = photograph(A @ TRUTH + (1 + bars) * LAMP)
    one = photograph((1 + bars) * LAMP, seed=1)
    both = [one, photograph(OTHER, seed=2)]
    left = [
        np.std(METHODS["noise-aware"](A, B, backgrounds=given).evenness(y).T * (1 + PAINT))
        for given in ([one], both)
    ]
    assert left[1] < 0.3 * np.std(PAINT) and left[1] < 0.5 * left[0]


def test_noise_is_shrunk_by_the_ratio_of_variances(monkeypatch):
    # Three channels of independent noise ν show one grey u: the best mixture of the three is their
    # mean, times u² / (u² + ν²/3), of energy u² times the same number.
    monkeypatch.setattr(unevenness, "WORTH", 0.0)
    ν, shrinkages = 0.015, []
    grey = np.repeat(PAINT[:, :1], 3, axis=1)
    expected = np.var(grey) / (np.var(grey) + ν**2 / 3)
    for seed in range(20):
        off = photograph(LAMP, grey, ν * LAMP, seed=100 + seed)
        y = photograph(A @ TRUTH + LAMP, grey, seed=200 + seed)
        evenness = METHODS["noise-aware"](A, B, backgrounds=[off]).evenness(y)
        shrinkages.append(np.sum((evenness - 1) ** 2) / np.sum(grey**2))
    error = np.std(shrinkages) / np.sqrt(20)
    assert expected < 0.85
    # Four standard errors, and what B takes of the fields.
    assert abs(np.mean(shrinkages) - expected) < 4 * error + 0.02


def test_even_wall_is_left_alone(monkeypatch):
    monkeypatch.setattr(unevenness, "WORTH", 0.0)
    found = 0
    for seed in range(300):
        y = photograph(A @ TRUTH + LAMP, 0, seed=2 * seed)
        off = photograph(LAMP, 0, 0.02, seed=2 * seed + 1)
        fitted = METHODS["noise-aware"](A, B, backgrounds=[off])
        found += bool((fitted.evenness(y) != 1).any())
    # At an error rate of 0.1 % more than 3 of 300 are found once in 3000 tries.
    assert found <= 3


def test_background_photograph_of_noise_costs_next_to_nothing():
    errors = np.zeros(2)
    for seed in range(20):
        y = photograph(A @ TRUTH + LAMP, 0, seed=seed)
        off = np.random.default_rng(1000 + seed).uniform(size=(M, 3))
        for k, given in enumerate(([], [off])):
            image = METHODS["noise-aware"](A, B, backgrounds=given).reconstruct(y)
            errors[k] += np.sum((image.reshape(N, 3) - TRUTH) ** 2)
    assert errors[1] < 1.02 * errors[0]  # 0.1 dB


def test_mask_leaves_out_paint_and_whatever_lies_there():
    mask = RNG.random(PHOTOGRAPH) > 0.2
    used = mask.ravel()
    y, off = (np.where(used[:, None], each, np.nan) for each in (Y, OFF))
    masked = METHODS["noise-aware"](A, B, backgrounds=[off], mask=mask)
    by_hand = NoiseAware(A[used], B[used], hidden_shape=HIDDEN, backgrounds=[OFF[used]])
    assert masked.evenness(y).shape == (3, used.sum())
    np.testing.assert_allclose(masked.evenness(y), by_hand.evenness(Y[used]), atol=1e-5)
    assert (masked.evenness(y) != 1).any()


@pytest.mark.parametrize(
    "video",
    [
        lambda **more: NoiseAwareVideo(METHODS["noise-aware"](A, B, **more), coupling="none"),
        lambda **more: Video(METHODS["periscope"](A, B, **more), coupling="none"),
    ],
)
def test_video_keeps_the_wall_of_its_first_frame(video):
    clip = np.stack([photograph(x * (A @ TRUTH) + LAMP, seed=k) for k, x in enumerate((1, 0.5, 2))])
    moving = video(backgrounds=[OFF])
    frames = moving.frames(clip)
    evenness = moving.still.evenness(clip[0])
    even = video(backgrounds=[OFF])
    even._evenness = evenness
    np.testing.assert_allclose(even.frames(clip), frames, rtol=1e-4, atol=1e-5)
    moving.restart()
    singly = np.stack([moving.next_frame(y) for y in clip])
    np.testing.assert_allclose(singly, frames, rtol=1e-3, atol=1e-4)
    assert (moving.evenness(clip[1:]) == evenness).all()
    moving.restart()
    assert (moving.evenness(clip[1:]) != evenness).any()


def test_dark_pixels_and_bright_stains_are_no_paint():
    off = OFF.copy()
    off[:20] *= 1e-6
    off[50:60] *= 3
    evenness = METHODS["noise-aware"](A, B, backgrounds=[off]).evenness(Y)
    np.testing.assert_array_equal(evenness[:, :20], 1)
    np.testing.assert_array_equal(evenness[:, 50:60], 1)
    assert np.isfinite(evenness).all()


def test_without_backgrounds_or_b_nothing_is_found():
    np.testing.assert_array_equal(METHODS["noise-aware"](A, B).evenness(Y), 1)
    np.testing.assert_array_equal(METHODS["noise-aware"](A, backgrounds=[OFF]).evenness(Y), 1)
