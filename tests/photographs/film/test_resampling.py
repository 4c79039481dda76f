import numpy as np
import pytest

from periscopy_sim.photographs.film.resampling import (
    Flaw,
    average_blocks,
    average_quadrilaterals,
)

RNG = np.random.default_rng(5)
IMAGE = RNG.uniform(1, 2, (12, 18, 3)).astype(np.float32)
SOUND = np.zeros(IMAGE.shape[:2], np.uint8)


def grid(rows, columns, height, width):
    """Corners of equal boxes that fill an image."""
    row, column = np.meshgrid(
        np.linspace(0, height, rows + 1), np.linspace(0, width, columns + 1), indexing="ij"
    )
    return np.stack([column, row], axis=-1)


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


def test_whole_blocks_average_alike_both_ways():
    blocks = average_blocks(IMAGE, SOUND, (4, 6))
    quads = average_quadrilaterals(IMAGE, SOUND, grid(4, 6, 12, 18))
    for found in (blocks, quads):
        assert np.allclose(found.values, IMAGE.reshape(4, 3, 6, 3, 3).mean(axis=(1, 3)), rtol=1e-6)
        assert found.used.all() and np.allclose(found.measured, 1)


@pytest.mark.parametrize("seed", range(3))
def test_slanted_quadrilaterals_weight_pixels_by_the_area_in_them(seed):
    rng = np.random.default_rng(seed)
    turn = rng.normal(0, 0.4, (2, 2)) + np.eye(2)
    turn *= np.sqrt(0.3 / abs(np.linalg.det(turn)))
    corners = (grid(5, 7, 12, 18) - [9, 6]) @ turn * 0.6 + [9, 6]
    found = average_quadrilaterals(IMAGE, SOUND, corners)
    inside = ~found.outside
    assert inside.any()
    expected = sampled(IMAGE, np.clip(corners, 0, [17.99, 11.99]), 400)
    # Of 400 x 400 points some 1e-2 lie beside a border; of a value's range that leaves 1e-3.
    assert np.abs(found.values - expected)[inside].max() < 5e-3


def test_a_turned_grid_covers_all_of_the_image_once():
    """Light is kept: areas times means sum to the image's own sum, whatever the grid."""
    corners = (grid(30, 30, 40, 40) - [20, 20]) @ [[0.8, 0.6], [-0.6, 0.8]] + [9, 6]
    found = average_quadrilaterals(IMAGE, SOUND, corners)
    area = (40 / 30) ** 2
    values = np.where(found.measured[..., None] > 0, found.values, 0)
    total = np.sum(values * found.measured[..., None], axis=(0, 1)) * area
    assert np.allclose(total, IMAGE.sum(axis=(0, 1)), rtol=1e-6)


def test_new_pixels_that_reach_out_are_outside():
    found = average_quadrilaterals(IMAGE, SOUND, grid(4, 6, 12, 18) + np.array([0.5, 0]))
    assert found.outside.sum() == 4 and found.outside[:, -1].all()
    assert np.allclose(found.covered[:, -1], 1 - 0.5 / 3)
    far = average_quadrilaterals(IMAGE, SOUND, grid(2, 2, 2, 2) + 100)
    assert far.outside.all() and np.isnan(far.values).all() and not far.used.any()


@pytest.mark.parametrize("by", ["blocks", "quadrilaterals"])
def test_flaws_spoil_new_pixels_but_single_defects_are_left_out(by):
    flaws = SOUND.copy()
    flaws[0, 0], flaws[4, 4], flaws[8, 8] = Flaw.SATURATED, Flaw.MASKED, Flaw.DEFECTIVE
    flaws[9:12, 0:2] = Flaw.DEFECTIVE  # six of nine
    image = np.where(flaws[..., None], np.float32(1e6), IMAGE)
    if by == "blocks":
        found = average_blocks(image, flaws, (4, 6))
    else:
        found = average_quadrilaterals(image, flaws, grid(4, 6, 12, 18))
    assert np.argwhere(~found.used).tolist() == [[0, 0], [1, 1], [3, 0]]
    block, sound = IMAGE[6:9, 6:9].reshape(9, 3), np.arange(9) != 8
    assert np.allclose(found.values[2, 2], block[sound].mean(axis=0), rtol=1e-6)
    assert found.values[found.used].max() < 2.01
    assert found.flaws[0, 0] == Flaw.SATURATED and found.flaws[3, 0] == Flaw.DEFECTIVE


def test_noise_of_neighbours_is_nearly_independent():
    """No interpolation: only pixels on borders are shared."""
    noise = np.random.default_rng(1).standard_normal((400, 400, 1)).astype(np.float32)
    turned = (grid(40, 40, 320, 320) - 160) @ [[0.9, 0.3], [-0.3, 0.9]] + 200
    found = average_quadrilaterals(noise, np.zeros((400, 400), np.uint8), turned).values[..., 0]
    correlation = np.mean(found[1:] * found[:-1]) / np.mean(found**2)
    assert (
        abs(correlation) < 0.12
    )  # a pixel in eight is on a border; 1560 pairs, standard error 0.025
