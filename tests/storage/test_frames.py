"""Sequences of photographs, in every form."""

import tracemalloc

import numpy as np
import png
import pytest
import tifffile

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.exr import write_exr
from periscopy_sim.storage.sequences import open_frames

SHAPE = (6, 5)
RNG = np.random.default_rng(17)
CLIP = RNG.uniform(1, 2, (12, *SHAPE, 3)).astype(np.float32)
COUNTS = RNG.integers(1, 65536, (3, *SHAPE, 3)).astype(np.uint16)
FORMS = ("folder", "y.npy", "y.npz", "y.zarr", "v2.zarr", "bare.zarr", "bare2.zarr")


def read(path):
    return [frame.values for frame in open_frames(path, SHAPE)]


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


@pytest.mark.parametrize("form", FORMS)
def test_bad_frame_is_named_when_its_turn_comes(form, save, line_of, tmp_path):
    clip = CLIP.copy()
    clip[7, 3, 4, 1] = np.nan
    save.by_name(tmp_path / form, clip)
    frames = open_frames(tmp_path / form, SHAPE)
    seen = []
    with pytest.raises(PhotographError) as caught:
        for frame in frames:
            seen.append(frame.values)
    assert np.array_equal(seen, CLIP[:7])
    place = {"folder": "folder/y7.npy"}.get(form, f"{form}, frame 7")
    assert line_of(caught).startswith(f"{tmp_path / place}: ")


@pytest.mark.parametrize("form", FORMS[1:])
def test_frames_of_another_size_are_refused_before_any_is_read(form, save, line_of, tmp_path):
    save.by_name(tmp_path / form, CLIP)
    for shape in ((5, 6), (3, 5)):
        with pytest.raises(PhotographError) as caught:
            open_frames(tmp_path / form, shape)
        assert line_of(caught).startswith(str(tmp_path / form))


def test_folder_without_photographs_or_with_two_kinds_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(PhotographError):
        open_frames(tmp_path, SHAPE)
    np.save(tmp_path / "y10.npy", CLIP[0])
    np.save(tmp_path / "y2.npy", CLIP[0])
    write_exr(tmp_path / "y1.exr", CLIP[0], {})
    with pytest.raises(PhotographError, match=r"y1\.exr.*y2\.npy"):
        open_frames(tmp_path, SHAPE)
    with pytest.raises(PhotographError, match=r"y1\.exr"):
        open_frames(tmp_path / "y1.exr", SHAPE)
