"""Video by the noise-aware method, against brute force and against stills."""

import numpy as np
import pytest
from scipy.optimize import minimize

from periscopy_sim.reconstruction.noise_aware import NoiseAware, NoiseAwareVideo
from periscopy_sim.reconstruction.penalized_likelihood import Schedule

HIDDEN = (4, 5)
RNG = np.random.default_rng(0)
ROWS, COLUMNS = np.mgrid[:4, :5].reshape(2, 20) / 4
POINTS = RNG.random((180, 2, 1))
A = np.exp(-8 * ((POINTS[:, 0] - ROWS) ** 2 + (POINTS[:, 1] - COLUMNS) ** 2))  # blurs
B = RNG.random((180, 4))
BLOCK = np.zeros((*HIDDEN, 3))
BLOCK[1:3, 1:3] = (0.9, 0.5, 0.2)
TRUTH = np.stack([np.roll(BLOCK, k, axis=1) for k in range(5)])
SIGNAL = np.stack([A @ f.reshape(-1, 3) + B @ np.ones((4, 3)) for f in TRUTH])
NOISE = 0.05
PHOTOGRAPHS = SIGNAL + NOISE * RNG.standard_normal(SIGNAL.shape)


@pytest.fixture(scope="module")
def still():
    return NoiseAware(A, B, hidden=HIDDEN, regularization=0.1)


@pytest.fixture(scope="module")
def exact():
    settings = {"regularization": 0.1, "tolerance": 1e-6, "max_iterations": 20_000}
    return NoiseAware(A, B, hidden=HIDDEN, **settings)


def distance(image, other):
    return np.linalg.norm(image - other) / np.linalg.norm(other)


def objective(f, y, previous, noise, weight, l1_weight, smoothing):
    """The formula of the module, every norm's corner rounded off."""

    def length(squares):
        return np.sum(np.sqrt(squares + smoothing**2) - smoothing)

    image = f.reshape(*HIDDEN, 3)
    left = A @ f.reshape(-1, 3) - y
    Q = np.linalg.qr(B)[0]
    misfit = np.sum(((left - Q @ (Q.T @ left)) / noise) ** 2)
    down = np.diff(image, axis=0, append=image[-1:])
    across = np.diff(image, axis=1, append=image[:, -1:])
    variation = length(np.sum(down**2 + across**2, axis=2))
    return misfit + weight * (
        variation + l1_weight * length(np.sum((image - previous) ** 2, axis=2))
    )


def brute_force(*problem):
    """Quasi-Newton steps in ever sharper stages."""
    f = np.full(60, 0.1)
    for smoothing in (1e-1, 1e-2, 1e-3, 1e-4):
        f = minimize(
            objective, f, (*problem, smoothing), "L-BFGS-B", bounds=[(0, None)] * 60,
            options={"maxiter": 20_000, "maxfun": 10**6, "ftol": 1e-15, "gtol": 1e-9},
        ).x  # fmt: skip
    return f.reshape(*HIDDEN, 3)


@pytest.mark.thorough
@pytest.mark.parametrize("l1_weight", [1.0, 3.0])
def test_frame_minimizes_the_objective_with_the_distance_to_the_frame_before(exact, l1_weight):
    video = NoiseAwareVideo(exact, l1_weight=l1_weight)
    for y in PHOTOGRAPHS[:3]:
        previous = video.previous
        found = video.solve_next(y)
    problem = (y, previous, found.noise, found.weight, l1_weight)
    expected = brute_force(*problem)
    least = objective(expected.ravel(), *problem, 0.0)
    assert objective(found.image.ravel(), *problem, 0.0) < least * (1 + 1e-4)
    assert np.abs(found.image - expected).max() < 0.01 * expected.max()
    assert distance(found.image, expected) < 0.04 * distance(exact.reconstruct(y), expected)


