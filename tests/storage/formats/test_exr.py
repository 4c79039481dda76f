import subprocess
import sys

import numpy as np
import OpenEXR
import pytest

from periscopy_sim.errors import OutputError, PhotographError
from periscopy_sim.storage.formats.exr import decode_exr, read_exr, write_exr

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
    assert found == metadata


@pytest.mark.parametrize(
    "view", [IMAGE[::-1, ::2], IMAGE.transpose(1, 0, 2), np.asfortranarray(IMAGE), IMAGE[:1, :1]]
)
def test_any_memory_layout_is_written_right(tmp_path, view):
    write_exr(tmp_path / "y.exr", view.astype(np.float64), {})
    assert np.array_equal(read_exr(tmp_path / "y.exr")[0], view)


def test_other_readers_see_the_same_channels(tmp_path):
    write_exr(tmp_path / "y.exr", IMAGE, {"sbr": 0.5})
    with OpenEXR.File(str(tmp_path / "y.exr")) as file:
        assert np.array_equal(file.channels()["RGB"].pixels, IMAGE)


def test_same_inputs_give_the_same_bytes_in_any_process(tmp_path):
    write_exr(tmp_path / "here.exr", IMAGE, {"a": "x", "b": 2.0})
    np.save(tmp_path / "image.npy", IMAGE)
    script = (
        "import sys, numpy; from pathlib import Path\n"
        "from periscopy_sim.storage.formats.exr import write_exr\n"
        "folder = Path(sys.argv[1])\n"
        "write_exr(folder / 'there.exr', numpy.load(folder / 'image.npy'), {'b': 2.0, 'a': 'x'})"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=True)
    assert (tmp_path / "here.exr").read_bytes() == (tmp_path / "there.exr").read_bytes()


def test_wrong_shapes_and_names_are_refused(tmp_path):
    for image in (IMAGE[..., 0], IMAGE[..., :2], IMAGE[:0]):
        with pytest.raises(ValueError, match="shape"):
            write_exr(tmp_path / "y.exr", image, {})
    for name in ("compression", "dataWindow", "", "n" * 256):
        with pytest.raises(ValueError, match="name"):
            write_exr(tmp_path / "y.exr", IMAGE, {name: "x"})
    with pytest.raises(OutputError):
        write_exr(tmp_path, IMAGE, {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.uint32])
def test_every_pixel_type_is_read(tmp_path, dtype):
    channels = {c: plane(i + 1, dtype) for i, c in enumerate("RGB")}
    image, _ = read_exr(save(tmp_path / "y.exr", channels))
    assert np.array_equal(image[3, 4], [1, 2, 3])


def test_channels_are_told_by_name_in_any_layer(tmp_path):
    layered = {f"wall.{c}": plane(i) for i, c in enumerate("RGB", 1)}
    path = save(tmp_path / "y.exr", layered | {"wall.A": plane(9), "depth.Z": plane(8)})
    colour, part = decode_exr(path)
    assert np.array_equal(colour[0, 0], [1, 2, 3])
    assert set(part.left_out) == {"wall.A", "depth.Z"}


def test_unnamed_layer_goes_first(tmp_path):
    names = [f"{layer}{c}" for layer in ("", "albedo.") for c in "RGB"]
    path = save(tmp_path / "y.exr", {n: plane(i) for i, n in enumerate(names)})
    assert np.array_equal(read_exr(path)[0][0, 0], [0, 1, 2])


@pytest.mark.parametrize("name", ["Y", "R", "wall.intensity"])
def test_lone_channel_is_grey(tmp_path, name):
    image, _ = read_exr(save(tmp_path / "y.exr", {name: plane(4), "A": plane(1)}))
    assert image.shape == (7, 11, 3) and (image == 4).all()


@pytest.mark.parametrize("names", [("R", "G"), ("Y", "Z"), ("Y", "BY", "RY"), ("A",)])
def test_channels_that_are_no_one_picture_are_listed(tmp_path, names):
    path = save(tmp_path / "y.exr", {n: plane(1) for n in names})
    with pytest.raises(PhotographError, match=sorted(names)[0]):
        read_exr(path)


def test_two_layers_of_colour_are_ambiguous(tmp_path):
    names = [f"{layer}.{c}" for layer in ("a", "b") for c in "RGB"]
    with pytest.raises(PhotographError, match="exactly one"):
        read_exr(save(tmp_path / "y.exr", {n: plane(1) for n in names}))


def test_several_parts_and_deep_images_are_refused(tmp_path):
    with OpenEXR.File(
        [OpenEXR.Part({"name": n}, {"RGB": IMAGE.copy()}) for n in ("left", "right")]
    ) as file:
        file.write(str(tmp_path / "parts.exr"))
    with pytest.raises(PhotographError, match="2 parts"):
        read_exr(tmp_path / "parts.exr")
    samples = np.empty((2, 2), dtype=object)
    for index in np.ndindex(2, 2):
        samples[index] = np.ones(2, np.float32)
    deep = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    save(tmp_path / "deep.exr", {c: samples.copy() for c in "RGB"}, **deep)
    with pytest.raises(PhotographError, match="deep"):
        read_exr(tmp_path / "deep.exr")


@pytest.mark.parametrize("attribute", ["dataWindow", "tiles"])
def test_absurd_size_is_refused_before_it_is_allocated(tmp_path, attribute):
    path = save(
        tmp_path / "y.exr",
        {"RGB": IMAGE.copy()},
        type=OpenEXR.tiledimage,
        tiles=OpenEXR.TileDescription(),
    )
    content = bytearray(path.read_bytes())
    value = content.index(attribute.encode() + b"\0") + len(attribute) + 1
    value = content.index(b"\0", value) + 1 + 4  # past the name of the type and the size
    value += 8 if attribute == "dataWindow" else 0  # xMax and yMax, or xSize and ySize
    content[value : value + 8] = np.array([1 << 20, 1 << 20], "<i4").tobytes()
    path.write_bytes(content)
    with pytest.raises(PhotographError, match="announces"):
        read_exr(path)


def test_openexr_says_nothing_on_the_terminal(tmp_path, capfd):
    write_exr(tmp_path / "y.exr", RNG.random((40, 40, 3)), {})
    content = (tmp_path / "y.exr").read_bytes()
    for length in (100, len(content) // 2, len(content) - 1):
        (tmp_path / "cut.exr").write_bytes(content[:length])
        with pytest.raises(PhotographError):
            read_exr(tmp_path / "cut.exr")
    print("still here", flush=True)
    assert capfd.readouterr() == ("still here\n", "")
