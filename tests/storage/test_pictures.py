import math

import numpy as np
import OpenEXR
import png
import pytest
import tifffile
from PIL import Image

from periscopy_sim.errors import OutputError, PhotographError
from periscopy_sim.storage.pictures import area_average, read_hidden_image, write_png
from periscopy_sim.storage.rasters import srgb_decode, srgb_encode

RNG = np.random.default_rng(4)
LIGHT = RNG.random((8, 6, 3))


def encode_one(x):  # IEC 61966-2-1 for one number
    return 12.92 * x if x <= 0.0031308 else 1.055 * math.pow(x, 1 / 2.4) - 0.055


def decode_one(x):
    return x / 12.92 if x <= 0.04045 else math.pow((x + 0.055) / 1.055, 2.4)


def test_srgb_curve_is_the_standards():
    for x in [0, 0.001, 0.0031308, 0.00313081, 0.04045, 0.0405, 0.18, 0.5, 0.9, 1]:
        assert srgb_encode(x) == pytest.approx(encode_one(x), rel=1e-14)
        assert srgb_decode(x) == pytest.approx(decode_one(x), rel=1e-14)
    assert srgb_decode(188 / 255) == pytest.approx(0.5028865, abs=1e-7)
    assert srgb_encode(-0.1) == pytest.approx(-1.292)


def brute_force_average(image, shape):
    """Cut every pixel into whole parts of the new pixels, then average those."""
    rows, columns = shape
    fine = image.repeat(rows, axis=0).repeat(columns, axis=1)
    height, width = image.shape[:2]
    return fine.reshape(rows, height, columns, width, 3).mean(axis=(1, 3))


def test_area_average_is_exact_up_and_down():
    for shape in (8, 6), (3, 4), (5, 7), (16, 12), (13, 1):
        exact = brute_force_average(LIGHT, shape)
        assert np.allclose(area_average(LIGHT, shape), exact, rtol=1e-13)


def test_integer_pictures_are_gamma_encoded(tmp_path):
    codes8 = (LIGHT * 255).astype(np.uint8)
    codes16 = (LIGHT * 65535).astype(np.uint16)
    Image.fromarray(codes8).save(tmp_path / "8.png")
    Image.fromarray(codes8).save(tmp_path / "8.tif", compression="tiff_lzw")
    tifffile.imwrite(tmp_path / "16.tif", codes16, photometric="rgb")
    png.from_array(codes16.reshape(8, -1), "RGB;16").save(tmp_path / "16.png")
    for codes, white in (codes8, 255), (codes16, 65535):
        depth = f"{8 * codes.itemsize}"
        np.save(tmp_path / f"{depth}.npy", codes)
        np.savez(tmp_path / f"{depth}.npz", hidden=codes, photograph=LIGHT)
        files = [tmp_path / f"{depth}.{suffix}" for suffix in ("png", "tif", "npy", "npz")]
        for picture in (*files, codes):
            found = read_hidden_image(picture, (8, 6))
            assert np.allclose(found, np.vectorize(decode_one)(codes / white), rtol=1e-12), picture


def test_floating_point_pictures_are_linear(tmp_path):
    np.save(tmp_path / "f.npy", LIGHT)
    tifffile.imwrite(tmp_path / "f.tif", LIGHT.astype(np.float32), photometric="rgb")
    with OpenEXR.File({}, {"RGB": LIGHT.astype(np.float32)}) as file:
        file.write(str(tmp_path / "f.exr"))
    for name in ("f.npy", "f.tif", "f.exr"):
        found = read_hidden_image(tmp_path / name, (4, 2))
        assert np.allclose(found, brute_force_average(LIGHT, (4, 2)), rtol=1e-6), name


def test_transparent_parts_are_dark(tmp_path):
    pixels = np.array([[[255, 255, 255, 255], [255, 255, 255, 0], [255, 255, 255, 51]]], np.uint8)
    Image.fromarray(pixels).save(tmp_path / "f.png")
    found = read_hidden_image(tmp_path / "f.png", (1, 3))
    assert np.allclose(found[0, :, 0], [1, 0, 0.2])
    for mode in ("L", "RGB"):  # one colour declared transparent
        picture = Image.fromarray(pixels[..., 3]).convert(mode)
        picture.save(tmp_path / "f.png", transparency=255 if mode == "L" else (255, 255, 255))
        found = read_hidden_image(tmp_path / "f.png", (1, 3))
        assert np.allclose(found[0, :, 0], [0, 0, decode_one(0.2)])


def test_arrays_that_are_no_picture_are_refused(tmp_path):
    for values in (
        np.full((4, 4, 3), -0.1), np.full((4, 4), np.nan), np.ones((4, 4, 2)), np.ones((0, 4, 3)),
        np.ones(4), np.ones((4, 4), np.int64), np.ones((4, 4), complex),
    ):  # fmt: skip
        np.save(tmp_path / "f.npy", values)
        with pytest.raises(PhotographError, match=r"f\.npy"):
            read_hidden_image(tmp_path / "f.npy", (2, 2))


def test_an_array_keeps_its_channels_but_grey_has_three(tmp_path):
    for channels, kept in ((1, 3), (5, 5)):
        light = np.random.default_rng(0).uniform(size=(4, 6, channels))
        np.save(tmp_path / "f.npy", light)
        found = read_hidden_image(tmp_path / "f.npy", (2, 3))
        expected = light.reshape(2, 2, 3, 2, channels).mean(axis=(1, 3))
        np.testing.assert_allclose(found, np.broadcast_to(expected, (2, 3, kept)), rtol=1e-12)


def test_fourth_channel_of_a_tiff_is_what_the_file_says(tmp_path):
    """Light of 0.6, half opaque: 0.3. Premultiplied light would be multiplied twice."""
    values, file = np.full((4, 4, 4), [0.6, 0.6, 0.6, 0.5], np.float32), tmp_path / "f.tif"
    tifffile.imwrite(file, values, photometric="rgb", extrasamples=["unassalpha"])
    assert np.allclose(read_hidden_image(file, (2, 2)), 0.3)
    tifffile.imwrite(file, values, photometric="rgb", extrasamples=["assocalpha"])
    with pytest.raises(PhotographError, match="alpha"):
        read_hidden_image(file, (2, 2))


def test_written_png_shows_the_image_and_says_where_it_comes_from(tmp_path):
    image = np.concatenate([LIGHT, [[[-1, 0, 0.5], [1, 2, 1e-3]] * 3]])
    text = {"command": "periscopy demo", "scene": "κάθισμα.xml", "seed": "7"}
    write_png(tmp_path / "f.png", image, text)
    with Image.open(tmp_path / "f.png") as picture:
        assert picture.mode == "RGB" and picture.text == text
        expected = np.vectorize(encode_one)(np.clip(image, 0, 1)) * 255
        assert np.abs(np.asarray(picture) - expected).max() <= 0.5 + 1e-9
    found = read_hidden_image(tmp_path / "f.png", image.shape[:2])
    assert np.allclose(found, np.clip(image, 0, 1), atol=0.005)


def test_what_is_no_image_is_not_written(tmp_path):
    for image in (LIGHT[..., :2], np.full((2, 2, 3), np.nan)):
        with pytest.raises(ValueError, match="expected"):
            write_png(tmp_path / "f.png", image, {})
    with pytest.raises(OutputError):
        write_png(tmp_path, LIGHT, {})
    assert list(tmp_path.iterdir()) == []
