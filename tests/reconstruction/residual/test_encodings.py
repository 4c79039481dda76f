"""Photographs that came encoded for screens."""

import numpy as np
import pytest
from periscopy_sim.reconstruction.residual.encodings import (
    BETTER,
    ENCODINGS,
    better_encoding,
    seen_recoded,
)

from periscopy_sim.storage.formats.srgb import srgb_encode

RNG = np.random.default_rng(0)
LIGHT = RNG.uniform(0.3, 0.9, (3, 20, 24))


def test_each_encoding_put_right_is_linear_light_up_to_a_scale():
    for wrong, name in ((srgb_encode(LIGHT), "is encoded"), (LIGHT**2.2, "was linear")):
        seen = seen_recoded(wrong)
        (right,) = (light for told, light in seen.items() if told.startswith(name))
        scale = np.sum(right * LIGHT) / np.sum(LIGHT**2)
        assert np.abs(right / scale / LIGHT - 1).max() < 0.04


def test_small_changes_about_the_mean_keep_their_size_and_left_out_pixels_stay_so():
    light = 0.5 + 1e-4 * RNG.standard_normal((3, 20, 24))
    light[:, 0] = np.nan
    for seen in seen_recoded(light).values():
        assert np.isnan(seen[:, 0]).all()
        assert np.nanstd(seen) == pytest.approx(np.nanstd(light), rel=1e-2)


def test_dark_frames_negatives_stay_negative():
    light = LIGHT.copy()
    light[:, 0, 0] = -0.01
    assert all((seen[:, 0, 0] < 0).all() for seen in seen_recoded(light).values())


@pytest.mark.parametrize(("left", "is_named"), [(0.99 * BETTER, True), (1.01 * BETTER, False)])
def test_an_encoding_is_named_where_it_leaves_much_less(left, is_named):
    for name in ENCODINGS:
        others = dict.fromkeys(ENCODINGS, 2.0) | {name: left}
        assert better_encoding(1.0, others) == (name if is_named else "")
