import numpy as np
import pytest

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.develop import develop, mask_of_pixels, sensor_image

SIZE = (40, 60)
LIGHT = np.random.default_rng(2).uniform(100, 200, (*SIZE, 3))


def shot(light, time, seed, black=64, white=4095):
    """Counts of a sensor with Poisson noise, which end at its largest code."""
    counts = np.random.default_rng(seed).poisson(light * time) + black
    return np.minimum(counts, white).astype(np.uint16)


def test_black_level_and_dark_frame_come_off():
    counts = shot(LIGHT, 1, 0)
    dark = np.full((*SIZE, 3), 64.0)
    expected = counts - 64.0
    assert np.array_equal(develop([counts], black=64).values, expected)
    assert np.array_equal(develop([counts], dark=dark).values, expected)
    with pytest.raises(PhotographError, match="one of the two"):
        develop([counts], black=64, dark=dark)
    hot = dark.astype(np.uint16)
    hot[5, 6] = 65535
    assert np.argwhere(develop([counts], dark=hot).saturated).tolist() == [[5, 6]]


def test_photographs_are_averaged_and_saturated_where_any_is():
    counts = [shot(LIGHT, 1, seed) for seed in range(4)]
    counts[2][3, 4, 1] = 4095
    found = develop(counts)
    assert np.allclose(found.values, np.mean(counts, axis=0), rtol=1e-6)
    assert np.argwhere(found.saturated).tolist() == [[3, 4]]


def test_flat_field_takes_vignetting_off_and_keeps_the_mean_light():
    row, column = np.indices(SIZE)
    fall = 1 - 0.3 * ((row / 39 - 0.5) ** 2 + (column / 59 - 0.5) ** 2)
    sensitivity = fall[..., np.newaxis] * [1, 0.8, 0.6]
    even = np.full((*SIZE, 3), 1000.0)
    found = develop([64 + even * sensitivity], black=64, flat=64 + 300 * sensitivity)
    assert np.ptp(found.values, axis=(0, 1)).max() < 1e-3
    assert np.allclose(
        found.values.mean(axis=(0, 1), dtype=float),
        (even * sensitivity).mean(axis=(0, 1)),
        rtol=1e-5,
    )


def test_pixels_where_the_flat_field_is_dark_or_saturated_count_as_saturated():
    flat = np.full((*SIZE, 3), 100, np.uint8)
    flat[7, 8], flat[9, 9, 1] = 0, 255
    found = develop([LIGHT], flat=flat)
    assert np.argwhere(found.saturated).tolist() == [[7, 8], [9, 9]]
    assert np.isfinite(found.values).all()
    with pytest.raises(PhotographError, match=r"flat field.* saturated"):
        develop([LIGHT], flat=np.full((*SIZE, 3), 255, np.uint8))


def test_saturation_is_the_top_code_of_integers_or_what_is_said():
    counts = np.arange(4080, 4096, dtype=np.uint16).reshape(4, 4)
    assert sensor_image(counts, "y").saturated.sum() == 1
    assert sensor_image(counts - 1, "y").saturated.sum() == 0  # no converter ends at 4094
    assert sensor_image(counts.astype(float), "y").saturated.sum() == 0
    assert sensor_image(counts.astype(float), "y", white=4090).saturated.sum() == 6


def test_a_mask_of_the_sensor_leaves_out_each_cell_that_it_touches():
    mask = np.ones((8, 12), bool)
    mask[3, 7] = False
    cells = mask_of_pixels(mask, sensor_image(np.ones((4, 6, 3)), "y", cell=2))
    assert np.argwhere(~cells).tolist() == [[1, 3]]
