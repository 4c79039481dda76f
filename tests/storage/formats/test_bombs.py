"""Small files that announce much, or unpack to much: refused in little memory."""

import io
import struct
import tracemalloc
import zipfile
import zlib
from functools import cache

import numpy as np
import pytest
import tifffile
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec, GzipCodec

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.photographs import read_photograph
from periscopy_sim.storage.pictures import read_hidden_image
from periscopy_sim.storage.sequences.opening import open_frames

SHAPE = (6, 5)
MUCH = 3 << 26  # bytes: 200 MB
MODEST = 100 << 20


@pytest.fixture
def refusal():
    """Read in little memory what must be refused in one line, and give the line."""

    def run(read, *arguments):
        tracemalloc.start()
        try:
            with pytest.raises(PhotographError) as caught:
                read(*arguments)
            assert tracemalloc.get_traced_memory()[1] < MODEST
        finally:
            tracemalloc.stop()
        assert "\n" not in str(caught.value)
        return str(caught.value)

    return run


@cache
def zeros(window=15):
    deflate = zlib.compressobj(1, zlib.DEFLATED, window)
    pieces = [deflate.compress(bytes(1 << 20)) for _ in range(MUCH >> 20)]
    return b"".join(pieces) + deflate.flush()


def npy_header(shape, descr="<f8", length=None):
    text = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode() + b"\n"
    size = len(text) if length is None else length
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", size) + text


def npz(path, header, key="photograph"):
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open(f"{key}.npy", "w", force_zip64=True) as member,
    ):
        member.write(header)
        for _ in range(MUCH >> 20):
            member.write(bytes(1 << 20))
    return path


def png(columns, rows, depth, packed):
    def chunk(kind, body):
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", columns, rows, depth, 2, 0, 0, 0)
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", packed), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def test_npy_header_of_gigabytes_is_refused(refusal, tmp_path):
    for name, write in (
        ("y.npy", lambda path: path.write_bytes(npy_header(SHAPE, length=0xFFFFFFF0))),
        ("y.npz", lambda path: npz(path, npy_header(SHAPE, length=MUCH - 99))),
    ):
        write(tmp_path / name)
        assert "bytes of itself" in refusal(read_photograph, tmp_path / name, SHAPE)


@pytest.mark.parametrize("key", ["photograph", "hidden"])
def test_array_of_far_more_values_than_bytes_is_refused(refusal, tmp_path, key):
    header = npy_header((5000, 5000, 3))
    (tmp_path / "y.npy").write_bytes(header)
    npz(tmp_path / "y.npz", header, key)
    read = read_photograph if key == "photograph" else read_hidden_image
    for name in ("y.npy", "y.npz"):
        assert "for each byte" in refusal(read, tmp_path / name, SHAPE)


@pytest.mark.parametrize("depth", [8, 16])
def test_png_that_unpacks_to_more_than_it_announces_is_refused(refusal, tmp_path, depth):
    (tmp_path / "y.png").write_bytes(png(5, 6, depth, zeros()))
    for read in (read_photograph, read_hidden_image):
        assert "more pixels than its header announces" in refusal(read, tmp_path / "y.png", SHAPE)


def test_png_chunk_that_announces_gigabytes_is_refused(refusal, tmp_path):
    content = bytearray(png(5, 6, 16, zlib.compress(bytes(186))))
    content[33:37] = b"\x7f\xff\xff\xf0"
    (tmp_path / "y.png").write_bytes(content)
    assert "too short" in refusal(read_photograph, tmp_path / "y.png", SHAPE)


def test_large_image_of_few_bytes_is_refused(refusal, tmp_path):
    (tmp_path / "y.png").write_bytes(png(9000, 9000, 8, zeros()))
    assert "for each byte" in refusal(read_hidden_image, tmp_path / "y.png", SHAPE)


def test_image_longer_than_any_is_refused(refusal, tmp_path):
    np.save(tmp_path / "y.npy", np.ones((70_000, 1), np.float32))
    assert "70000 pixels long" in refusal(read_hidden_image, tmp_path / "y.npy", (2, 3))


def test_large_hidden_image_is_averaged_in_bands(tmp_path):
    # 4 of 12 MB of codes, which would be 96 MB as float64, and several times that on the way.
    codes = np.random.default_rng(0).integers(0, 256, (2000, 2000, 3), np.uint8)
    np.savez(tmp_path / "y.npz", hidden=codes)
    tracemalloc.start()
    found = read_hidden_image(tmp_path / "y.npz", (4, 5))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    encoded = codes.reshape(4, 500, 5, 400, 3) / 255
    light = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(found, light.mean(axis=(1, 3)), rtol=1e-10)
    assert peak < 2 * MODEST


def test_tiff_strip_that_unpacks_to_more_than_it_holds_is_refused(refusal, tmp_path):
    stream = io.BytesIO()
    tifffile.imwrite(stream, np.ones((*SHAPE, 3), np.uint16), photometric="rgb", compression="zlib")
    content, bomb = bytearray(stream.getvalue()), zeros()
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        tags = file.pages[0].tags
        for name, value in (("StripOffsets", len(content)), ("StripByteCounts", len(bomb))):
            offset = tags[name].offset
            content[offset + 2 : offset + 12] = struct.pack("<HII", 4, 1, value)
    (tmp_path / "y.tif").write_bytes(content + bomb)
    said = refusal(read_photograph, tmp_path / "y.tif", SHAPE)
    assert "more pixels than its header announces" in said


