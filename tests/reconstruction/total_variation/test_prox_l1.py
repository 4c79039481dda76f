import numpy as np
import pytest

from periscopy_sim.reconstruction.total_variation.prox import (
    prox_total_variation,
    solve_total_variation,
)


def prox_l1(g, p, weight, l1_weight, **options):
    result = solve_total_variation(g, weight, previous=p, l1_weight=l1_weight, **options)
    assert result.converged
    return result.image


EXACT = {"tolerance": 1e-10, "max_iterations": 200_000}
SHAPES = [(1, 1), (1, 7), (7, 1), (4, 5), (5, 3)]


def random_image(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def blocks(seed=0):
    image = np.zeros((12, 15))
    image[2:7, 3:11] = 1.0
    image[6:11, 8:] += 0.5
    return image + 0.2 * random_image(12, 15, seed=seed)


def loop_differences(image):
    rows, columns = image.shape
    for i in range(rows):
        for j in range(columns):
            yield (
                image[i + 1, j] - image[i, j] if i + 1 < rows else 0.0,
                image[i, j + 1] - image[i, j] if j + 1 < columns else 0.0,
            )


def objective(f, g, p, weight, l1_weight):
    variation = sum(np.hypot(*d) for d in loop_differences(f))
    return ((f - g) ** 2).sum() + weight * variation + l1_weight * np.abs(f - p).sum()


def admm_prox(g, p, weight, l1_weight, ρ=2.0, iterations=8000):
    """Alternating directions on z = D f and y = f − p, by dense linear algebra."""
    units = np.eye(g.size).reshape(-1, *g.shape)
    D = np.stack([np.ravel(list(loop_differences(unit))) for unit in units], axis=1)
    inverse = np.linalg.inv((2 + ρ) * np.eye(g.size) + ρ * D.T @ D)
    z = u = np.zeros((g.size, 2))
    y = v = np.zeros(g.size)
    for _ in range(iterations):
        f = inverse @ (2 * g.ravel() + ρ * D.T @ (z - u).ravel() + ρ * (p.ravel() + y - v))
        a = (D @ f).reshape(-1, 2) + u
        length = np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-300)
        z = a * np.maximum(1 - weight / ρ / length, 0)
        u = a - z
        b = f - p.ravel() + v
        y = np.sign(b) * np.maximum(np.abs(b) - l1_weight / ρ, 0)
        v = b - y
    return f.reshape(g.shape)


@pytest.mark.thorough
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("weight", "l1_weight"), [(0.3, 0.2), (0.3, 1.5), (2.0, 0.4), (0.0, 0.7)])
def test_prox_equals_the_minimizer_by_alternating_directions(shape, weight, l1_weight):
    g, p = random_image(*shape, seed=3), random_image(*shape, seed=4)
    f = prox_l1(g, p, weight, l1_weight, **EXACT)
    np.testing.assert_allclose(f, admm_prox(g, p, weight, l1_weight), atol=3e-5)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("l1_weight", [0.1, 0.8])
def test_the_objective_is_within_the_reported_gap_of_the_least(tolerance, l1_weight):
    g, p = random_image(5, 6, seed=4), random_image(5, 6, seed=5)
    result = solve_total_variation(g, 0.9, previous=p, l1_weight=l1_weight, tolerance=tolerance)
    least = objective(admm_prox(g, p, 0.9, l1_weight), g, p, 0.9, l1_weight)
    assert result.converged
    reached = objective(result.image, g, p, 0.9, l1_weight)
    assert least * (1 - 1e-9) <= reached <= least / (1 - result.gap) + 1e-9


def test_without_l1_weight_it_is_the_plain_prox():
    g, p = blocks(), blocks(1)
    f = prox_l1(g, p, 0.3, 0)
    np.testing.assert_array_equal(f, prox_total_variation(g, 0.3))


