import struct
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import OpenEXR
import png
import pytest
import tifffile
from PIL import Image

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.srgb import srgb_decode
from periscopy_sim.storage.photographs import read_photograph

SHAPE = (6, 9)
RNG = np.random.default_rng(3)
COUNTS = RNG.integers(0, 65536, (*SHAPE, 3)).astype(np.uint16)
LIGHT = RNG.standard_normal((*SHAPE, 3))  # negatives: a dark frame was subtracted
SHARED = Path(__file__).parents[2].parent / "shared" / "data" / "chair_mushroom.npz"


def save_png(path, values, **options):
    rows, columns = values.shape[:2]
    channels = values.size // (rows * columns)
    options = {"greyscale": channels < 3, "alpha": channels % 2 == 0, "bitdepth": 16} | options
    with path.open("wb") as stream:
        png.Writer(columns, rows, **options).write(stream, values.reshape(rows, -1).tolist())
    return path


def save_npy(path, values):
    np.save(path, values)
    return path


def read(path):
    return read_photograph(path, SHAPE)


def test_16_bit_png_keeps_all_its_bits(tmp_path):
    for options in ({}, {"interlace": True}):
        photograph = read(save_png(tmp_path / "y.png", COUNTS, **options))
        assert photograph.values.dtype == np.float64 and photograph.warnings == ()
        assert np.array_equal(photograph.values, COUNTS)


@pytest.mark.parametrize(("name", "save"), [("y.npy", np.save), ("y.npz", np.savez)])
def test_arrays_of_8_bits_are_linear_with_a_warning(tmp_path, name, save):
    for values in (COUNTS >> 8).astype(np.uint8), COUNTS:
        save(tmp_path / name, **{"arr" if name == "y.npy" else "photograph": values})
        photograph = read(tmp_path / name)
        np.testing.assert_array_equal(photograph.values, values)
        warned = [f"{tmp_path / name}: 8-bit {name[-3:].upper()}, taken as linear light"]
        expected = warned if values.dtype == np.uint8 else []
        assert [line.partition(";")[0] for line in photograph.warnings] == expected


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "zlib"},
        {"byteorder": ">"},
        {"bigtiff": True},
        {"tile": (16, 16)},
        {"rowsperstrip": 2},
    ],
)
@pytest.mark.parametrize("dtype", [np.uint16, np.uint32, np.float16, np.float32, np.float64])
def test_deep_tiff_is_read_as_it_is(tmp_path, options, dtype):
    values = COUNTS.astype(dtype) if np.dtype(dtype).kind == "u" else LIGHT.astype(dtype)
    tifffile.imwrite(tmp_path / "y.tif", values, photometric="rgb", **options)
    photograph = read(tmp_path / "y.tif")
    assert np.array_equal(photograph.values, values) and photograph.warnings == ()


def test_planes_and_pages_of_tiff_come_back_as_rows_columns_channels(tmp_path):
    planes = np.ascontiguousarray(np.moveaxis(COUNTS, -1, 0))
    tifffile.imwrite(tmp_path / "planes.tif", planes, photometric="rgb", planarconfig="separate")
    tifffile.imwrite(tmp_path / "pages.tif", LIGHT, photometric="minisblack")
    assert np.array_equal(read(tmp_path / "planes.tif").values, COUNTS)
    assert np.array_equal(read(tmp_path / "pages.tif").values, LIGHT)


@pytest.mark.parametrize(
    "values",
    [
        LIGHT,
        LIGHT.astype(np.float16),
        LIGHT.astype(">f8"),
        LIGHT.astype(np.longdouble),
        np.asfortranarray(LIGHT),
        COUNTS,
        COUNTS.astype(">i4"),
        COUNTS.astype(np.int64) - 30000,
    ],
)
def test_npy_of_any_number_type_and_order(tmp_path, values):
    found = read(save_npy(tmp_path / "y.npy", values)).values
    assert found.dtype == np.dtype("=f8") and found.flags.c_contiguous
    assert np.array_equal(found, values)


def test_npz_is_read_by_its_key(tmp_path):
    np.savez_compressed(tmp_path / "y.npz", photograph=LIGHT, hidden=COUNTS)
    assert np.array_equal(read(tmp_path / "y.npz").values, LIGHT)
    np.savez(tmp_path / "z.npz", image=LIGHT, truth=COUNTS)
    with pytest.raises(PhotographError, match="no array 'photograph', only image, truth"):
        read(tmp_path / "z.npz")