def test_tiff_whose_pages_run_in_a_circle_is_refused(refusal, tmp_path):
    tifffile.imwrite(tmp_path / "y.tif", np.ones((3, *SHAPE), np.uint16), photometric="minisblack")
    content = bytearray((tmp_path / "y.tif").read_bytes())
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        first, second = (file.pages[k].offset for k in (0, 1))
    for link in range(len(content) - 4):  # where a page tells of the second one
        if content[link : link + 4] == struct.pack("<I", second):
            content[link : link + 4] = struct.pack("<I", first)
    (tmp_path / "y.tif").write_bytes(content)
    assert "run in a circle" in refusal(read_photograph, tmp_path / "y.tif", SHAPE)


def test_tiff_of_another_packing_is_refused(refusal, tmp_path):
    stream = io.BytesIO()
    tifffile.imwrite(stream, np.ones((*SHAPE, 3), np.uint16), photometric="rgb")
    content = bytearray(stream.getvalue())
    with tifffile.TiffFile(io.BytesIO(content)) as file:
        offset = file.pages[0].tags["Compression"].valueoffset
    content[offset : offset + 2] = struct.pack("<H", 34925)
    (tmp_path / "y.tif").write_bytes(content)
    assert "is packed by LZMA; save it" in refusal(read_photograph, tmp_path / "y.tif", SHAPE)


@pytest.mark.parametrize("copies", [1, 5])
def test_matlab_variables_that_unpack_to_too_much_are_refused(tmp_path, copies):
    element = struct.pack("<II", 15, len(zeros())) + zeros()
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    (tmp_path / "y.mat").write_bytes(head + element * copies)
    tracemalloc.start()
    with pytest.raises(PhotographError, match="cut short or too large"):
        read_photograph(tmp_path / "y.mat", SHAPE)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 * MODEST  # 128 MB may be unpacked


@pytest.mark.parametrize("count", [10**6 + 1, 10**12, 1 << 62])
def test_stack_of_countless_frames_is_refused(refusal, tmp_path, count):
    header = npy_header((count, *SHAPE, 3), "<f4")
    with zipfile.ZipFile(tmp_path / "y.npz", "w") as archive:
        archive.writestr("photograph.npy", header)
    assert f"holds {count} frames" in refusal(open_frames, tmp_path / "y.npz", SHAPE)
    zarr.create_array(
        tmp_path / "y.zarr", shape=(count, *SHAPE, 3), chunks=(1, *SHAPE, 3), dtype="f4"
    )
    assert f"holds {count} frames" in refusal(open_frames, tmp_path / "y.zarr", SHAPE)


def test_archive_of_fewer_than_no_frames_is_refused(refusal, tmp_path):
    with zipfile.ZipFile(tmp_path / "y.npz", "w") as archive:
        archive.writestr("photograph.npy", npy_header((-1, *SHAPE, 3)))
    assert "holds -1 frames" in refusal(open_frames, tmp_path / "y.npz", SHAPE)


@pytest.mark.parametrize(
    ("codec", "stored"),
    [
        (GzipCodec(), None),
        (BloscCodec(), b"\x02\x01\x01\x04" + b"\xff\xff\xff\x7f" * 2 + b"\x40" + bytes(51)),
    ],
)
def test_zarr_chunk_that_unpacks_to_too_much_is_refused(refusal, tmp_path, codec, stored):
    clip = np.ones((3, *SHAPE, 3), np.float32)
    zarr.create_array(tmp_path / "y.zarr", data=clip, chunks=clip.shape, compressors=codec)
    assert len(list(open_frames(tmp_path / "y.zarr", SHAPE))) == 3
    (tmp_path / "y.zarr" / "c" / "0" / "0" / "0" / "0").write_bytes(stored or zeros(31))
    assert "the chunk '0' is" in refusal(open_frames, tmp_path / "y.zarr", SHAPE)


def test_blosc_chunk_that_points_past_its_end_is_refused(tmp_path):
    clip = np.ones((3, *SHAPE, 3), np.float32)
    zarr.create_array(tmp_path / "y.zarr", data=clip, chunks=clip.shape, compressors=BloscCodec())
    chunk = tmp_path / "y.zarr" / "c" / "0" / "0" / "0" / "0"
    sound = chunk.read_bytes()
    for position in range(12, 16):  # of its length
        for bit in range(8):
            damaged = bytearray(sound)
            damaged[position] ^= 1 << bit
            chunk.write_bytes(damaged)
            with pytest.raises(PhotographError, match="the chunk '0' is damaged"):
                open_frames(tmp_path / "y.zarr", SHAPE)


def test_blosc_where_its_lengths_cannot_be_looked_at_is_refused(tmp_path):
    clip = np.ones((4, *SHAPE, 3), np.float32)
    zarr.create_array(
        tmp_path / "sharded.zarr", data=clip, chunks=(1, *SHAPE, 3), shards=(2, *SHAPE, 3),
        compressors=BloscCodec(),
    )  # fmt: skip
    zarr.create_array(tmp_path / "twice.zarr", data=clip, compressors=[BloscCodec(), GzipCodec()])
    for name in ("sharded.zarr", "twice.zarr"):
        with pytest.raises(PhotographError, match="packed by Blosc within"):
            open_frames(tmp_path / name, SHAPE)
    zarr.create_array(
        tmp_path / "checked.zarr", data=clip, compressors=[BloscCodec(), Crc32cCodec()]
    )
    assert len(list(open_frames(tmp_path / "checked.zarr", SHAPE))) == 4
