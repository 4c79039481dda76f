from itertools import product

import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.reconstruction.total_variation import prox_total_variation, solve_total_variation
from tests.scenes.surfaces import alone, screen_and_column


def test_a_result_short_of_the_tolerance_is_flagged(blocks, solved):
    g = blocks()
    result = solved(g, 0.5, max_iterations=3)
    assert result.iterations == 3
    assert result.gap > 1e-4
    with pytest.warns(RuntimeWarning, match="after 3 iterations"):
        prox_total_variation(g, 0.5, max_iterations=3)


@pytest.mark.parametrize("weight", [7.0, 10.0])
def test_restarts_keep_strong_weights_cheap(weight, random_image, solved):
    # Without restarts these take 750 and 830 iterations.
    assert solved(random_image(29, 36), weight).iterations < 450


@pytest.mark.parametrize("temporal_weight", [0.0, 1.0])
def test_starting_from_a_similar_problems_dual_takes_fewer_iterations(temporal_weight, solved):
    rng = np.random.default_rng(5)
    scene = np.kron(rng.random((2, 5, 4, 3)), np.ones((1, 6, 6, 1)))
    images = scene + 0.3 * rng.standard_normal(scene.shape)
    settings = {"w": temporal_weight, "tolerance": 1e-5}
    first = solved(images, 1.0, **settings)
    changed = images + 0.02 * rng.standard_normal(scene.shape)
    cold = solved(changed, 1.1, **settings)
    warm = solved(changed, 1.1, start=first.dual, **settings)
    assert warm.gap <= 1e-5
    assert warm.iterations < 0.8 * cold.iterations
    np.testing.assert_allclose(warm.image, cold.image, atol=2e-2)
    again = solved(images, 1.0, start=first.dual, **settings)
    assert again.iterations <= 10  # until the gap is looked at first
    lengths = np.sqrt(np.sum(warm.dual.astype(np.float64) ** 2, axis=1))
    assert lengths.max() <= 1 + 1e-6


EXACT = {"tolerance": 1e-10, "max_iterations": 200_000}


IMAGES = [(5, 6), (1, 9), (9, 1), (2, 3)], [(0.05, 0, 0), (0.6, 0, 0), (2.5, 0, 0)]
TIED = ([(1, 7), (4, 5)], [(0.3, 0, 0.2), (2.0, 0, 0.4), (0.0, 0, 0.7)])
VIDEOS = ([(2, 3, 4), (2, 1, 5), (5, 1, 1)], [(1.5, 1.0, 0), (0.6, 0.3, 0)])
SLOWER = [pytest.param(*case, marks=pytest.mark.thorough)
          for kind in (TIED, VIDEOS) for case in product(*kind)]  # fmt: skip


@pytest.mark.parametrize(("shape", "weights"), [*product(*IMAGES), *SLOWER])
def test_prox_equals_the_minimizer_by_alternating_directions(
    shape, weights, random_image, minimizer, solved
):
    weight, w, l1_weight = weights
    g = random_image(*shape, seed=3)
    p = random_image(*shape, seed=4) if l1_weight else None
    found = solved(g, weight, w or None, p, l1_weight=l1_weight, **EXACT)
    assert found.gap <= EXACT["tolerance"]
    np.testing.assert_allclose(found.image, minimizer(g, weight, w, p, l1_weight), atol=3e-5)


TIES = [(0.4, 0, 0), (0.4, 0.8, 0), (0.4, 0, 0.3), (2.0, 0, 0)]


def on_surfaces(hidden, weight, w, l1_weight, seed=6):
    """Solve for images of two channels, or for a video of three frames."""
    random = np.random.default_rng(seed)
    g, p = random.normal(size=(2, *[3] * bool(w), hidden.patches, 2))
    more = {"temporal_weight": w, "l1_weight": l1_weight}
    previous = p if l1_weight else None
    found = solve_total_variation(g, weight, hidden, previous=previous, **more, **EXACT)
    return g, p, more, found


