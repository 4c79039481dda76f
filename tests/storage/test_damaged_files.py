"""Every format, cut short and with single bits flipped.

Each is a photograph, or one clear line.
"""

import numpy as np
import png
import pytest
import tifffile
from PIL import Image

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.photographs import read_photograph
from periscopy_sim.storage.rasters import write_exr

SHAPE = (6, 5)
LIGHT = np.random.default_rng(8).integers(1, 9, (*SHAPE, 3)).astype(np.float32) / 8
COUNTS = (LIGHT * 65535).astype(np.uint16)
CODES = (LIGHT * 255).astype(np.uint8)


WRITERS = {
    "exr": lambda path: write_exr(path, LIGHT, {"scene": "chair", "sbr": 0.5}),
    "npy": lambda path: np.save(path, LIGHT),
    "npz": lambda path: np.savez(path, photograph=LIGHT),
    "16-bit png": lambda path: png.from_array(COUNTS.reshape(6, -1), "RGB;16").save(path),
    "jpg": lambda path: Image.fromarray(CODES).save(path),
    "16-bit tif": lambda path: tifffile.imwrite(path, COUNTS, photometric="rgb"),
    "8-bit tif": lambda path: Image.fromarray(CODES).save(path, compression="tiff_lzw"),
}
CHECKSUMMED = {"npz", "16-bit png"}


@pytest.fixture(params=sorted(WRITERS))
def sound(request, tmp_path):
    """Kind, contents and values of a sound file, and a path to damage it at."""
    suffix = request.param.rpartition(" ")[2]
    path = tmp_path / f"sound.{suffix}"
    WRITERS[request.param](path)
    values = read_photograph(path, SHAPE).values
    return request.param, path.read_bytes(), values, tmp_path / f"damaged.{suffix}"


def outcome(path, content):
    """Values that the content is read as, or None if it is rejected by one line."""
    path.unlink(missing_ok=True)  # much faster than to overwrite, on a journalling file system
    path.write_bytes(content)
    try:
        values = read_photograph(path, SHAPE).values
    except PhotographError as error:
        assert str(path) in str(error) and "\n" not in str(error)
        return None
    assert values.shape[:2] == SHAPE and np.isfinite(values).all()
    return values


@pytest.mark.filterwarnings("ignore")
def test_file_cut_short_is_rejected(sound):
    kind, content, values, path = sound
    for length in {*range(0, len(content), 1 + len(content) // 60), len(content) - 1}:
        result = outcome(path, content[:length])
        harmless = kind in ("8-bit tif", "jpg")  # tags or marks at the end
        assert result is None or (harmless and np.array_equal(result, values)), length
    assert outcome(path, content[:8] + np.random.default_rng(2).bytes(400)) is None


@pytest.mark.filterwarnings("ignore")
def test_flipped_bit_never_surprises(sound):
    kind, content, values, path = sound
    rng, rejected = np.random.default_rng(1), 0
    for position in range(0, len(content), 1 + len(content) // 150):
        damaged = bytearray(content)
        damaged[position] ^= 1 << rng.integers(8)
        result = outcome(path, bytes(damaged))
        rejected += result is None
        if kind in CHECKSUMMED:
            assert result is None or np.array_equal(result, values), position
    assert rejected > 0
