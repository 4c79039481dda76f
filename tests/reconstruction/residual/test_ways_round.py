"""Photographs that are mirrored, or turned."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.residual.ways_round import (
    BETTER,
    WAYS,
    better_way,
    seen_by_way,
)


@pytest.mark.parametrize(
    ("left", "way"), [(0.99 * BETTER, "mirrored top to bottom"), (1.01 * BETTER, "")]
)
def test_a_way_round_is_named_where_it_leaves_much_less(left, way):
    others = dict.fromkeys(WAYS, 2.0) | {"mirrored top to bottom": left}
    assert better_way(1.0, others) == way


def test_light_is_seen_mirrored_and_turned():
    light = np.arange(24.0).reshape(2, 3, 4)
    seen = seen_by_way(light)
    np.testing.assert_array_equal(seen["mirrored left to right"], np.flip(light, 2))
    np.testing.assert_array_equal(seen["mirrored top to bottom"], np.flip(light, 1))
    np.testing.assert_array_equal(seen["turned by half a circle"], np.flip(light, (1, 2)))


def test_the_nearest_pixel_stands_in_for_one_that_is_left_out():
    light = np.tile(np.arange(12.0).reshape(3, 4), (2, 1, 1))
    light[:, :, 0] = np.nan
    seen = seen_by_way(light)["mirrored left to right"]
    np.testing.assert_array_equal(seen[0, 0], [3, 2, 1, 1])
