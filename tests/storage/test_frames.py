"""Sequences of photographs, in every form."""

import tracemalloc

import numpy as np
import png
import pytest
import tifffile
from PIL import Image

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.sequences import open_frames

SHAPE = (6, 5)
RNG = np.random.default_rng(17)
CLIP = RNG.uniform(1, 2, (12, *SHAPE, 3)).astype(np.float32)
COUNTS = RNG.integers(1, 65536, (3, *SHAPE, 3)).astype(np.uint16)
FORMS = ("folder", "y.npy", "y.npz", "y.zarr", "v2.zarr", "bare.zarr", "bare2.zarr", "y.exr")


def read(path):
    return [frame.values for frame in open_frames(path, SHAPE)]


def with_frame(k, value, at=...):
    clip = CLIP.copy()
    clip[k][at] = value
    return clip


# -- what is read --------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_frames_in_order(form, save, tmp_path):
    save.by_name(tmp_path / form, CLIP)
    frames = open_frames(tmp_path / form, SHAPE)
    assert len(frames) == len(frames.names) == 12 and frames.warnings == ()
    for _ in range(2):  # as often as wanted
        values = [frame.values for frame in frames]
        assert all(v.dtype == np.float64 and v.flags.writeable for v in values)
        assert np.array_equal(values, CLIP)


def test_names_sort_as_people_count(tmp_path):
    names = ["a2b10.npy", "a2b9.NPY", "a10b1.npy", "a02b9.npy", "a.npy", "9.npy", "a2.npy"]
    for k, name in enumerate(names):
        np.save(tmp_path / "raw.npy", np.full((*SHAPE, 3), k + 1.0))
        (tmp_path / "raw.npy").rename(tmp_path / name)
    expected = ["9.npy", "a2.npy", "a02b9.npy", "a2b9.NPY", "a2b10.npy", "a10b1.npy", "a.npy"]
    assert list(open_frames(tmp_path, SHAPE).names) == expected
    assert [v[0, 0, 0] for v in read(tmp_path)] == [names.index(name) + 1 for name in expected]


def save_16_bit_png(path, counts):
    with path.open("wb") as stream:
        writer = png.Writer(SHAPE[1], SHAPE[0], greyscale=False, bitdepth=16)
        writer.write(stream, counts.reshape(SHAPE[0], -1).tolist())


FORMATS = {
    "exr": lambda path, counts: write_exr(path, counts, {}),
    "npz": lambda path, counts: np.savez(path, photograph=counts),
    "png": save_16_bit_png,
    "TIF": lambda path, counts: tifffile.imwrite(path, counts, photometric="rgb"),
}


@pytest.mark.parametrize("suffix", FORMATS)
def test_folder_takes_every_format_of_a_photograph(suffix, tmp_path):
    for k, counts in enumerate(COUNTS):
        FORMATS[suffix](tmp_path / f"{k}.{suffix}", counts)
    assert np.array_equal(read(tmp_path), COUNTS)


def test_other_files_are_left_out_by_name_and_hidden_ones_in_silence(save, tmp_path):
    save.folder(tmp_path / "y", CLIP)
    for name in (".DS_Store", "notes.txt", "Thumbs.db"):
        (tmp_path / "y" / name).write_text("x")
    (tmp_path / "y" / "deep").mkdir()
    np.save(tmp_path / "y" / "deep" / "y99.npy", CLIP[0])
    (tmp_path / "y" / ".y5.npy").write_text("half a copy")
    frames = open_frames(tmp_path / "y", SHAPE)
    assert np.array_equal([frame.values for frame in frames], CLIP)
    assert frames.warnings == (f"{tmp_path / 'y'}: left out notes.txt, Thumbs.db",)


def test_warnings_of_a_photograph_come_with_it(tmp_path):
    for k in range(2):
        Image.fromarray(np.full((*SHAPE, 3), 188, np.uint8)).save(tmp_path / f"{k}.png")
    first, second = open_frames(tmp_path, SHAPE)
    assert np.allclose(first.values, ((188 / 255 + 0.055) / 1.055) ** 2.4)
    assert "1.png: 8-bit PNG" in second.warnings[0]


