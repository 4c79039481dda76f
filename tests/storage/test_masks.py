"""Masks in every format, and what is no mask."""

import numpy as np
import OpenEXR
import png
import pytest
import tifffile
from PIL import Image

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.photographs import read_mask
from periscopy_sim.storage.pictures import write_png

SHAPE = (7, 9)
MASK = np.random.default_rng(3).random(SHAPE) > 0.4
MASK[0, 0], MASK[-1, -1] = False, True


def colour(values):
    return np.repeat(values[..., None], 3, axis=2)


def png_of(bits, planes=1):
    def write(path):
        values = np.where(MASK, 2**bits - 1, 0)
        rows = np.repeat(values, planes, axis=1).tolist()
        writer = png.Writer(9, 7, greyscale=planes == 1, bitdepth=bits)
        with path.open("wb") as stream:
            writer.write(stream, rows)

    return write


def grey_exr(path):
    channels = {"Y": np.ascontiguousarray(MASK, np.float16)}
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))


def palette(path):
    picture = Image.fromarray(MASK.astype(np.uint8), "P")
    picture.putpalette([0, 0, 0, 255, 255, 255])
    picture.save(path)


FORMS = {
    "1-bit.png": png_of(1),
    "deep-colour.png": png_of(16, planes=3),
    "palette.png": palette,
    "ours.png": lambda path: write_png(path, colour(MASK), {}),
    "dim.png": lambda path: Image.fromarray((40 * MASK + 10).astype(np.uint8)).save(path),
    "grey.jpg": lambda path: Image.fromarray((255 * MASK).astype(np.uint8)).save(path, quality=98),
    "16-bit.tif": lambda path: tifffile.imwrite(path, (60000 * MASK).astype(">u2")),
    "grey.exr": grey_exr,
    "truth.npy": lambda path: np.save(path, MASK),
    "huge.npy": lambda path: np.save(path, np.where(MASK, 2**64 - 1, 0).astype(np.uint64)),
    "mask.npz": lambda path: np.savez(path, mask=MASK, photograph=np.zeros(3)),
}


@pytest.mark.parametrize("name", FORMS)
def test_bright_is_used_and_black_left_out(name, tmp_path):
    FORMS[name](tmp_path / name)
    mask = read_mask(tmp_path / name, SHAPE)
    assert mask.dtype == bool and mask.shape == SHAPE
    np.testing.assert_array_equal(mask, MASK)


def test_bright_is_above_half_of_the_largest_value(tmp_path):
    values = np.full(SHAPE, 200.0)
    values[0, :4] = 0, 100, 100.001, 150
    np.save(tmp_path / "m.npy", values)
    assert read_mask(tmp_path / "m.npy", SHAPE)[0, :4].tolist() == [False, False, True, True]


def test_what_is_transparent_is_left_out(tmp_path):
    layers = np.stack([np.full(SHAPE, 255), 255 * MASK], axis=-1).astype(np.uint8)
    Image.fromarray(layers).save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", SHAPE), MASK)


UNFIT = [
    np.zeros(SHAPE),
    np.full(SHAPE, -1.0),
    np.where(MASK, np.nan, 1.0),
    np.where(MASK, np.inf, 1.0),
    np.stack([MASK, MASK, ~MASK], axis=-1).astype(float),
    MASK.T,
    MASK.ravel(),
    np.full(SHAPE, "a"),
]


@pytest.mark.parametrize("values", UNFIT)
def test_what_is_no_mask_is_refused(values, tmp_path):
    np.save(tmp_path / "m.npy", values)
    with pytest.raises(PhotographError, match=r"m\.npy: "):
        read_mask(tmp_path / "m.npy", SHAPE)