def test_format_is_told_by_contents_not_suffix(tmp_path):
    path = save_npy(tmp_path / "y.npy", LIGHT).rename(tmp_path / "y.tif")
    assert np.array_equal(read(path).values, LIGHT)


def test_real_photograph_is_read():
    if not SHARED.exists():
        pytest.skip("the published photograph is not here")
    values = read_photograph(SHARED, (126, 126)).values
    assert values.shape == (126, 126, 3) and values.min() > 0


def standard_decode(code):  # a scalar second implementation of the sRGB curve
    c = code / 255
    return c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_8_bit_files_are_decoded_with_a_warning(tmp_path, suffix):
    codes = (COUNTS >> 8).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / f"y{suffix}")
    photograph = read(tmp_path / f"y{suffix}")
    assert np.allclose(photograph.values, np.vectorize(standard_decode)(codes), rtol=1e-13)
    assert len(photograph.warnings) == 1 and "sRGB" in photograph.warnings[0]


@pytest.mark.parametrize("shape", [SHAPE, (*SHAPE, 1)])
def test_one_channel_is_grey(tmp_path, shape):
    grey = COUNTS[..., 0].reshape(shape)
    tifffile.imwrite(tmp_path / "y.tif", grey, photometric="minisblack")
    for path in (
        save_npy(tmp_path / "y.npy", grey),
        save_png(tmp_path / "y.png", grey),
        tmp_path / "y.tif",
    ):
        assert np.array_equal(read(path).values, np.repeat(COUNTS[..., :1], 3, axis=2))


@pytest.mark.parametrize("channels", [1, 3])
def test_alpha_is_left_out_with_a_warning(tmp_path, channels):
    values = np.concatenate([COUNTS[..., :channels], COUNTS[..., :1]], axis=2)
    photometric = "rgb" if channels == 3 else "minisblack"
    tifffile.imwrite(tmp_path / "y.tif", values, photometric=photometric, planarconfig="contig")
    planes = {c: np.ones(SHAPE, np.float32) for c in ("RGBA" if channels == 3 else "YA")}
    with OpenEXR.File({}, planes) as file:
        file.write(str(tmp_path / "y.exr"))
    for path in (save_png(tmp_path / "y.png", values), tmp_path / "y.tif"):
        photograph = read(path)
        assert np.array_equal(
            photograph.values, np.broadcast_to(values[..., :channels], LIGHT.shape)
        )
        assert len(photograph.warnings) == 1 and "alpha" in photograph.warnings[0]
    assert "left out the channels A" in read(tmp_path / "y.exr").warnings[0]


def test_colours_other_than_rgb_are_refused(tmp_path):
    Image.new("CMYK", SHAPE[::-1]).save(tmp_path / "y.jpg")
    tifffile.imwrite(tmp_path / "white.tif", COUNTS[..., 0], photometric="miniswhite")
    tifffile.imwrite(tmp_path / "ink.tif", COUNTS.repeat(2, 2)[..., :4], photometric="separated")
    turned = [(274, "H", 1, 6, True)]
    tifffile.imwrite(tmp_path / "turned.tif", COUNTS, photometric="rgb", extratags=turned)
    with tifffile.TiffWriter(tmp_path / "two.tif") as file:
        file.write(COUNTS, photometric="rgb")
        file.write(COUNTS[:3], photometric="rgb")
    stack = np.ones((5, *SHAPE), np.uint8)
    tifffile.imwrite(tmp_path / "five.tif", stack, photometric="minisblack")
    for name, said in [
        ("y.jpg", "CMYK"),
        ("five.tif", "5 pictures"),
        ("white.tif", "MINISWHITE"),
        ("ink.tif", "SEPARATED"),
        ("turned.tif", "turned"),
        ("two.tif", "2 pictures"),
    ]:
        with pytest.raises(PhotographError, match=said):
            read(tmp_path / name)