@pytest.mark.parametrize("form", ["folder", "y.npy", "y.npz", "bare.zarr", "y.exr"])
def test_a_lone_channel_is_grey(form, save, tmp_path):
    grey = CLIP[..., :1]
    save.by_name(tmp_path / form, grey, **({"channels": "Y"} if form == "y.exr" else {}))
    assert np.array_equal(read(tmp_path / form), np.repeat(grey, 3, axis=3))


def peak_of(stack):
    """Return the most memory that is held while a stack is read, in bytes."""
    frames = iter(stack)
    next(frames)  # what is imported on the way
    tracemalloc.start()
    try:
        for _ in frames:
            pass
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("form", ["y.npy", "y.zarr", "folder"])
def test_one_frame_at_a_time_is_in_memory(form, save, tmp_path):
    shape = (200, 100)
    clip = np.ones((40, *shape, 3), np.float32)  # 9.6 MB; one frame in float64 takes 0.5 MB
    chunks = {"chunks": (1, *shape, 3)} if form == "y.zarr" else {}
    save.by_name(tmp_path / form, clip, **chunks)
    # The least of three: other threads of the process may allocate meanwhile.
    peak = min(peak_of(open_frames(tmp_path / form, shape)) for _ in range(3))
    assert 1e5 < peak < 3e6


# -- what is refused -----------------------------------------------------------------------------


def place_of(form, k):
    return {"folder": f"folder/y{k}.npy"}.get(form, f"{form}, frame {k}")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("value", "at", "said"),
    [
        (
            np.nan,
            (3, 4, 1),
            "1 value is NaN or infinite, the first at row 3, column 4, channel 1",
        ),
        (-np.inf, (2,), "15 values are NaN or infinite, the first at row 2, column 0, channel 0"),
        (0, ..., "every value is zero"),
        (-1, ..., "no value is positive"),
    ],
)
def test_bad_frame_is_named_when_its_turn_comes(form, value, at, said, save, line_of, tmp_path):
    save.by_name(tmp_path / form, with_frame(7, value, at))
    frames = open_frames(tmp_path / form, SHAPE)
    seen = []
    with pytest.raises(PhotographError) as caught:
        for frame in frames:
            seen.append(frame.values)
    assert np.array_equal(seen, CLIP[:7])
    assert line_of(caught).startswith(f"{tmp_path / place_of(form, 7)}: {said}")


@pytest.mark.parametrize("form", FORMS[1:])
def test_frames_of_another_size_are_refused_before_any_is_read(form, save, line_of, tmp_path):
    save.by_name(tmp_path / form, CLIP)
    for shape, said in [((5, 6), "6 x 5 pixels"), ((3, 5), "6 x 5 pixels")]:
        with pytest.raises(PhotographError, match=said) as caught:
            open_frames(tmp_path / form, shape)
        assert line_of(caught).startswith(str(tmp_path / form))
        assert f"the scene's camera has {shape[0]} x {shape[1]}" in line_of(caught)


def test_folder_without_photographs_or_with_two_kinds_is_refused(line_of, tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(PhotographError, match="holds no file"):
        open_frames(tmp_path, SHAPE)
    np.save(tmp_path / "y10.npy", CLIP[0])
    np.save(tmp_path / "y2.npy", CLIP[0])
    write_exr(tmp_path / "y1.exr", CLIP[0], {})
    with pytest.raises(PhotographError) as caught:
        open_frames(tmp_path, SHAPE)
    said = f"{tmp_path}: holds EXR (y1.exr), NPY (y2.npy); keep frames of one format alone there"
    assert line_of(caught) == said


def test_single_photograph_is_refused_with_what_to_give(tmp_path):
    save_16_bit_png(tmp_path / "y.png", COUNTS[0])
    with pytest.raises(PhotographError, match=r"y\.png: is a single PNG file; give a folder"):
        open_frames(tmp_path / "y.png", SHAPE)
    with pytest.raises(PhotographError, match="no such file"):
        open_frames(tmp_path / "none", SHAPE)


@pytest.mark.parametrize("name", ["y.npy", "y.npz", "y.exr"])
@pytest.mark.parametrize("part", [0.02, 0.3, 0.6, 0.95])
def test_truncated_file_is_refused(name, part, save, line_of, tmp_path):
    save.by_name(tmp_path / name, CLIP)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(part * len(content))])
    with pytest.raises(PhotographError) as caught:
        read(tmp_path / name)
    assert line_of(caught).startswith(str(tmp_path / name))
