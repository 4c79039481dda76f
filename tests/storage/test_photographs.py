import struct
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import OpenEXR
import png
import pytest
import tifffile
from PIL import Image, ImageCms

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.photographs import read_mask, read_photograph
from periscopy_sim.storage.pictures import read_hidden_image, write_png

SHAPE = (6, 9)
RNG = np.random.default_rng(3)
COUNTS = RNG.integers(0, 65536, (*SHAPE, 3)).astype(np.uint16)
CODES = (COUNTS >> 8).astype(np.uint8)
LIGHT = RNG.standard_normal((*SHAPE, 3))  # negatives: a dark frame was subtracted


def save_png(path, values, **options):
    rows, columns = values.shape[:2]
    channels = values.size // (rows * columns)
    options = {"greyscale": channels < 3, "alpha": channels % 2 == 0, "bitdepth": 16} | options
    with path.open("wb") as stream:
        png.Writer(columns, rows, **options).write(stream, values.reshape(rows, -1).tolist())
    return path


def add_chunk(path, name, content):
    """Insert a chunk before a PNG file's pixels."""
    head, rest = path.read_bytes().split(b"IDAT", 1)
    chunk = name + content
    chunk = struct.pack(">I", len(content)) + chunk + struct.pack(">I", zlib.crc32(chunk))
    path.write_bytes(head[:-4] + chunk + head[-4:] + b"IDAT" + rest)
    return path


def save_npy(path, values):
    np.save(path, values)
    return path


def read(path, shape=SHAPE):
    return read_photograph(path, shape)


def srgb_decoded(encoded):  # IEC 61966-2-1, a second implementation
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("name", ["y.npy", "y.npz"])
def test_arrays_of_8_bits_are_linear_with_a_warning(tmp_path, name):
    for values in CODES, COUNTS:
        if name == "y.npy":
            np.save(tmp_path / name, values)
        else:
            np.savez(tmp_path / name, photograph=values, hidden=COUNTS)
        photograph = read(tmp_path / name)
        np.testing.assert_array_equal(photograph.values, values)
        assert len(photograph.warnings) == (values.dtype == np.uint8)


@pytest.mark.parametrize(
    "options",
    [{}, {"compression": "zlib"}, {"byteorder": ">"}, {"bigtiff": True}, {"tile": (16, 16)}],
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
        LIGHT.astype(np.float16), LIGHT.astype(">f8"), LIGHT.astype(np.longdouble),
        np.asfortranarray(LIGHT), COUNTS.astype(">i4"), COUNTS.astype(np.int64) - 30000,
    ],
)  # fmt: skip
def test_npy_of_any_number_type_and_order(tmp_path, values):
    found = read(save_npy(tmp_path / "y.npy", values)).values
    assert found.dtype == np.dtype("=f8") and found.flags.c_contiguous
    assert np.array_equal(found, values)


def test_contents_decide_the_format(tmp_path):
    path = save_npy(tmp_path / "y.npy", LIGHT).rename(tmp_path / "y.tif")
    assert np.array_equal(read(path).values, LIGHT)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_8_bit_files_are_decoded_with_a_warning(tmp_path, suffix):
    Image.fromarray(CODES).save(tmp_path / f"y{suffix}")
    photograph = read(tmp_path / f"y{suffix}")
    assert np.allclose(photograph.values, srgb_decoded(CODES / 255), rtol=1e-13)
    assert len(photograph.warnings) == 1


@pytest.mark.parametrize("shape", [SHAPE, (*SHAPE, 1)])
def test_one_channel_is_grey(tmp_path, shape):
    grey = COUNTS[..., 0].reshape(shape)
    tifffile.imwrite(tmp_path / "y.tif", grey, photometric="minisblack")
    files = save_npy(tmp_path / "y.npy", grey), save_png(tmp_path / "y.png", grey, interlace=True)
    for path in (*files, tmp_path / "y.tif"):
        assert np.array_equal(read(path).values, COUNTS[..., :1])