@pytest.mark.parametrize(("weight", "w", "l1_weight"), TIES)
def test_surfaces_are_denoised_each_by_itself(weight, w, l1_weight, solved):
    hidden = screen_and_column()
    g, p, more, found = on_surfaces(hidden, weight, w, l1_weight)
    for one, part in zip(alone(hidden), hidden.slices.values(), strict=True):
        previous = p[..., part, :] if l1_weight else None
        own = solve_total_variation(
            g[..., part, :], weight, one, previous=previous, **more, **EXACT
        )
        np.testing.assert_array_equal(found.image[..., part, :], own.image)
    screen, shape = hidden.slices["screen"], (*g.shape[:-2], 3, 4, 2)
    g, p, f = (each[..., screen, :].reshape(shape) for each in (g, p, found.image))
    previous = p if l1_weight else None
    plain = solved(g, weight, w or None, previous, l1_weight=l1_weight, **EXACT)
    np.testing.assert_array_equal(f, plain.image)


@pytest.mark.parametrize(("weight", "w", "l1_weight"), TIES)
def test_a_curved_surface_is_denoised_by_its_own_distances(weight, w, l1_weight):
    """No image near the result is better, by dense differences of the column's distances."""
    hidden = alone(screen_and_column())[1]
    g, p, _, found = on_surfaces(hidden, weight, w, l1_weight)
    assert found.gap <= EXACT["tolerance"]
    frames = len(g) if w else 1
    D = hidden.differences.matrix.toarray().reshape(2, -1, hidden.patches)
    in_time = np.diff(np.eye(frames), axis=0, append=np.eye(frames)[-1:])
    D = [np.kron(np.eye(frames), each) for each in D]
    D.append(w * np.kron(in_time, np.eye(hidden.patches)))

    def objective(f):
        f, flat = f.reshape(-1, 2), g.reshape(-1, 2)
        variation = np.sqrt(sum((each @ f) ** 2 for each in D)).sum()
        pull = l1_weight * np.abs(f - p.reshape(-1, 2)).sum()
        return np.sum((f - flat) ** 2) + weight * variation + pull

    least, random = objective(found.image), np.random.default_rng(0)
    others = [g, found.image + 0.1 * (g.mean(axis=-2, keepdims=True) - found.image)]
    others += [found.image + size * random.normal(size=g.shape) for size in (1e-4, 1e-3, 0.01)]
    smoothing = np.linalg.inv(np.eye(len(D[0])) + 0.01 * sum(each.T @ each for each in D))
    others.append((smoothing @ found.image.reshape(-1, 2)).reshape(g.shape))
    assert least <= min(map(objective, others)) * (1 + 1e-9)


@pytest.mark.parametrize("weight", [1e5, np.inf])
def test_a_huge_weight_gives_each_surface_its_mean(weight):
    hidden = screen_and_column()
    g = np.random.default_rng(0).normal(size=hidden.patches)
    found = hidden.split(prox_total_variation(g, weight, hidden=hidden))
    for name, image in hidden.split(g).items():
        np.testing.assert_allclose(found[name], image.mean(), atol=1e-12)
    with pytest.raises(ValueError, match="surfaces have 22"):
        prox_total_variation(g[1:], weight, hidden=hidden)


@pytest.mark.parametrize(
    ("weight", "w", "l1_weight"),
    [(0.1, 0, 0), (1, 0, 0), (4, 0, 0), (0.9, 0, 0.1), (0.9, 0, 0.8), (0.7, 0.5, 0), (0.7, 3, 0)],
)
@pytest.mark.parametrize("tolerance", [1e-2, 1e-6])
def test_the_objective_is_within_the_reported_gap_of_the_least(
    weight, w, l1_weight, tolerance, random_image, objective, minimizer, solved
):
    """Of images, of images tied to a previous one, of videos."""
    g = random_image(*(2, 4, 5) if w else (5, 6), seed=4)
    p = random_image(5, 6, seed=5) if l1_weight else None
    result = solved(g, weight, w or None, p, l1_weight=l1_weight, tolerance=tolerance)
    assert result.gap <= tolerance
    exact = minimizer(g, weight, w, p, l1_weight)
    problem = g, weight, w, 0 if p is None else p, l1_weight
    reached, least = objective(result.image, *problem), objective(exact, *problem)
    assert least * (1 - 1e-9) <= reached <= least / (1 - result.gap) + 1e-9
    assert ((result.image - exact) ** 2).sum() <= result.gap * reached + 1e-9