def icc_profile(encoding):
    """An ICC profile: sRGB's, or a grey one of a power, 1 being linear (ICC.1:2010)."""
    from PIL import ImageCms

    if encoding == "sRGB":
        return ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    # A version 2 profile of greys: its curve, its white and what it is called.
    tags = {
        b"desc": b"desc" + bytes(4) + struct.pack(">I", 6) + b"power\0" + bytes(79),
        b"wtpt": b"XYZ " + bytes(4) + struct.pack(">3i", 63190, 65536, 54061),
        b"kTRC": b"curv" + bytes(4) + struct.pack(">IH", 1, round(256 * encoding)),
    }
    table, data, offset = b"", b"", 128 + 4 + 12 * len(tags)
    for name, body in tags.items():
        table += name + struct.pack(">II", offset + len(data), len(body))
        data += body + bytes(-len(body) % 4)
    whole = struct.pack(">I", len(tags)) + table + data
    head = struct.pack(">I4xI", 128 + len(whole), 0x02400000) + b"mntrGRAYXYZ " + bytes(12)
    head += b"acsp" + bytes(28) + struct.pack(">3i", 63190, 65536, 54061)
    return head + bytes(128 - len(head)) + whole


@pytest.mark.parametrize("save", ["tiff", "png"])
def test_sixteen_bits_are_what_their_colour_profile_says(tmp_path, save):
    grey, path = COUNTS[..., 0], tmp_path / "y"
    for encoding in ("sRGB", 1.0, None):
        profile = None if encoding is None else icc_profile(encoding)
        if save == "tiff":
            tifffile.imwrite(path, grey, photometric="minisblack", iccprofile=profile)
        else:
            Image.fromarray(grey).save(path, "PNG", icc_profile=profile)
        photograph = read(path)
        linear = srgb_decode(grey / 65535) if encoding == "sRGB" else grey
        assert np.allclose(photograph.values[..., 0], linear, rtol=1e-12)
        warned = "16-bit" in "".join(photograph.warnings)
        assert warned == (encoding == "sRGB")


def test_the_srgb_chunk_of_a_png_file_of_16_bits_counts(tmp_path):
    save_png(tmp_path / "y.png", COUNTS)
    head, rest = (tmp_path / "y.png").read_bytes().split(b"IDAT", 1)
    chunk = b"sRGB\0"
    chunk = struct.pack(">I", 1) + chunk + struct.pack(">I", zlib.crc32(chunk))
    (tmp_path / "y.png").write_bytes(head[:-4] + chunk + head[-4:] + b"IDAT" + rest)
    photograph = read(tmp_path / "y.png")
    assert np.allclose(photograph.values, srgb_decode(COUNTS / 65535), rtol=1e-12)
    assert "16-bit PNG, as its colour profile says decoded" in photograph.warnings[0]


def test_eight_bits_of_a_linear_profile_are_not_decoded(tmp_path):
    codes = (COUNTS[..., 0] >> 8).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "y.png", icc_profile=icc_profile(1.0))
    photograph = read(tmp_path / "y.png")
    assert np.array_equal(photograph.values[..., 0], codes) and photograph.warnings == ()


def test_other_curves_and_damaged_profiles_are_refused(tmp_path):
    grey = COUNTS[..., 0]
    refusals = {
        icc_profile(1.8): "'power' encodes light by a curve",
        icc_profile(2.2): "'power' encodes light by a curve",
        icc_profile(1.0)[:90]: "a colour profile",
    }
    for profile, told in refusals.items():
        tifffile.imwrite(tmp_path / "y.tif", grey, photometric="minisblack", iccprofile=profile)
        with pytest.raises(PhotographError, match=told):
            read(tmp_path / "y.tif")


def test_import_brings_in_no_decoder():
    script = (
        "import sys, periscopy_sim.storage.sequences, periscopy_sim.storage.outputs.provenance\n"
        "heavy = {'mitsuba', 'scipy', 'OpenEXR', 'tifffile', 'PIL', 'png', 'zarr', 'yaml'}\n"
        "print(*heavy & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert run.stdout.strip() == ""


def test_threads_that_read_leave_the_streams_alone(tmp_path, capfd):
    for k in range(40):
        np.save(tmp_path / f"{k}.npy", LIGHT)
    with ThreadPoolExecutor(4) as pool:
        photographs = list(pool.map(read, tmp_path.iterdir()))
    print("read", len(photographs))
    assert capfd.readouterr() == ("read 40\n", "")
