"""Photographs that came mirrored or rotated."""

import numpy as np
import pytest
from periscopy_sim.reconstruction.residual.orientations import (
    BETTER,
    FLIPPED,
    better_orientation,
    seen_flipped,
)


@pytest.mark.parametrize(
    ("left", "named"), [(0.99 * BETTER, "mirrored top to bottom"), (1.01 * BETTER, "")]
)
def test_an_orientation_is_named_where_it_leaves_much_less(left, named):
    others = dict.fromkeys(FLIPPED, 2.0) | {"mirrored top to bottom": left}
    assert better_orientation(1.0, others) == named


def test_light_is_seen_mirrored_and_rotated():
    light = np.arange(24.0).reshape(2, 3, 4)
    seen = seen_flipped(light)
    np.testing.assert_array_equal(seen["mirrored left to right"], np.flip(light, 2))
    np.testing.assert_array_equal(seen["mirrored top to bottom"], np.flip(light, 1))
    np.testing.assert_array_equal(seen["rotated by 180 degrees"], np.flip(light, (1, 2)))


def test_the_nearest_pixel_stands_in_for_one_that_is_left_out():
    light = np.tile(np.arange(80.0).reshape(2, 40), (2, 1, 1))
    light[:, :, 0] = np.nan
    seen = seen_flipped(light)["mirrored left to right"]
    np.testing.assert_array_equal(seen[0, 0, -3:], [2, 1, 1])


def test_where_a_mask_leaves_out_one_side_its_mirror_image_is_not_looked_at():
    light = np.ones((3, 20, 24))
    light[:, :, :6] = np.nan
    assert list(seen_flipped(light)) == ["mirrored top to bottom"]
    assert better_orientation(1.0, {}) == ""


def test_orientations_that_are_explained_alike_are_named_both():
    left = {"mirrored left to right": 0.1, "mirrored top to bottom": 0.15, "rotated": 0.3}
    told = "mirrored left to right or mirrored top to bottom"
    assert better_orientation(1.0, left) == told
