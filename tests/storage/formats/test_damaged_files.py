"""Every format, cut short, with single bits flipped and with numbers that break programs.

Each is a photograph, or one clear line.
"""

import io
import struct
import zipfile
import zlib

import numpy as np
import OpenEXR
import png
import pytest
import tifffile
from PIL import Image

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.photographs import read_mask, read_photograph
from periscopy_sim.storage.pictures import read_hidden_image
from periscopy_sim.storage.sequences import open_frames

SHAPE = (6, 5)
LIGHT = np.random.default_rng(8).integers(1, 9, (*SHAPE, 3)).astype(np.float32) / 8
COUNTS = (LIGHT * 65535).astype(np.uint16)
CODES = (LIGHT * 255).astype(np.uint8)


def save_tiled_exr(path):
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    with OpenEXR.File(header, {"RGB": LIGHT.copy()}) as file:
        file.write(str(path))


def save_tiff(path, values, **options):
    tifffile.imwrite(path, values, photometric="rgb", **options)


WRITERS = {
    "exr": lambda path: write_exr(path, LIGHT, {"scene": "chair", "sbr": 0.5}),
    "tiled exr": save_tiled_exr,
    "npy": lambda path: np.save(path, LIGHT),
    "npz": lambda path: np.savez(path, photograph=LIGHT),
    "16-bit png": lambda path: png.from_array(COUNTS.reshape(6, -1), "RGB;16").save(path),
    "8-bit png": lambda path: Image.fromarray(CODES).save(path),
    "jpg": lambda path: Image.fromarray(CODES).save(path),
    "16-bit tif": lambda path: save_tiff(path, COUNTS),
    "tiled float tif": lambda path: save_tiff(path, LIGHT, tile=(16, 16)),
    "8-bit tif": lambda path: Image.fromarray(CODES).save(path, compression="tiff_lzw"),
}
CHECKSUMMED = {"npz", "16-bit png", "8-bit png"}


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
        harmless = kind in ("8-bit tif", "8-bit png", "jpg")  # tags or marks at the end
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


EXTREMES = [0, 1, *(1 << bits for bits in (7, 15, 16, 24, 31, 32, 62, 63))]
EXTREMES += [each - 1 for each in EXTREMES[2:]] + [2**64 - 1]
PNG = b"\x89PNG\r\n\x1a\n"


def edited(data, rng):
    """Set an integer, more often of the header, to a number at which programs break."""
    width = int(rng.choice([1, 2, 4, 4, 8]))
    reach = max(1, len(data) - width + 1)
    place = int(rng.integers(min(reach, 512) if rng.random() < 0.7 else reach))
    number = int(rng.choice(np.array(EXTREMES, object))) % (1 << 8 * width)
    order = "little" if rng.random() < 0.5 else "big"
    return data[:place] + number.to_bytes(width, order) + data[place + width :]


def resealed(content, damage, rng):
    """Damage what compression and checksums protect, and set these right again."""
    if content.startswith(b"PK"):
        packed = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(packed, "w") as new:
            for name in old.namelist():
                new.writestr(name, damage(old.read(name)))
        return packed.getvalue()
    if not content.startswith(PNG):
        return damage(content)
    chunks, position = [], len(PNG)
    while position < len(content):
        (size,) = struct.unpack_from(">I", content, position)
        chunks.append(content[position + 4 : position + 8 + size])  # its kind and its body
        position += 12 + size
    chosen = int(rng.integers(len(chunks)))
    kind, body = chunks[chosen][:4], chunks[chosen][4:]
    body = zlib.compress(damage(zlib.decompress(body))) if kind == b"IDAT" else damage(body)
    chunks[chosen] = kind + body
    return PNG + b"".join(
        struct.pack(">I", len(each) - 4) + each + struct.pack(">I", zlib.crc32(each))
        for each in chunks
    )


READERS = {
    "photograph": lambda path: [read_photograph(path, SHAPE).values],
    "hidden image": lambda path: [read_hidden_image(path, (2, 3))],
    "mask": lambda path: [read_mask(path, SHAPE).astype(float)],
    "frames": lambda path: [frame.values for frame in open_frames(path, SHAPE)],
}


@pytest.mark.filterwarnings("ignore")
def test_numbers_that_break_programs_are_read_or_rejected(sound):
    _, content, _, path = sound
    rng = np.random.default_rng(4)
    for reader in [*READERS.values()] * 50:
        damage = edited(content, rng) if rng.random() < 0.4 else None
        path.unlink(missing_ok=True)
        path.write_bytes(damage or resealed(content, lambda data: edited(data, rng), rng))
        try:
            values = reader(path)
        except PeriscopyError as error:
            assert str(error).isprintable() and len(str(error)) < 1000
        else:
            assert all(np.isfinite(each).all() for each in values)
