import numpy as np
import pytest

from benchmarks.scoring import interval, scores

TRUTH = np.random.default_rng(1).random((10, 12, 3))


def test_the_truth_at_any_gain_is_perfect():
    found = scores(3 * TRUTH, TRUTH)
    assert found["psnr"] > 60
    assert found["ssim"] == pytest.approx(1)


def test_registered_forgives_a_shift():
    found = scores(np.roll(TRUTH, 1, axis=1), TRUTH)
    assert found["registered"] > found["psnr"] + 3


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.full((10, 12, 3), np.nan), "NaN"),
        (np.zeros((12, 10, 3)), "shape"),
        (np.zeros((10, 12, 3), complex), "real numbers"),
        ("a picture", "shape"),
    ],
)
def test_what_is_no_image_is_refused(image, message):
    with pytest.raises(ValueError, match=message):
        scores(image, TRUTH)


def test_intervals_count_geometries_not_cells():
    groups = np.repeat(np.arange(6), 20)
    values = np.random.default_rng(0).normal(size=6)[groups]  # cells tell nothing beyond theirs
    mean, low, high = interval(values, list(groups))
    assert low < mean < high
    assert high - low > 3 * 2 * 1.96 * values.std() / np.sqrt(values.size) / 2
    assert interval(values, list(groups)) == (mean, low, high)


def test_an_interval_covers_the_mean_that_it_estimates():
    rng = np.random.default_rng(5)
    groups = list(np.repeat(np.arange(20), 4))
    hits = 0
    for _ in range(40):
        values = np.repeat(rng.normal(size=20), 4) + rng.normal(size=80)
        _, low, high = interval(values, groups)
        hits += low <= 0 <= high
    assert hits >= 34
