import struct
import zlib

import numpy as np
import OpenEXR
import png
import pytest
import tifffile
from PIL import Image, ImageCms

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Photograph
from periscopy_sim.storage.photographs import read_mask, read_photograph
from periscopy_sim.storage.pictures import read_hidden_image

SHAPE = (6, 9)
RNG = np.random.default_rng(3)
COUNTS = RNG.integers(0, 65536, (*SHAPE, 3)).astype(np.uint16)
CODES = (COUNTS >> 8).astype(np.uint8)


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


def test_arrays_of_8_bits_are_linear_with_a_warning(tmp_path):
    for values in CODES, COUNTS:
        np.savez(tmp_path / "y.npz", photograph=values, hidden=COUNTS)
        for path in save_npy(tmp_path / "y.npy", values), tmp_path / "y.npz":
            photograph = read(path)
            np.testing.assert_array_equal(photograph.values, values)
            of_array = Photograph.of(values)
            for each in photograph, of_array:
                assert len(each.warnings) == (values.dtype == np.uint8)


def test_planes_of_tiff_come_back_as_channels(tmp_path):
    planes = np.ascontiguousarray(np.moveaxis(COUNTS, -1, 0))
    tifffile.imwrite(tmp_path / "planes.tif", planes, photometric="rgb", planarconfig="separate")
    assert np.array_equal(read(tmp_path / "planes.tif").values, COUNTS)


def test_one_channel_is_grey(tmp_path):
    grey = COUNTS[..., 0]
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


@pytest.mark.parametrize("orientation", [4, 6])
@pytest.mark.parametrize("name", ["8.jpg", "16.png", "16.tif"])
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
    if name != "8.jpg":
        with pytest.raises(PhotographError, match="turned"):
            read(path)
        return
    seen = read(path, (16, 24) if orientation < 5 else (24, 16)).values[..., 0]
    corners = {4: (-1, 0), 6: (0, -1)}
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


@pytest.mark.parametrize("name", ["16.tif", "16.png", "8.jpg"])
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
def test_integers_are_what_a_png_declares(tmp_path, chunk, content, meant):
    for bits, values in ((8, CODES), (16, COUNTS)):
        path = add_chunk(save_png(tmp_path / "y.png", values, bitdepth=bits), chunk, content)
        if meant == "neither":
            with pytest.raises(PhotographError, match=r"y\.png"):
                read(path)
            continue
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


MASK = np.random.default_rng(3).random((7, 9)) > 0.4
MASK[0, 0], MASK[-1, -1] = False, True


def palette(path):
    picture = Image.fromarray(MASK.astype(np.uint8), "P")
    picture.putpalette([0, 0, 0, 255, 255, 255])
    picture.save(path)


FORMS = {
    "1-bit.png": lambda path: save_png(path, MASK.astype(int), bitdepth=1),
    "palette.png": palette,
    "huge.npy": lambda path: np.save(path, np.where(MASK, 2**64 - 1, 0).astype(np.uint64)),
    "mask.npz": lambda path: np.savez(path, mask=MASK, photograph=np.zeros(3)),
}


def test_bright_is_used_and_black_left_out(tmp_path):
    for name, write in FORMS.items():
        write(tmp_path / name)
        mask = read_mask(tmp_path / name, MASK.shape)
        assert mask.dtype == bool
        np.testing.assert_array_equal(mask, MASK, err_msg=name)


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


def test_what_is_no_mask_is_refused(tmp_path):
    for values in UNFIT:
        np.save(tmp_path / "m.npy", values)
        with pytest.raises(PhotographError, match=r"m\.npy: "):
            read_mask(tmp_path / "m.npy", MASK.shape)
