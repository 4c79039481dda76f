"""Every format, cut short and with single bits flipped: a photograph or one clear line."""

import io
import zipfile

import numpy as np
import OpenEXR
import png
import pytest
import scipy.io
import tifffile
from PIL import Image

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.photographs import read_photograph

SHAPE = (6, 5)
LIGHT = (np.random.default_rng(8).integers(1, 9, (*SHAPE, 3)) / 8).astype(
    np.float32
)  # few levels: it compresses
COUNTS = (LIGHT * 65535).astype(np.uint16)
CODES = (LIGHT * 255).astype(np.uint8)


def save_tiled_exr(path):
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    with OpenEXR.File(header, {"RGB": LIGHT.copy()}) as file:
        file.write(str(path))


def save_16_bit_png(path):
    with path.open("wb") as stream:
        writer = png.Writer(SHAPE[1], SHAPE[0], greyscale=False, bitdepth=16)
        writer.write(stream, COUNTS.reshape(SHAPE[0], -1).tolist())


def save_matlab(path, compressed):
    image = np.kron(COUNTS[..., 0], np.ones((2, 2))).astype(np.uint16)
    fields = {"image": image, "shutter_speed": 0.5, "iterations": 4.0}
    scipy.io.savemat(path, fields, do_compression=compressed)


def save_tiff(path, values, **options):
    tifffile.imwrite(path, values, photometric="rgb", **options)


WRITERS = {
    "exr": lambda path: write_exr(path, LIGHT, {"scene": "chair", "sbr": 0.5}),
    "tiled exr": save_tiled_exr,
    "npy": lambda path: np.save(path, LIGHT),
    "npz": lambda path: np.savez(path, photograph=LIGHT),
    "compressed npz": lambda path: np.savez_compressed(path, photograph=LIGHT),
    "16-bit png": save_16_bit_png,
    "8-bit png": lambda path: Image.fromarray(CODES).save(path),
    "jpg": lambda path: Image.fromarray(CODES).save(path),
    "16-bit tif": lambda path: save_tiff(path, COUNTS),
    "deflated tif": lambda path: save_tiff(path, COUNTS, compression="zlib"),
    "tiled float tif": lambda path: save_tiff(path, LIGHT, tile=(16, 16)),
    "8-bit tif": lambda path: Image.fromarray(CODES).save(path, compression="tiff_lzw"),
    "mat": lambda path: save_matlab(path, compressed=False),
    "compressed mat": lambda path: save_matlab(path, compressed=True),
}
CHECKSUMMED = {"npz", "compressed npz", "16-bit png", "8-bit png", "compressed mat"}


@pytest.fixture(params=sorted(WRITERS))
def sound(request, tmp_path):
    """Kind, contents and values of a sound file, and a path to damage it at."""
    suffix = request.param.rpartition(" ")[2]
    path = tmp_path / f"sound.{suffix}"
    WRITERS[request.param](path)
    values = read_photograph(path, SHAPE).values
    return request.param, path.read_bytes(), values, tmp_path / f"damaged.{suffix}"


def outcome(path, content):
    """Values that the content is read as, or None where it is refused as it should be."""
    path.unlink(missing_ok=True)  # much faster than to overwrite, on a journalling file system
    path.write_bytes(content)
    try:
        values = read_photograph(path, SHAPE).values
    except PhotographError as error:
        assert str(path) in str(error) and "\n" not in str(error)
        return None
    assert values.shape == (*SHAPE, 3) and np.isfinite(values).all()
    return values


def test_file_cut_short_is_refused_quietly(sound, capfd):
    kind, content, values, path = sound
    for length in {*range(0, len(content), 1 + len(content) // 60), len(content) - 1}:
        found = outcome(path, content[:length])
        harmless = kind in ("8-bit tif", "jpg")  # a tag or an end mark that no one reads
        assert found is None or (harmless and np.array_equal(found, values)), length
    assert capfd.readouterr() == ("", "")


def test_tile_that_lacks_its_last_rows_is_refused(tmp_path):
    save_tiff(tmp_path / "y.tif", LIGHT, tile=(16, 16))
    content = (tmp_path / "y.tif").read_bytes()
    for rows in range(1, 16):
        assert outcome(tmp_path / "cut.tif", content[: -rows * 16 * 3 * 4]) is None


def test_flipped_bit_never_surprises(sound, capfd):
    kind, content, values, path = sound
    rng, refused = np.random.default_rng(1), 0
    for position in range(0, len(content), 1 + len(content) // 150):
        damaged = bytearray(content)
        damaged[position] ^= 1 << rng.integers(8)
        found = outcome(path, bytes(damaged))
        refused += found is None
        if kind in CHECKSUMMED:
            assert found is None or np.array_equal(found, values), position
    assert refused > 0
    assert capfd.readouterr() == ("", "")


def test_noise_behind_each_signature_is_refused(sound):
    _, content, _, path = sound
    assert outcome(path, content[:8] + np.random.default_rng(2).bytes(400)) is None


def npy_header(shape, dtype="<f8"):
    stream = io.BytesIO()
    header = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_2_0(stream, header)
    return stream.getvalue()


def png_of_size(columns, rows):
    stream = io.BytesIO()
    png.write_chunks(
        stream,
        [
            (b"IHDR", np.array([columns, rows], ">u4").tobytes() + bytes([16, 2, 0, 0, 0])),
            (b"IDAT", b""),
            (b"IEND", b""),
        ],
    )
    return stream.getvalue()


def tiff_of_size(columns, rows):
    stream = io.BytesIO()
    tifffile.imwrite(stream, COUNTS, photometric="rgb")
    content = bytearray(stream.getvalue())
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        tags = file.pages[0].tags
        for name, value in (("ImageWidth", columns), ("ImageLength", rows)):
            offset = tags[name].valueoffset
            content[offset : offset + 4] = np.array(value, "<u4").tobytes()
    return bytes(content)


def npz_of(member):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("photograph.npy", member)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("y.npy", npy_header((1 << 20, 1 << 20, 3))),
        ("y.npy", npy_header((1 << 62, 1 << 62))),
        ("y.npy", npy_header((-6, -5))),
        ("y.npz", npz_of(npy_header((1 << 20, 1 << 20, 3)))),
        ("y.png", png_of_size(1 << 20, 1 << 20)),
        ("y.tif", tiff_of_size(1 << 20, 1 << 20)),
    ],
)
def test_absurd_size_is_refused_before_it_is_allocated(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(PhotographError, match="announces"):
        read_photograph(tmp_path / name, SHAPE)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_archive_whose_checksum_differs_is_refused(tmp_path, save):
    values = np.random.default_rng(0).random((*SHAPE, 3))
    save(tmp_path / "y.npz", photograph=values)
    content = bytearray((tmp_path / "y.npz").read_bytes())
    content[content.index(b"PK\x01\x02") + 16] ^= 1
    assert outcome(tmp_path / "y.npz", bytes(content)) is None


def test_encrypted_and_empty_archives_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "empty.npz", "w"):
        pass
    with pytest.raises(PhotographError, match="only none at all"):
        read_photograph(tmp_path / "empty.npz", SHAPE)
    content = bytearray(npz_of(npy_header(SHAPE) + bytes(240)))
    content[6] |= 1  # the flag for encryption, in both headers
    content[content.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "locked.npz").write_bytes(content)
    with pytest.raises(PhotographError, match="encrypted"):
        read_photograph(tmp_path / "locked.npz", SHAPE)
