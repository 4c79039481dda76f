"""What holds of every denoised image and video: with an ℓ1 term, with time, and in repair."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from periscopy_sim.reconstruction.preconditioned.still import repair
from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation

few = settings(deadline=None, max_examples=40)
weights = st.just(0.0) | st.floats(1e-6, 30)
ties = st.just(0.0) | st.floats(1e-6, 3)
seeds = st.integers(0, 1000)
values = st.integers(-50, 50).map(lambda n: n / 10)
images = arrays(np.float64, st.tuples(*[st.integers(1, 5)] * 2), elements=values)
videos = arrays(np.float64, st.tuples(*[st.integers(1, 4)] * 3), elements=values)
pictures = arrays(
    np.float64,
    st.tuples(st.integers(1, 6), st.integers(1, 6), st.just(2)),
    elements=st.integers(-20, 20).map(float),
)


@pytest.fixture(scope="session")
def noise(random_image):
    return lambda shape, seed: random_image(*shape, seed=seed)


@pytest.fixture(scope="session")
def l1(objective):
    """Minimizer, and how far it may be from the exact one."""

    def solved(g, p, weight, l1_weight):
        tied = {"previous": p, "l1_weight": l1_weight}
        found = solve_total_variation(g, weight, **tied, max_iterations=3000)
        reached = objective(found.image, g, weight, 0, p, l1_weight)
        return found.image, np.sqrt(found.gap * reached) + 1e-9

    return solved


@pytest.fixture(scope="session")
def temporal(objective):
    def solved(g, weight, w):
        found = solve_total_variation(g, weight, temporal_weight=w, max_iterations=3000)
        return found.image, np.sqrt(found.gap * objective(found.image, g, weight, w)) + 1e-9

    return solved


@few
@given(g=images, weight=weights, l1_weight=weights, seed=seeds)
def test_l1_prox_is_non_expansive(g, weight, l1_weight, seed, noise, l1):
    p, h = noise(g.shape, seed), g + noise(g.shape, seed + 1)
    (f, error), (u, other) = (l1(image, p, weight, l1_weight) for image in (g, h))
    assert np.linalg.norm(f - u) <= np.linalg.norm(g - h) + error + other


@few
@given(g=images, weight=weights, l1_weight=weights, seed=seeds)
def test_l1_prox_stays_between_the_least_and_the_greatest_of_both_images(
    g, weight, l1_weight, seed, noise, l1
):
    p = noise(g.shape, seed)
    f, error = l1(g, p, weight, l1_weight)
    both = np.stack([g, p])
    assert both.min() - error <= f.min() and f.max() <= both.max() + error


@few
@given(g=images, weight=weights, l1_weight=weights, seed=seeds)
def test_l1_prox_is_no_worse_than_any_other_image(g, weight, l1_weight, seed, noise, l1, objective):
    p = noise(g.shape, seed)
    f, error = l1(g, p, weight, l1_weight)
    others = [g, p, (g + p) / 2, np.full_like(g, g.mean()), f + 0.1 * noise(g.shape, seed + 2)]
    reached, *rest = (objective(u, g, weight, 0, p, l1_weight) for u in (f, *others))
    assert reached <= (1 + 1e-9) * min(rest) + error**2


@few
@given(g=videos, weight=weights, w=ties, seed=seeds)
def test_temporal_prox_is_non_expansive(g, weight, w, seed, noise, temporal):
    h = g + noise(g.shape, seed)
    (f, error), (u, other) = (temporal(video, weight, w) for video in (g, h))
    assert np.linalg.norm(f - u) <= np.linalg.norm(g - h) + error + other


@few
@given(g=videos, weight=weights, w=ties)
def test_temporal_prox_keeps_the_mean_and_the_range(g, weight, w, temporal):
    f, error = temporal(g, weight, w)
    assert f.mean() == pytest.approx(g.mean(), abs=1e-9)
    assert g.min() - error <= f.min() and f.max() <= g.max() + error


@few
@given(g=videos, weight=weights, w=ties, seed=seeds)
def test_temporal_prox_is_no_worse_than_any_other_video(
    g, weight, w, seed, noise, temporal, objective
):
    f, error = temporal(g, weight, w)
    others = [g, np.full_like(g, g.mean()), f + 0.1 * noise(g.shape, seed)]
    reached, *rest = (objective(u, g, weight, w) for u in (f, *others))
    assert reached <= (1 + 1e-9) * min(rest) + error**2


@few
@given(image=pictures, threshold=st.integers(0, 20))
def test_repair_turns_and_mirrors_with_the_image(image, threshold):
    threshold += 1 / np.pi  # no deviation of these images meets it exactly
    repaired = repair(image, threshold)
    for turned in (lambda x: x[::-1], lambda x: x[:, ::-1], lambda x: x.transpose(1, 0, 2)):
        np.testing.assert_array_equal(repair(turned(image), threshold), turned(repaired))
    np.testing.assert_array_equal(repair(image[..., ::-1], threshold), repaired[..., ::-1])
