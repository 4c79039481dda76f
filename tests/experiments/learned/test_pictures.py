"""Pictures to learn from: of one size, not dark, and none of the benchmark's."""

import numpy as np
import pytest

pytest.importorskip("skimage")

from experiments.learned import pictures
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.formats.srgb import srgb_encode


def test_crops_and_leaves_are_of_one_size_and_in_range():
    rng = np.random.default_rng(0)
    whole = pictures.photograph("rocket")
    for picture in (pictures.crop(whole, rng), pictures.dead_leaves(rng)):
        assert picture.shape == (*pictures.SIZE, 3)
        assert picture.min() >= 0 and picture.max() <= 1 and picture.std() > 0.01


def test_a_panoramas_lamps_are_white_and_the_rest_keeps_its_contrast(tmp_path):
    linear = np.full((10, 20, 3), 0.25, np.float32)
    linear[0] = 1.0
    linear[0, 0] = 300.0
    write_exr(tmp_path / "a.exr", linear, {})
    shown = pictures.photographs_of(tmp_path)["a.exr"]
    assert np.allclose(shown[0], 1)
    assert np.allclose(shown[1:], srgb_encode(0.25), atol=1e-3)
