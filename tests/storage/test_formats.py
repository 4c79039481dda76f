import sys
from functools import partial

import numpy as np
import OpenEXR
import png
import pytest
import tifffile
import zarr
from PIL import Image

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.storage.formats import FORMATS
from periscopy_sim.storage.photographs import open_frames, read_photograph, read_sensor_image
from periscopy_sim.storage.tables import read_colour_matrix
from tests.scenes.dng import write_dng

SHAPE = (24, 40)  # LibRaw reads nothing smaller than 22 pixels
V, U = np.meshgrid(np.linspace(0, 1, SHAPE[0]), np.linspace(0, 1, SHAPE[1]), indexing="ij")
LIGHT = np.stack([0.2 + 0.8 * U, 0.9 - 0.5 * V, 0.3 + 0.3 * U * V], axis=2).astype(np.float32)
"""Each corner and each channel differs, so that no turn and no swap gives the same picture."""
DEEP = np.rint(65535 * LIGHT).astype(np.uint16)
ENCODED = np.rint(255 * (1.055 * LIGHT ** (1 / 2.4) - 0.055)).astype(np.uint8)  # sRGB


def write_exr(path):
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": LIGHT}) as file:
        file.write(str(path))


def write_cells(path):
    """Write a mosaic whose 2 x 2 cells, RGGB, hold one pixel each."""
    mosaic = np.zeros((2 * SHAPE[0], 2 * SHAPE[1]), np.uint16)
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[row::2, column::2] = DEEP[..., channel] // 4
    write_dng(path, mosaic, black=(0,))


WRITERS = {  # by format, and how far a value of 1 may be off
    "camera raw": (write_cells, "y.dng", 1 / 16383),
    "EXR": (write_exr, "y.exr", 0),
    "NPY": (lambda path: np.save(path, LIGHT), "y.npy", 0),
    "NPZ": (lambda path: np.savez(path, photograph=LIGHT), "y.npz", 0),
    "PNG": (
        lambda path: png.from_array(DEEP.reshape(SHAPE[0], -1), "RGB;16").save(path),
        "y.png",
        1 / 65535,
    ),
    "TIFF": (lambda path: tifffile.imwrite(path, LIGHT, photometric="rgb"), "y.tif", 0),
    "JPEG": (
        lambda path: Image.fromarray(ENCODED).save(path, quality=100, subsampling=0),
        "y.jpg",
        0.03,
    ),
    "PNG of 8 bits": (lambda path: Image.fromarray(ENCODED).save(path), "y.png", 0.005),
    "TIFF of 16 bits": (
        lambda path: tifffile.imwrite(path, DEEP, photometric="rgb"),
        "y.tif",
        1 / 65535,
    ),
}


def test_every_format_is_written():
    assert {row.name for row in FORMATS} <= set(WRITERS)


@pytest.mark.parametrize("name", WRITERS)
def test_a_picture_is_the_same_photograph_in_every_format(name, tmp_path):
    write, file, error = WRITERS[name]
    if name == "camera raw":
        pytest.importorskip("rawpy")
    write(tmp_path / file)
    if name == "camera raw":
        values = read_sensor_image(tmp_path / file)[0].values
    else:
        values = read_photograph(tmp_path / file, SHAPE).values
    scale = {"camera raw": 16383}.get(name, 65535 if error == 1 / 65535 else 1)
    np.testing.assert_allclose(values / scale, LIGHT, atol=error + 1e-6)


def test_a_stack_of_zarr_is_the_same_photograph(tmp_path):
    group = zarr.create_group(tmp_path / "y.zarr", zarr_format=3)
    group.create_array("photograph", data=LIGHT[None], fill_value=np.nan)
    (frame,) = open_frames(tmp_path / "y.zarr", SHAPE)
    np.testing.assert_array_equal(frame.values, LIGHT)


def test_a_raw_file_without_its_library_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    file = tmp_path / "wall.dng"
    file.write_bytes(b"II*\0\10\0\0\0")
    for read in read_sensor_image, read_colour_matrix, partial(read_photograph, shape=(4, 4)):
        with pytest.raises(PeriscopyError, match=r"rawpy.*\[raw\]"):
            read(file)