@pytest.mark.parametrize("coupling", ["l1", "none"])
def test_where_a_frame_starts_from_does_not_matter(still, exact, coupling):
    # The exact frame that follows the same frame, solved for from black.
    weight = 0.8 if coupling == "l1" else 0.0
    video = NoiseAwareVideo(still, coupling=coupling)
    video.next_frame(PHOTOGRAPHS[0])
    for y in (*PHOTOGRAPHS[1:], PHOTOGRAPHS[1]):
        previous = video.previous
        (evidence,) = exact.evidence(y[None])
        expected, _ = exact.recover(evidence, previous=previous, l1_weight=weight)
        assert distance(video.next_frame(y), expected.image) < 0.02


@pytest.mark.parametrize("l1_weight", [1e6, 1e12])
def test_frames_that_are_coupled_firmly_stay_as_the_first(still, l1_weight):
    video = NoiseAwareVideo(still, l1_weight=l1_weight)
    first = video.next_frame(PHOTOGRAPHS[0])
    for y in PHOTOGRAPHS[1:]:
        found = video.solve_next(y)
        np.testing.assert_allclose(found.image, first, atol=1e-5)
        assert found.iterations < 100


def test_coupling_lowers_the_error_in_motion_and_more_at_rest(still):
    rng = np.random.default_rng(1)
    ratios = []
    for signal, truth in ((SIGNAL, TRUTH), (SIGNAL[[0] * 5], TRUTH[[0] * 5])):
        errors = {"l1": [], "none": []}
        for _ in range(30):
            y = signal + NOISE * rng.standard_normal(SIGNAL.shape)
            for coupling, values in errors.items():
                frames = NoiseAwareVideo(still, coupling=coupling).frames(y)
                values.append(np.mean((frames - truth)[2:] ** 2))
        gains = np.array(errors["none"]) - errors["l1"]
        assert gains.mean() > 4 * gains.std(ddof=1) / np.sqrt(len(gains))
        ratios.append(np.mean(errors["l1"]) / np.mean(errors["none"]))
    assert ratios[1] < ratios[0]


@pytest.mark.parametrize("scale", [1.0, 7.0])
@pytest.mark.parametrize("penalty", [0.1, 0.4])
def test_iterations_that_start_from_the_minimum_stay_there(exact, scale, penalty):
    one, brighter = exact.evidence(np.stack([PHOTOGRAPHS[0], scale * PHOTOGRAPHS[0]]))
    minimum, split = exact.recover(one)
    few = Schedule(1e-9, 3, penalty)
    stayed, _ = exact.recover(brighter, few, split)
    assert distance(stayed.image, scale * minimum.image) < 1e-4
    assert distance(exact.recover(brighter, few)[0].image, scale * minimum.image) > 1e-2


@pytest.mark.parametrize(("before", "after"), [(1, 1e-3), (1, 0.25), (1, 4), (1, 1e3)])
def test_exposure_that_changes_costs_little(exact, before, after):
    video = NoiseAwareVideo(exact)
    video.frames(before * PHOTOGRAPHS[:2])
    frames = video.frames(after * PHOTOGRAPHS[[2, 2, 2]]) / after
    for frame in frames:
        # The pull towards a frame of another exposure is bounded, however far that may be.
        assert distance(frame, TRUTH[2]) < 0.3
    unchanged = NoiseAwareVideo(exact).frames(PHOTOGRAPHS[[2, 2, 2]])
    assert distance(frames[2], unchanged[2]) < 0.15


def test_cut_is_followed(still):
    video = NoiseAwareVideo(still)
    video.frames(PHOTOGRAPHS[:2])
    after = np.ones((*HIDDEN, 3)) * (0.1, 0.6, 0.8) - TRUTH[3] / 10
    y = A @ after.reshape(-1, 3) + B @ np.ones((4, 3))
    noise = np.random.default_rng(2).standard_normal((20, *y.shape))
    errors, stills = [], []
    for draw in noise:
        video.restart()
        video.next_frame(PHOTOGRAPHS[1])
        errors.append(distance(video.next_frame(y + NOISE * draw), after))
        stills.append(distance(still.reconstruct(y + NOISE * draw), after))
    assert np.mean(errors) < 1.5 * np.mean(stills)
