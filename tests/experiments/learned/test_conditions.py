"""Conditions: photographs of the kind that each says, and what is told of them."""

import numpy as np
import pytest

import periscopy_sim as ps

pytest.importorskip("skimage")

from experiments.learned import conditions
from experiments.learned.conditions import CONDITIONS, Condition, chair_values, hidden_images


@pytest.mark.parametrize("kind", [conditions.CROPS, conditions.DRAWINGS, conditions.PATTERNS])
def test_hidden_images_are_linear_and_of_the_size_that_networks_take(kind):
    images = dict(hidden_images(kind, np.random.default_rng(0)))
    assert len(images) == 3
    for image in images.values():
        assert image.shape == (29, 36, 3) and image.min() >= 0 and 0.2 < image.max() <= 1


def test_checks_alternate_every_two_patches():
    checks = dict(hidden_images(conditions.PATTERNS, np.random.default_rng(0)))
    image = checks["checks of two patches"][..., 0] > 0
    assert not image[0, 0] and not image[1, 1] and image[0, 2] and image[2, 0]
    assert not image[2, 2] and image[27, 0] == image[26, 0]


def test_chairs_are_drawn_within_the_training_s_ranges():
    draws = [chair_values(np.random.default_rng(seed)) for seed in range(50)]
    dx = [draw["occluder_dx"] for draw in draws]
    assert -0.06 <= min(dx) < -0.04 and 0.04 < max(dx) <= 0.06


@pytest.mark.thorough
def test_photographs_have_the_ratio_and_the_noise_that_a_condition_says(monkeypatch):
    monkeypatch.setattr(
        conditions, "chair_values", lambda _: {"resolution": 40, "occluder_dx": 0.01}
    )
    quiet = conditions.trial(Condition("quiet", sbr=10, snr=200), 0, None)
    noisy = conditions.trial(Condition("noisy", sbr=10, snr=40), 0, None)
    A = ps.render_transport(quiet.scenario, pixel_samples=4, seed=1)
    for name, truth in quiet.truths.items():
        clean = quiet.photographs[name]
        signal = (A @ truth.reshape(-1, 3)).reshape(clean.shape)
        assert clean.mean() == pytest.approx(1)
        ratio = signal.mean() / (clean / (clean.mean() / signal.mean() / 1.1) - signal).mean()
        assert ratio == pytest.approx(10, rel=1e-3)
        noise = noisy.photographs[name] - clean
        assert noise.std() == pytest.approx(0.01 * np.sqrt((clean**2).mean()), rel=0.05)


def test_only_conditions_of_a_ruler_are_told_another_scene():
    assert {condition.name for condition in CONDITIONS if condition.ruler} == {
        "half the ruler's errors",
        "the ruler's errors",
    }
    assert len({condition.name for condition in CONDITIONS}) == len(CONDITIONS)
