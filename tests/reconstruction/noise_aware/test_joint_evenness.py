"""Paint that stays while the hidden images change is found from them alone."""

import numpy as np
import pytest
from periscopy_sim.reconstruction.noise_aware.joint_evenness import joint_evenness

from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

WALL, HIDDEN = (24, 20), (4, 5)
RNG = np.random.default_rng(5)
A = RNG.random((480, 20))
DOWN, ACROSS = (axis.ravel() for axis in np.mgrid[-1:1:24j, -1:1:20j])
B = np.stack([np.ones(480), 1 + 0.5 * DOWN, 1 + 0.5 * ACROSS], axis=1)
PAINT = 1 + 0.02 * RNG.normal(size=(480, 1))
IMAGES = RNG.uniform(0.2, 1, (6, 20, 3))
MASK = np.ones(WALL, bool)
MASK[:4, :5] = False


def photographs(paint=PAINT, noise=0.01):
    light = A @ IMAGES + (4 * B @ np.ones((3, 3)))
    return (paint * light + noise * RNG.normal(size=light.shape)).reshape(6, *WALL, 3)


def method(**settings):
    return NoiseAware(
        A,
        B,
        hidden_shape=HIDDEN,
        photograph_shape=WALL,
        wall_gain=False,
        regularization=1e-4,
        **settings,
    )


@pytest.mark.parametrize("mask", [None, MASK])
def test_wall_is_made_even_and_less_is_left_unexplained(mask):
    y = photographs()
    if mask is not None:
        y[:, ~mask] = np.nan
    fitted = method(mask=mask)
    even = joint_evenness(fitted, y)
    assert even.shape == WALL
    used = np.ones(480, bool) if mask is None else mask.ravel()
    assert (even.ravel()[~used] == 1).all()
    left = even.ravel()[used] * PAINT[used, 0]
    assert np.std(left) < 0.4 * np.std(PAINT)
    without = fitted.solve(y[0]).noise
    assert (fitted.solve(y[0] * even[..., None]).noise < 0.6 * without).all()


def test_even_wall_stays_even():
    even = joint_evenness(method(), photographs(1, 0.02))
    assert np.std(even) < 0.15 * np.std(PAINT)


@pytest.mark.parametrize(
    ("shape", "iterations"), [((0, *WALL, 3), 2), (WALL, 2), ((1, *WALL, 3), 0)]
)
def test_without_photographs_or_turns_it_is_refused(shape, iterations):
    with pytest.raises(ValueError, match="give \\(K, rows, columns, 3\\) photographs"):
        joint_evenness(method(), np.ones(shape), iterations=iterations)
