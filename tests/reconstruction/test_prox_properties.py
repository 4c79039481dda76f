"""What holds of every denoised image and video: with an ℓ1 term, and with time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from periscopy_sim.testing import prox_oracle

few = settings(deadline=None, max_examples=40)
weights = st.just(0.0) | st.floats(1e-6, 300)
ties = st.just(0.0) | st.floats(1e-6, 3)
seeds = st.integers(0, 1000)
values = st.integers(-50, 50).map(lambda n: n / 10)
images = arrays(np.float64, st.tuples(*[st.integers(1, 5)] * 2), elements=values)
videos = arrays(np.float64, st.tuples(*[st.integers(1, 4)] * 3), elements=values)


@pytest.fixture(scope="session")
def checked(objective, random_image, solved):
    """Minimizer; no other image is better, by more than it may be from the exact one."""

    def least(g, weight, w=0.0, p=None, l1_weight=0.0):
        time = w if g.ndim == 3 else None
        found = solved(g, weight, time, p, l1_weight=l1_weight, max_iterations=3000)
        f, problem = found.image, (g, weight, w, 0 if p is None else p, l1_weight)
        reached = objective(f, *problem)
        others = [g, 0 * g, 0 * g + g.mean(), 2 * f - g, 0.9 * f, 1.1 * f]
        others += [f + size * random_image(*g.shape) for size in (0.1, 1e-3)]
        others += [] if p is None else [p, (g + p) / 2]
        best = min(objective(u, *problem) for u in others)
        assert reached <= (1 + 1e-9) * best + found.gap * reached + 1e-18
        return f, np.sqrt(found.gap * reached) + 1e-9

    return least


@few
@given(g=images, weight=weights, l1_weight=weights, seed=seeds)
def test_l1_prox_is_non_expansive_between_both_images(
    g, weight, l1_weight, seed, checked, random_image
):
    p, h = random_image(*g.shape, seed=seed), g + random_image(*g.shape, seed=seed + 1)
    (f, error), (u, other) = (checked(x, weight, p=p, l1_weight=l1_weight) for x in (g, h))
    assert np.linalg.norm(f - u) <= np.linalg.norm(g - h) + error + other
    both = np.stack([g, p])
    assert both.min() - error <= f.min() and f.max() <= both.max() + error


@few
@given(g=videos, weight=weights, w=ties, seed=seeds)
def test_temporal_prox_is_non_expansive_and_keeps_mean_and_range(
    g, weight, w, seed, checked, random_image
):
    h = g + random_image(*g.shape, seed=seed)
    (f, error), (u, other) = (checked(video, weight, w) for video in (g, h))
    assert np.linalg.norm(f - u) <= np.linalg.norm(g - h) + error + other
    assert f.mean() == pytest.approx(g.mean(), abs=1e-9)
    assert g.min() - error <= f.min() and f.max() <= g.max() + error


@pytest.mark.parametrize("weight", [0.3, 2.0])
@pytest.mark.parametrize("l1_weight", [0.0, 0.4])
def test_no_general_minimizer_is_better(weight, l1_weight, objective, random_image, solved):
    p = random_image(4, 5, seed=4) if l1_weight else None

    def prox(g):
        more = {"l1_weight": l1_weight, "tolerance": 1e-10, "max_iterations": 200_000}
        return solved(g, weight, None, p, **more).image

    def value(f, g):
        return objective(f, g, weight, 0.0, 0 if p is None else p, l1_weight)

    prox_oracle(prox, value, random_image(4, 5, seed=3))
