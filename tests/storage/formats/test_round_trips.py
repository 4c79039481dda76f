"""What is written is read again: the same values, of every shape."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import png
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from periscopy_sim.storage.formats.rasters import read_exr, write_exr
from periscopy_sim.storage.photographs import read_photograph
from periscopy_sim.storage.pictures import read_hidden_image, write_png
from periscopy_sim.storage.sequences import open_frames

few = settings(deadline=None, max_examples=20)
sizes = st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3))
floats = st.floats(-(2.0**60), 2.0**60, width=32).map(lambda x: x + 0.0)
lights = arrays(np.float32, sizes, elements=floats).filter(lambda x: x.max() > 1e-20)
fractions = arrays(np.float64, sizes, elements=st.floats(0, 1))


def in_a_file(name, write):
    """Give what `write` reads again from a path of that name in a folder of its own."""
    with TemporaryDirectory() as folder:
        return write(Path(folder) / name)


@few
@given(light=lights, note=st.text(st.characters(codec="ascii", exclude_categories=["Cc"])))
def test_exr(light, note):
    def again(path):
        write_exr(path, light, {"note": note, "sbr": 1 / 3})
        return *read_exr(path), read_photograph(path, light.shape[:2]).values

    image, metadata, photograph = in_a_file("y.exr", again)
    np.testing.assert_array_equal(image, light)
    np.testing.assert_array_equal(photograph, light)
    assert (metadata["note"], metadata["sbr"]) == (note, 1 / 3)


@few
@given(
    light=lights, order=st.sampled_from("CF"), dtype=st.sampled_from(["<f4", ">f4", "f8", ">f8"])
)
def test_npy_and_npz(light, order, dtype):
    def again(path):
        stored = np.array(light, dtype, order=order)
        np.save(path, stored)
        np.savez_compressed(path.with_suffix(".npz"), photograph=stored)
        files = (path, path.with_suffix(".npz"))
        return [read_photograph(file, light.shape[:2]).values for file in files]

    for photograph in in_a_file("y.npy", again):
        np.testing.assert_array_equal(photograph, light)


@few
@given(counts=arrays(np.uint16, sizes).filter(np.any), interlaced=st.booleans())
def test_16_bit_png(counts, interlaced):
    def again(path):
        rows, columns, _ = counts.shape
        with path.open("wb") as stream:
            writer = png.Writer(columns, rows, greyscale=False, bitdepth=16, interlace=interlaced)
            writer.write(stream, counts.reshape(rows, -1).tolist())
        return read_photograph(path, (rows, columns))

    photograph = in_a_file("y.png", again)
    np.testing.assert_array_equal(photograph.values, counts)
    assert photograph.warnings == ()


@few
@given(image=fractions)
def test_8_bit_png_of_a_hidden_image_is_within_half_a_code(image):
    def again(path):
        write_png(path, image, {"note": "a"})
        return read_hidden_image(path, image.shape[:2])

    found = in_a_file("f.png", again)

    def codes(light):
        power = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
        return 255 * np.where(light <= 0.0031308, 12.92 * light, power)

    np.testing.assert_allclose(codes(found), codes(image), atol=0.5 + 1e-2)


@few
@given(
    clip=arrays(np.float32, st.tuples(st.integers(1, 4), *[st.integers(1, 5)] * 2, st.just(3)),
                elements=st.floats(0.5, 2, width=32))
)  # fmt: skip
def test_stacks(clip):
    def again(path):
        np.save(path, clip)
        np.savez_compressed(path.with_suffix(".npz"), photograph=clip)
        files = (path, path.with_suffix(".npz"))
        return [[frame.values for frame in open_frames(f, clip.shape[1:3])] for f in files]

    for frames in in_a_file("y.npy", again):
        np.testing.assert_array_equal(frames, clip)