@pytest.mark.parametrize("scale", [1000, 1e-3, 1e250, 1e-250, 1e-300])
def test_scaling_image_and_weight_scales_the_result_alone(scale, blocks, solved):
    g = blocks()
    one = solved(g, 0.3)
    other = solved(scale * g, scale * 0.3)
    assert other.iterations == one.iterations
    assert other.gap == pytest.approx(one.gap, rel=1e-6)
    np.testing.assert_allclose(other.image / scale, one.image, rtol=0, atol=1e-12)


def test_each_channel_is_denoised_on_its_own_with_its_own_weight(blocks):
    g = np.stack([blocks(seed) for seed in range(3)], axis=-1)
    weights = [0.1, 0.0, 0.7]
    alone = [prox_total_variation(g[..., c], weights[c]) for c in range(3)]
    np.testing.assert_array_equal(prox_total_variation(g, weights), np.stack(alone, axis=-1))
    np.testing.assert_array_equal(prox_total_variation(g, 0.1)[..., 0], alone[0])


@pytest.mark.parametrize(
    ("shape", "given", "name"),
    [
        ((9, 1), {"weight": -1}, "weight"),
        ((9, 3), {"weight": [1, 2]}, "broadcast"),
        ((9,), {}, "shape"),
        ((8, 1), {}, "9 patches"),
        ((9, 1), {"tolerance": 0}, "tolerance"),
        ((9, 1), {"max_iterations": 0}, "max_iterations"),
        ((2, 9, 1), {"temporal_weight": -1}, "temporal_weight"),
        ((2, 9, 1), {"temporal_weight": np.inf}, "temporal_weight"),
        ((9, 1), {"previous": np.ones((8, 1)), "l1_weight": 1}, "previous"),
        ((9, 1), {"previous": np.full((9, 1), np.nan), "l1_weight": 1}, "previous"),
        ((9, 1), {"previous": np.ones((9, 1)), "l1_weight": -1}, "l1_weight"),
        ((9, 1), {"l1_weight": 1}, "previous"),
    ],
)
def test_bad_arguments_are_rejected(shape, given, name):
    with pytest.raises(ValueError, match=name):
        solve_total_variation(np.ones(shape), **{"weight": 1, "hidden": Hidden.of((3, 3)), **given})
    for wrong, reason in ((np.full((3, 3), np.nan), "NaN"), (np.ones(3), "rows, columns")):
        with pytest.raises(ValueError, match=reason):
            prox_total_variation(wrong, 1)


@pytest.fixture
def prox_l1(solved):
    def prox(g, p, weight, l1_weight, tolerance=1e-4):
        result = solved(g, weight, None, p, l1_weight=l1_weight, tolerance=tolerance)
        assert result.gap <= tolerance
        return result.image

    return prox


def test_each_channel_has_its_own_weights(blocks, prox_l1):
    g = np.stack([blocks(seed) for seed in range(3)], axis=-1)
    p = np.stack([blocks(seed) for seed in range(3, 6)], axis=-1)
    weights, l1_weights = [0.1, 0.3, 0.0], [0.2, 0.0, 0.4]
    alone = [prox_l1(g[..., c], p[..., c], weights[c], l1_weights[c]) for c in range(3)]
    f = prox_l1(g, p, weights, l1_weights)
    np.testing.assert_array_equal(f, np.stack(alone, axis=-1))
