import numpy as np
import pytest

from periscopy_sim.photographs.resampling import DEFECTIVE, EXCLUDED, AreaMap, block_corners

IMAGE = np.random.default_rng(5).uniform(1, 2, (12, 18, 3)).astype(np.float32)
SOUND = np.zeros(IMAGE.shape[:2], np.uint8)


def average_areas(image, states, corners):
    areas = AreaMap(states, corners)
    return areas.average(image), areas.usable


def sampled(image, corners, count):
    """Means over quadrilaterals by points that fill them evenly: parallelograms only."""
    part = (np.arange(count) + 0.5) / count
    down, across = part[:, None, None], part[None, :, None]
    rows, columns = corners.shape[0] - 1, corners.shape[1] - 1
    means = np.empty((rows, columns, image.shape[2]))
    for i in range(rows):
        for j in range(columns):
            a, b, c = corners[i, j], corners[i, j + 1], corners[i + 1, j]
            places = np.floor(a + across * (b - a) + down * (c - a)).astype(int)
            means[i, j] = image[places[..., 1], places[..., 0]].mean(axis=(0, 1))
    return means


@pytest.mark.parametrize("seed", range(3))
def test_slanted_quadrilaterals_weight_pixels_by_the_area_in_them(seed):
    rng = np.random.default_rng(seed)
    turn = rng.normal(0, 0.4, (2, 2)) + np.eye(2)
    turn *= np.sqrt(0.3 / abs(np.linalg.det(turn)))
    corners = (block_corners((12, 18), (5, 7)) - [9, 6]) @ turn * 0.6 + [9, 6]
    values, inside = average_areas(IMAGE, SOUND, corners)
    assert inside.any()
    expected = sampled(IMAGE, np.clip(corners, 0, [17.99, 11.99]), 400)
    # Of 400 x 400 points some 1e-2 lie beside a border; of a value's range that leaves 1e-3.
    assert np.abs(values - expected)[inside].max() < 5e-3


def test_a_turned_grid_covers_all_of_the_image_once():
    """Light is kept: areas times means sum to the image's own sum, whatever the grid."""
    image = np.pad(IMAGE, ((30, 30), (30, 30), (0, 0)))
    corners = (block_corners((40, 40), (30, 30)) - 20) @ [[0.8, 0.6], [-0.6, 0.8]] + [39, 36]
    values, usable = average_areas(image, np.zeros(image.shape[:2], np.uint8), corners)
    assert usable.all()
    total = values.sum(axis=(0, 1)) * (40 / 30) ** 2
    assert np.allclose(total, IMAGE.sum(axis=(0, 1)), rtol=1e-6)


def test_new_pixels_that_reach_out_are_not_used():
    moved = block_corners((12, 18), (4, 6)) + np.array([0.5, 0])
    values, usable = average_areas(IMAGE, SOUND, moved)
    assert not usable[:, -1].any() and usable[:, :-1].all()
    assert np.isfinite(values).all()
    values, usable = average_areas(IMAGE, SOUND, block_corners((2, 2), (2, 2)) + 100)
    assert not usable.any() and not values.any()


def test_averages_leave_out_what_is_not_sound():
    states = SOUND.copy()
    states[0, 0], states[4, 4], states[8, 8] = EXCLUDED, EXCLUDED, DEFECTIVE
    states[9:12, 0:2] = DEFECTIVE  # six of nine
    image = np.where(states[..., None], np.float32(1e6), IMAGE)
    values, usable = average_areas(image, states, block_corners((12, 18), (4, 6)))
    assert np.argwhere(~usable).tolist() == [[0, 0], [1, 1], [3, 0]]
    block, sound = IMAGE[6:9, 6:9].reshape(9, 3), np.arange(9) != 8
    assert np.allclose(values[2, 2], block[sound].mean(axis=0), rtol=1e-6)
    assert values.max() < 2.01


def test_noise_of_neighbours_is_nearly_independent():
    """No interpolation: a pixel in eight is on a border; 1560 pairs have a standard error 0.025."""
    noise = np.random.default_rng(1).standard_normal((400, 400, 1)).astype(np.float32)
    corners = (block_corners((320, 320), (40, 40)) - 160) @ [[0.9, 0.3], [-0.3, 0.9]] + 200
    values, _ = average_areas(noise, np.zeros((400, 400), np.uint8), corners)
    assert abs(np.mean(values[1:] * values[:-1]) / np.mean(values**2)) < 0.12


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_codes_are_averaged_as_their_light_and_saturation_shows(dtype):
    rng = np.random.default_rng(3)
    codes = rng.integers(0, 200, IMAGE.shape).astype(dtype)
    table = np.linspace(0, 1, 256, dtype=np.float32) ** 2
    infinite = np.append(table[:255], np.float32(np.inf))
    corners = block_corners((12, 18), (5, 7)) @ [[0.9, 0.2], [-0.1, 1.1]] + [-0.5, 0.3]
    states = SOUND.copy()
    states[3, 7], states[5:9, 12:] = DEFECTIVE, EXCLUDED
    areas = AreaMap(states, corners)
    codes[6, 5], codes[6, 13] = 255, 255  # the second is masked
    values = areas.average(codes, infinite)
    expected, usable = average_areas(table[codes], states, corners)
    full = np.isinf(values).any(axis=2)
    np.testing.assert_array_equal(areas.usable, usable)
    np.testing.assert_allclose(values[~full], expected[~full], atol=1e-6)
    saturated = EXCLUDED * ((codes == 255).any(axis=2) & (states == 0))
    met = average_areas(table[codes], saturated.astype(np.uint8), corners)[1]
    everywhere = average_areas(table[codes], SOUND, corners)[1]
    np.testing.assert_array_equal(full & everywhere, everywhere & ~met)
    assert 0 < full.sum() < 9
