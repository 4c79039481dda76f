"""EXR files of every kind."""

import numpy as np
import OpenEXR
import pytest

from periscopy_sim.errors import OutputError, PhotographError
from periscopy_sim.storage.rasters import decode_exr, read_exr, write_exr

RNG = np.random.default_rng(5)
IMAGE = RNG.standard_normal((7, 11, 3)).astype(np.float32)


def save(path, channels, **header):
    with OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, dict(channels)) as file:
        file.write(str(path))
    return path


def plane(value, dtype=np.float32):
    return np.full((7, 11), value, dtype)


def test_image_and_metadata_come_back_exactly(tmp_path):
    metadata = {"scene": "κάθισμα.xml", "sbr": 0.1, "seed": 7, "command": "a\nb", "note": ""}
    write_exr(tmp_path / "y.exr", IMAGE, metadata)
    image, found = read_exr(tmp_path / "y.exr")
    assert image.dtype == np.float32 and np.array_equal(image, IMAGE)
    assert found.items() >= metadata.items()


def test_any_memory_layout_is_written_right(tmp_path):
    for view in IMAGE[::-1, ::2], IMAGE.transpose(1, 0, 2), np.asfortranarray(IMAGE):
        write_exr(tmp_path / "y.exr", view, {})
        assert np.array_equal(read_exr(tmp_path / "y.exr")[0], view)


def test_grey_is_one_channel(tmp_path):
    write_exr(tmp_path / "y.exr", IMAGE[..., :1], {})
    assert np.array_equal(decode_exr(tmp_path / "y.exr").values, IMAGE[..., :1])
    assert np.array_equal(read_exr(tmp_path / "y.exr")[0], np.repeat(IMAGE[..., :1], 3, axis=2))


def test_wrong_shapes_are_refused(tmp_path):
    for image in (IMAGE[..., 0], IMAGE[..., :2], IMAGE[:0]):
        with pytest.raises(ValueError, match="1 or 3"):
            write_exr(tmp_path / "y.exr", image, {})
    with pytest.raises(OutputError):
        write_exr(tmp_path, IMAGE, {})
    assert list(tmp_path.iterdir()) == []


def test_colour_is_found_among_other_channels(tmp_path):
    colour = {c: plane(i) for i, c in enumerate("RGB", 1)}
    picture = decode_exr(save(tmp_path / "y.exr", colour | {"A": plane(9), "depth.Z": plane(8)}))
    assert np.array_equal(picture.values[0, 0], [1, 2, 3])
    assert set(picture.left_out) == {"A", "depth.Z"}


def test_lone_channel_is_grey(tmp_path):
    image, _ = read_exr(save(tmp_path / "y.exr", {"wall.intensity": plane(4), "A": plane(1)}))
    assert image.shape == (7, 11, 3) and (image == 4).all()


def test_channels_that_are_no_one_picture_are_refused(tmp_path):
    for names in ("R", "G"), ("Y", "BY", "RY"), ("a.R", "a.G", "a.B"), ("A",):
        with pytest.raises(PhotographError, match=r"y\.exr"):
            read_exr(save(tmp_path / "y.exr", {n: plane(1) for n in names}))


def test_crop_of_a_larger_picture_is_refused(tmp_path):
    windows = {"dataWindow": ((2, 3), (12, 9)), "displayWindow": ((0, 0), (19, 19))}
    path = save(tmp_path / "y.exr", {"Y": plane(1)}, **windows)
    with pytest.raises(PhotographError, match="crop"):
        read_exr(path)


def test_several_parts_and_deep_images_are_refused(tmp_path):
    with OpenEXR.File(
        [OpenEXR.Part({"name": n}, {"RGB": IMAGE.copy()}) for n in ("left", "right")]
    ) as file:
        file.write(str(tmp_path / "parts.exr"))
    with pytest.raises(PhotographError, match=r"parts\.exr: has several parts"):
        read_exr(tmp_path / "parts.exr")
    samples = np.empty((2, 2), dtype=object)
    for index in np.ndindex(2, 2):
        samples[index] = np.ones(2, np.float32)
    deep = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    save(tmp_path / "deep.exr", {c: samples.copy() for c in "RGB"}, **deep)
    with pytest.raises(PhotographError, match="deep"):
        read_exr(tmp_path / "deep.exr")


def test_same_inputs_give_the_same_bytes_in_any_order(tmp_path):
    write_exr(tmp_path / "a.exr", IMAGE, {"a": "x", "b": 2.0})
    write_exr(tmp_path / "b.exr", IMAGE, {"b": 2.0, "a": "x"})
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