@pytest.mark.parametrize("channels", [1, 3])
def test_further_channels_are_left_out_with_a_warning(tmp_path, channels):
    values = np.concatenate([COUNTS[..., :channels], COUNTS[..., :1]], axis=2)
    photometric = "rgb" if channels == 3 else "minisblack"
    extra = {"planarconfig": "contig", "extrasamples": ["unassalpha"]}
    tifffile.imwrite(tmp_path / "y.tif", values, photometric=photometric, **extra)
    planes = dict(zip("RGBA" if channels == 3 else "YA", np.moveaxis(values, -1, 0), strict=True))
    with OpenEXR.File({}, {n: np.array(v, np.float32) for n, v in planes.items()}) as file:
        file.write(str(tmp_path / "y.exr"))
    for path in (save_png(tmp_path / "y.png", values), tmp_path / "y.tif", tmp_path / "y.exr"):
        photograph = read(path)
        assert np.array_equal(photograph.values, values[..., :channels])
        assert len(photograph.warnings) == 1


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("name", ["8.png", "8.jpg", "16.png", "8.tif", "16.tif"])
def test_turned_pictures_are_set_upright_or_refused(tmp_path, orientation, name):
    """The corner pixel (row, column) that EXIF names: where the stored first pixel is seen."""
    values = np.zeros((16, 24), np.uint8 if name[0] == "8" else np.uint16)
    values[:4, :4] = 200
    path, exif = tmp_path / name, Image.Exif()
    exif[274] = orientation
    if name == "16.tif":
        tags = [(274, "H", 1, orientation, True)]
        tifffile.imwrite(path, values, photometric="minisblack", extratags=tags)
    elif name == "16.png":
        add_chunk(save_png(path, values), b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0"))
    else:
        Image.fromarray(values).save(path, exif=exif)
    if name in ("16.png", "8.tif", "16.tif") and orientation > 1:
        with pytest.raises(PhotographError, match="turned"):
            read(path)
        return
    seen = read(path, (16, 24) if orientation < 5 else (24, 16)).values[..., 0]
    corners = {1: (0, 0), 2: (0, -1), 3: (-1, -1), 4: (-1, 0)}
    corners |= {5: (0, 0), 6: (0, -1), 7: (-1, -1), 8: (-1, 0)}
    assert seen[corners[orientation]] > 0.5 * seen.max()  # JPEG blurs


def test_colours_other_than_rgb_are_refused(tmp_path):
    Image.new("CMYK", SHAPE[::-1]).save(tmp_path / "y.jpg")
    tifffile.imwrite(tmp_path / "white.tif", COUNTS[..., 0], photometric="miniswhite")
    tifffile.imwrite(tmp_path / "ink.tif", COUNTS.repeat(2, 2)[..., :4], photometric="separated")
    with tifffile.TiffWriter(tmp_path / "two.tif") as file:
        file.write(COUNTS, photometric="rgb")
        file.write(COUNTS[:3], photometric="rgb")
    stack = np.ones((5, *SHAPE), np.uint8)
    tifffile.imwrite(tmp_path / "five.tif", stack, photometric="minisblack")
    for name in ("y.jpg", "five.tif", "white.tif", "ink.tif", "two.tif"):
        with pytest.raises(PhotographError, match=name):
            read(tmp_path / name)


@pytest.mark.parametrize("name", ["16.tif", "16.png", "8.tif", "8.png", "8.jpg"])
def test_deep_integers_with_a_colour_profile_are_refused(tmp_path, name):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    grey, path = (CODES if name[0] == "8" else COUNTS)[..., 0], tmp_path / name
    if name == "16.tif":
        tifffile.imwrite(path, grey, photometric="minisblack", iccprofile=profile)
    else:
        Image.fromarray(grey).save(path, icc_profile=profile)
    if name[0] == "8":
        assert len(read(path).warnings) == 1
    else:
        with pytest.raises(PhotographError, match="colour profile"):
            read(path)


@pytest.mark.parametrize(
    ("chunk", "content", "meant"),
    [
        (b"sRGB", b"\0", "sRGB"),
        (b"cICP", bytes([1, 13, 0, 1]), "neither"),
        (b"gAMA", struct.pack(">I", 100_000), "linear"),
        (b"gAMA", struct.pack(">I", 55_556), "neither"),
        (b"gAMA", struct.pack(">I", 45_455), "unsure"),  # as converters write of linear light, too
    ],
)
@pytest.mark.parametrize("bits", [8, 16])
def test_integers_are_what_a_png_declares(tmp_path, chunk, content, meant, bits):
    values = CODES if bits == 8 else COUNTS
    path = add_chunk(save_png(tmp_path / "y.png", values, bitdepth=bits), chunk, content)
    if meant == "neither":
        with pytest.raises(PhotographError, match=r"y\.png"):
            read(path)
        return
    photograph = read(path)
    is_encoded = meant == "sRGB" or (meant == "unsure" and bits == 8)
    expected = srgb_decoded(values / (2**bits - 1)) if is_encoded else values
    assert np.allclose(photograph.values, expected, rtol=1e-12)
    assert len(photograph.warnings) == (meant != "linear")


@pytest.mark.parametrize("bits", [8, 16])
def test_a_hidden_image_is_what_its_png_declares(tmp_path, bits):
    """A transparent colour of 16 bits would be left out, and what it hides be light."""
    codes = np.full((4, 6, 3), 2 ** (bits - 1), np.uint16)
    code = codes[0, 0, 0] / (2**bits - 1)
    for chunk, content, meant in (
        (b"gAMA", struct.pack(">I", 100_000), code),
        (b"gAMA", struct.pack(">I", 45_454), srgb_decoded(code)),
        (b"gAMA", struct.pack(">I", 55_556), None),
        (b"cICP", bytes([1, 8, 0, 1]), None),
        (b"tRNS", codes[0, 0].astype(">u2").tobytes(), 0 if bits == 8 else None),
    ):
        path = add_chunk(save_png(tmp_path / "f.png", codes, bitdepth=bits), chunk, content)
        if meant is None:
            with pytest.raises(PhotographError, match=r"f\.png"):
                read_hidden_image(path, (2, 2))
        else:
            assert np.allclose(read_hidden_image(path, (2, 2)), meant, rtol=1e-9), chunk


def test_threads_that_read_leave_the_streams_alone(tmp_path, capfd):
    for k in range(40):
        np.save(tmp_path / f"{k}.npy", LIGHT)
    with ThreadPoolExecutor(4) as pool:
        photographs = list(pool.map(read, tmp_path.iterdir()))
    print("read", len(photographs))
    assert capfd.readouterr() == ("read 40\n", "")


MASK = np.random.default_rng(3).random((7, 9)) > 0.4
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
    mask = read_mask(tmp_path / name, MASK.shape)
    assert mask.dtype == bool and mask.shape == MASK.shape
    np.testing.assert_array_equal(mask, MASK)


def test_bright_is_above_half_of_the_largest_value(tmp_path):
    values = np.full(MASK.shape, 200.0)
    values[0, :4] = 0, 100, 100.001, 150
    np.save(tmp_path / "m.npy", values)
    assert read_mask(tmp_path / "m.npy", MASK.shape)[0, :4].tolist() == [False, False, True, True]


def test_what_is_transparent_is_left_out(tmp_path):
    layers = np.stack([np.full(MASK.shape, 255), 255 * MASK], axis=-1).astype(np.uint8)
    Image.fromarray(layers).save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png", MASK.shape), MASK)


UNFIT = [
    np.zeros(MASK.shape),
    np.full(MASK.shape, -1.0),
    np.where(MASK, np.nan, 1.0),
    np.where(MASK, np.inf, 1.0),
    np.stack([MASK, MASK, ~MASK], axis=-1).astype(float),
    MASK.T,
    MASK.ravel(),
    np.full(MASK.shape, "a"),
]


@pytest.mark.parametrize("values", UNFIT)
def test_what_is_no_mask_is_refused(values, tmp_path):
    np.save(tmp_path / "m.npy", values)
    with pytest.raises(PhotographError, match=r"m\.npy: "):
        read_mask(tmp_path / "m.npy", MASK.shape)
