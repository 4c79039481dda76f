"""What is split off, against minimization by brute force."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.noise_aware.penalized_likelihood import (
    RELAXATION,
    Splitting,
    advance,
)
from periscopy_sim.testing import prox_oracle

RNG = np.random.default_rng(0)
TARGETS = RNG.normal(0.1, 0.7, (3, 12, 10))
PREVIOUS = np.maximum(RNG.normal(0.2, 0.4, TARGETS.shape), 0)


def drawn(targets, previous, positive, pull):
    """The new v for targets of the over-relaxed image."""
    split = Splitting.zeros(targets.shape)
    f, previous = (array.astype(np.float32) for array in (targets / RELAXATION, previous))
    advance(f, split, 0.1, positive, previous, pull)
    np.testing.assert_allclose(split.v + split.q, targets, atol=1e-6)
    return split.v


@pytest.mark.parametrize("pull", [1e-3, 0.1, 0.5, 2.0])
@pytest.mark.parametrize("positive", [True, False])
def test_image_is_drawn_towards_the_frame_before_as_far_as_is_best(positive, pull):
    """The minimum of ½‖v − t‖² + κ‖v − p‖, patch by patch."""
    v = drawn(TARGETS, PREVIOUS, positive, pull).astype(np.float64)
    assert (v >= 0).all() or not positive
    for i, j in np.ndindex(TARGETS.shape[1:]):
        previous, best = PREVIOUS[:, i, j], v[:, i, j]

        def value(f, t, previous=previous):
            return 1e-3 + np.sum((f - t) ** 2) / 2 + pull * np.linalg.norm(f - previous)

        lower = 0 if positive else -np.inf
        prox_oracle(lambda _, best=best: best, value, TARGETS[:, i, j], lower=lower, rtol=1e-4)


def test_patches_near_the_frame_before_are_as_they_were_and_the_others_change_in_all_colours():
    v = drawn(PREVIOUS + 0.2 * TARGETS, PREVIOUS, False, 0.2)
    change = np.abs(v - PREVIOUS.astype(np.float32))
    is_near = np.linalg.norm(0.2 * TARGETS, axis=0) < 0.2
    assert 0.2 < is_near.mean() < 0.8
    assert (change[:, is_near] == 0).all() and (change[:, ~is_near] > 0).all()


def test_frame_before_that_is_far_away_pulls_by_its_weight_alone():
    direction = np.array([2.0, 1.0, 2.0])[:, None, None] / 3
    v = drawn(TARGETS, 1e12 * direction + 0 * TARGETS, False, 0.5)
    np.testing.assert_allclose(v, TARGETS + 0.5 * direction, atol=1e-6)


def test_an_image_that_becomes_black_ends_the_iterations():
    f, split = np.full((3, 2, 2), -1e-6, np.float32), Splitting.zeros((3, 2, 2))
    own = advance(f, split, 1.0, True)
    over_an_image = advance(f, Splitting.zeros((3, 2, 2)), 1.0, True, black=1.0)
    assert own > 0.5 and over_an_image < 1e-5
