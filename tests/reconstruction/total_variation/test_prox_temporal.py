import numpy as np
import pytest

from periscopy_sim.reconstruction.total_variation.prox import (
    prox_total_variation,
    solve_total_variation,
)

EXACT = {"tolerance": 1e-10, "max_iterations": 200_000}
SHAPES = [(2, 3, 4), (3, 4, 3), (2, 1, 5), (2, 5, 1), (4, 2, 2), (5, 1, 1)]


def random_video(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def moving_blocks(seed=0):
    video = np.zeros((2, 12, 15))
    video[0, 2:7, 3:11] = 1.0
    video[1, 3:8, 4:12] = 1.0
    return video + 0.2 * random_video(2, 12, 15, seed=seed)


def loop_differences(video, w):
    """Lists (w dt, dx, dy) of every voxel, by plain loops."""
    frames, rows, columns = video.shape
    for t in range(frames):
        for i in range(rows):
            for j in range(columns):
                here = video[t, i, j]
                yield (
                    w * (video[t + 1, i, j] - here) if t + 1 < frames else 0.0,
                    video[t, i + 1, j] - here if i + 1 < rows else 0.0,
                    video[t, i, j + 1] - here if j + 1 < columns else 0.0,
                )


def objective(f, g, weight, w):
    variation = sum(np.sqrt(np.dot(d, d)) for d in loop_differences(f, w))
    return ((f - g) ** 2).sum() + weight * variation


def admm_prox(g, weight, w, ρ=2.0, iterations=6000):
    """Alternating directions on z = D f, by dense linear algebra."""
    units = np.eye(g.size).reshape(-1, *g.shape)
    D = np.stack([np.ravel(list(loop_differences(unit, w))) for unit in units], axis=1)
    inverse = np.linalg.inv(2 * np.eye(g.size) + ρ * D.T @ D)
    z = u = np.zeros((g.size, 3))
    for _ in range(iterations):
        f = inverse @ (2 * g.ravel() + ρ * D.T @ (z - u).ravel())
        v = (D @ f).reshape(-1, 3) + u
        length = np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-300)
        z = v * np.maximum(1 - weight / ρ / length, 0)
        u = v - z
    return f.reshape(g.shape)


@pytest.mark.thorough
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("weight", "w"), [(0.3, 1.0), (1.5, 1.0), (0.6, 0.3), (0.6, 2.0)])
def test_prox_equals_the_minimizer_by_alternating_directions(shape, weight, w):
    g = random_video(*shape, seed=3)
    f = prox_total_variation(g, weight, temporal_weight=w, **EXACT)
    np.testing.assert_allclose(f, admm_prox(g, weight, w), atol=3e-5)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("w", [0.5, 1.0, 3.0])
def test_the_objective_is_within_the_reported_gap_of_the_least(tolerance, w):
    g = random_video(2, 4, 5, seed=4)
    result = solve_total_variation(g, 0.7, temporal_weight=w, tolerance=tolerance)
    least = objective(admm_prox(g, 0.7, w), g, 0.7, w)
    assert result.converged
    reached = objective(result.image, g, 0.7, w)
    assert least * (1 - 1e-9) <= reached <= least / (1 - result.gap) + 1e-9


@pytest.mark.parametrize("coloured", [False, True])
def test_without_temporal_weight_each_frame_is_denoised_on_its_own(coloured):
    g = moving_blocks()
    weight = 0.4
    if coloured:
        g, weight = np.stack([g, -3 * g], axis=-1), [0.4, 0.1]
    f = prox_total_variation(g, weight, temporal_weight=0)
    alone = [prox_total_variation(frame, weight) for frame in g]
    np.testing.assert_array_equal(f, np.stack(alone))


@pytest.mark.parametrize("w", [0.5, 1.0, 2.0])
def test_single_patches_vary_in_time_alone(w):
    g = np.cumsum(random_video(9, 1, 1, seed=2), axis=0)
    f = prox_total_variation(g, 0.8, temporal_weight=w, **EXACT)
    signal = prox_total_variation(g[:, :, 0], w * 0.8, **EXACT)
    np.testing.assert_allclose(f[:, :, 0], signal, atol=1e-5)


@pytest.mark.parametrize(
    ("weight", "w", "expected"),
    [
        (2.0, 0.2, [0.2, 0.8]),
        (4.5, 0.2, [0.45, 0.55]),
        (5.5, 0.2, [0.5, 0.5]),
        (0.3, 2, [0.3, 0.7]),
    ],
)
def test_a_change_in_time_shrinks_by_the_weight_of_time(weight, w, expected):
    g = np.zeros((2, 3, 4))
    g[1] = 1.0
    f = prox_total_variation(g, weight, temporal_weight=w, **EXACT)
    np.testing.assert_allclose(f[:, 1, 2], expected, atol=1e-6)
    np.testing.assert_allclose(np.ptp(f, axis=(1, 2)), 0, atol=1e-6)


def test_frames_that_time_ties_firmly_become_the_denoised_mean():
    g = random_video(2, 4, 5)
    f = prox_total_variation(g, 1.0, temporal_weight=15, tolerance=1e-6, max_iterations=50_000)
    mean = prox_total_variation(g.mean(axis=0), 1.0, **EXACT)
    np.testing.assert_allclose(f, np.stack([mean, mean]), atol=5e-3)


def test_the_previous_frame_lowers_the_error_of_a_still_scene():
    truth = np.zeros((2, 12, 15))
    truth[:, 2:7, 3:11] = 1.0
    g = truth + 0.3 * random_video(*truth.shape)
    alone = prox_total_variation(g, 0.3, temporal_weight=0)
    tied = prox_total_variation(g, 0.3, temporal_weight=1)
    assert ((tied - truth) ** 2).sum() < 0.9 * ((alone - truth) ** 2).sum()


@pytest.mark.parametrize("scale", [1000, 1e-3, 1e250])
def test_scaling_video_and_weight_scales_the_result_alone(scale):
    g = moving_blocks()
    one = solve_total_variation(g, 0.3, temporal_weight=1)
    other = solve_total_variation(scale * g, scale * 0.3, temporal_weight=1)
    assert other.iterations == one.iterations
    np.testing.assert_allclose(other.image / scale, one.image, rtol=0, atol=1e-12)


@pytest.mark.parametrize("weight", [0.1, 1.0, 5.0])
def test_single_precision_agrees_with_double_precision_up_to_their_gaps(weight):
    g = moving_blocks()
    single = solve_total_variation(g.astype(np.float32), weight, temporal_weight=1)
    double = solve_total_variation(g, weight, temporal_weight=1)
    assert single.image.dtype == np.float32
    assert single.converged
    allowed = np.sqrt(objective(double.image, g, weight, 1))
    allowed *= np.sqrt(single.gap) + np.sqrt(double.gap)
    assert np.linalg.norm(single.image - double.image) <= allowed + 1e-6 * np.linalg.norm(g)


@pytest.mark.parametrize(
    ("shape", "w", "message"),
    [
        ((3, 3), 1, "shape"),
        ((2, 2, 3, 3, 3), 1, "shape"),
        ((2, 0, 3), 1, "shape"),
        ((2, 3, 3), -1, "temporal_weight"),
        ((2, 3, 3), np.nan, "temporal_weight"),
        ((2, 3, 3), np.inf, "temporal_weight"),
    ],
)
def test_bad_arguments_are_refused(shape, w, message):
    with pytest.raises(ValueError, match=message):
        prox_total_variation(np.ones(shape), 1, temporal_weight=w)