@pytest.mark.parametrize("l1_weight", [0.05, 0.3, 1.2])
def test_without_total_variation_the_image_is_shrunk_towards_the_previous(l1_weight):
    g, p = blocks(), blocks(1)
    expected = p + np.sign(g - p) * np.maximum(np.abs(g - p) - l1_weight / 2, 0)
    f = prox_l1(g, p, 0, l1_weight)
    np.testing.assert_allclose(f, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("l1_weight", [50.0, 1e6, np.inf])
def test_a_huge_l1_weight_gives_the_previous_image(l1_weight):
    g, p = blocks(), blocks(1)
    f = prox_l1(g, p, 0.3, l1_weight)
    np.testing.assert_allclose(f, p, rtol=0, atol=1e-14)


def test_most_patches_of_a_still_scene_keep_the_previous_value_exactly():
    g, p = blocks(), prox_total_variation(blocks(1), 0.3)
    f = prox_l1(g, p, 0.1, 0.4, tolerance=1e-8)
    kept = np.isclose(f, p, rtol=0, atol=1e-12)
    assert 0.5 < kept.mean() < 1


def test_each_channel_has_its_own_weights():
    g = np.stack([blocks(seed) for seed in range(3)], axis=-1)
    p = np.stack([blocks(seed) for seed in range(3, 6)], axis=-1)
    weights, l1_weights = [0.1, 0.3, 0.0], [0.2, 0.0, 0.4]
    alone = [prox_l1(g[..., c], p[..., c], weights[c], l1_weights[c]) for c in range(3)]
    f = prox_l1(g, p, weights, l1_weights)
    np.testing.assert_array_equal(f, np.stack(alone, axis=-1))


@pytest.mark.parametrize("scale", [1000, 1e-3, 1e250])
def test_scaling_images_and_weights_scales_the_result_alone(scale):
    g, p = blocks(), blocks(1)
    one = solve_total_variation(g, 0.3, previous=p, l1_weight=0.2)
    other = solve_total_variation(scale * g, scale * 0.3, previous=scale * p, l1_weight=scale * 0.2)
    assert other.iterations == one.iterations
    np.testing.assert_allclose(other.image / scale, one.image, rtol=0, atol=1e-12)


@pytest.mark.parametrize("l1_weight", [0.02, 0.2, 2.0])
@pytest.mark.parametrize("weight", [0.1, 1.0, 5.0])
def test_single_precision_agrees_with_double_precision_up_to_their_gaps(weight, l1_weight):
    g, p = blocks(), blocks(1)
    single = solve_total_variation(
        g.astype(np.float32), weight, previous=p, l1_weight=l1_weight, max_iterations=3000
    )
    double = solve_total_variation(g, weight, previous=p, l1_weight=l1_weight)
    assert single.image.dtype == np.float32
    assert single.converged
    allowed = np.sqrt(objective(double.image, g, p, weight, l1_weight))
    allowed *= np.sqrt(single.gap) + np.sqrt(double.gap)
    assert np.linalg.norm(single.image - double.image) <= allowed + 1e-6 * np.linalg.norm(g)


@pytest.mark.parametrize("distance", [1e2, 1e5])
def test_a_distant_previous_image_draws_each_patch_by_half_its_weight(distance):
    g = blocks().astype(np.float32)
    p = g + np.float32(distance)
    f = prox_l1(g, p, 0.3, 0.2, tolerance=1e-10)
    expected = prox_total_variation(g.astype(np.float64), 0.3, tolerance=1e-9) + 0.1
    np.testing.assert_allclose(f, expected, atol=2e-3)


def test_the_tolerance_is_of_the_objective_with_all_its_terms():
    g = blocks()
    near = solve_total_variation(g, 1.0, previous=g + 100.0, l1_weight=0.2)
    far = solve_total_variation(g, 1.0, previous=g + 1e6, l1_weight=0.2)
    assert near.converged and far.converged
    assert far.iterations < near.iterations


@pytest.mark.parametrize(
    ("previous", "weight", "l1_weight", "message"),
    [
        (np.ones((3, 4)), 1, 1, "previous has shape"),
        (np.full((3, 3), np.nan), 1, 1, "previous holds NaN"),
        (np.ones((3, 3)), 1, -1, "l1_weight is"),
        (np.ones((3, 3)), 1, np.nan, "l1_weight is"),
        (np.ones((3, 3)), 1, [1, 2, 3], "l1_weight has shape"),
        (np.ones((3, 3)), np.inf, 1, "finite weight"),
        (None, 1, 1, "previous image"),
    ],
)
def test_bad_arguments_are_refused(previous, weight, l1_weight, message):
    with pytest.raises(ValueError, match=message):
        solve_total_variation(np.ones((3, 3)), weight, previous=previous, l1_weight=l1_weight)
