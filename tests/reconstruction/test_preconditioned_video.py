import numpy as np
import pytest

from periscopy_sim.reconstruction.preconditioned import Periscope, Video, repair
from periscopy_sim.reconstruction.total_variation import prox_total_variation

HIDDEN = (5, 6)
RNG = np.random.default_rng(0)
A = RNG.random((400, 30))
B = RNG.random((400, 5))
TRUTH = np.zeros((6, *HIDDEN, 3))
for k in range(6):
    TRUTH[k, 1:4, k % 5 : k % 5 + 2] = (0.9, 0.4, 0.1)
SIGNAL = np.stack([A @ f.reshape(-1, 3) + B @ np.ones((5, 3)) for f in TRUTH])
NOISE = 2e-2
PHOTOGRAPHS = SIGNAL + NOISE * RNG.standard_normal(SIGNAL.shape)


@pytest.fixture(params=[True, False], ids=["explicit", "factored"])
def periscope(request):
    return Periscope(A, B, hidden=HIDDEN, explicit=request.param)


def test_later_frame_is_denoised_in_three_dimensions_and_repaired_with_the_previous(
    periscope, solved
):
    video = Video(periscope, coupling="total-variation")
    previous = video.next_frame(PHOTOGRAPHS[0])
    found = video.solve_next(PHOTOGRAPHS[1])
    still = periscope.solve(PHOTOGRAPHS[1])
    np.testing.assert_allclose(found.preconditioned, still.preconditioned, rtol=1e-6)
    np.testing.assert_allclose(found.weight, still.weight, rtol=1e-6)
    pair = np.stack([previous, found.preconditioned])
    denoised = solved(pair, found.weight, 1.0).image[1]
    np.testing.assert_array_equal(found.denoised, denoised)
    percentile = np.percentile(np.linalg.norm(denoised, axis=2), 99)
    assert found.threshold == pytest.approx(0.1 * percentile, rel=1e-6)
    expected = repair(denoised, found.threshold, previous)
    np.testing.assert_array_equal(found.image, expected)
    assert not np.array_equal(found.image, still.image)


@pytest.mark.parametrize("coupling", ["total-variation", "l1"])
def test_every_frame_is_its_problems_minimizer_wherever_it_starts_from(periscope, coupling, solved):
    video = Video(periscope, coupling=coupling, l1_weight=3.0, temporal_weight=2.0)
    video.next_frame(PHOTOGRAPHS[0])
    for photograph in PHOTOGRAPHS[1:]:
        previous = video.previous
        found = video.solve_next(photograph)
        g, weight = found.preconditioned.astype(np.float64), found.weight
        if coupling == "l1":
            exact = solved(g, weight, None, previous, l1_weight=3 * weight, tolerance=1e-9).image
        else:
            pair = np.stack([previous, g])
            exact = solved(pair, weight, 2.0, tolerance=1e-9).image[1]
        still = prox_total_variation(g, weight, tolerance=1e-9)
        assert np.linalg.norm(found.denoised - exact) < 0.1 * np.linalg.norm(still - exact)


@pytest.mark.parametrize("coupling", ["total-variation", "l1"])
def test_scene_at_rest_is_recovered_better_than_by_stills(coupling):
    # Repair would take the corners off so small an image.
    periscope = Periscope(A, B, hidden=HIDDEN, repair_threshold=np.inf)
    rng = np.random.default_rng(1)
    gains = []
    for _ in range(30):
        at_rest = SIGNAL[2] + NOISE * rng.standard_normal((4, 400, 3))
        last, still = (
            np.mean((Video(periscope, coupling=name).frames(at_rest)[-1] - TRUTH[2]) ** 2)
            for name in (coupling, "none")
        )
        gains.append(still - last)
    assert np.mean(gains) > 4 * np.std(gains, ddof=1) / np.sqrt(len(gains))


def test_flat_frames_cannot_be_coupled():
    flat = Periscope(A, B, hidden=HIDDEN, tv_weight=np.inf)
    for coupling in ("total-variation", "l1"):
        with pytest.raises(ValueError, match="infinite tv_weight"):
            Video(flat, coupling=coupling)
    assert np.ptp(Video(flat, coupling="none").frames(PHOTOGRAPHS)[1], axis=(0, 1)).max() < 1e-6
