import os
import tracemalloc

import numpy as np
import pytest
import tifffile
import xarray as xr
import zarr
from PIL import Image

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.photographs import open_frames, read_clip, read_hidden_frames
from periscopy_sim.storage.rasters import write_exr

SHAPE = (6, 5)
RNG = np.random.default_rng(17)
CLIP = RNG.uniform(1, 2, (12, *SHAPE, 3)).astype(np.float32)
COUNTS = RNG.integers(1, 65536, (3, *SHAPE, 3)).astype(np.uint16)


def save_folder(path, clip):
    path.mkdir()
    for k, frame in enumerate(clip):
        np.save(path / f"y{k}.npy", frame)


def save_zarr(path, clip, **encoding):
    group = xr.Dataset({"photograph": (("frame", "row", "column", "channel"), clip)})
    encoding = {"photograph": {"chunks": (5, *clip.shape[1:]), **encoding}}
    group.to_zarr(path, zarr_format=3, consolidated=False, encoding=encoding)


FORMS = {
    "folder": save_folder,
    "y.npy": np.save,
    "y.npz": lambda path, clip: np.savez_compressed(path, photograph=clip, other=np.zeros(3)),
    "y.zarr": save_zarr,
}


def read(path, mask=None):
    return [frame.values for frame in open_frames(path, SHAPE, mask)]


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_frames_in_order(form, tmp_path):
    FORMS[form](tmp_path / form, CLIP)
    frames = open_frames(tmp_path / form, SHAPE)
    assert len(frames) == len(frames.names) == 12
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


def test_folder_takes_photographs_and_leaves_out_others(tmp_path):
    for k, counts in enumerate(COUNTS):
        tifffile.imwrite(tmp_path / f"{k}.TIF", counts, photometric="rgb")
    for name in (".DS_Store", ".5.npy", "notes.txt", "Thumbs.db"):
        (tmp_path / name).write_text("x")
    (tmp_path / "deep").mkdir()
    np.save(tmp_path / "deep" / "y99.npy", CLIP[0])
    assert np.array_equal(read(tmp_path), COUNTS)


def test_a_clip_is_read_with_the_first_warning_of_each_kind(tmp_path):
    mask = RNG.random(SHAPE) > 0.4
    for k in range(3):
        Image.fromarray((COUNTS[k] >> 8).astype(np.uint8)).save(tmp_path / f"{k}.png")
    done = []
    photographs, warnings = read_clip(open_frames(tmp_path, SHAPE, mask), done.append)
    assert photographs.shape == (3, *SHAPE, 3) and done[-1] == 1
    assert (photographs[:, ~mask] == 0).all() and photographs[:, mask].any()
    assert len(warnings) == 1 and warnings[0].endswith("(likewise 2 more)")


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


@pytest.mark.parametrize("form", ["y.npy", "folder"])
def test_one_frame_at_a_time_is_in_memory(form, tmp_path):
    shape = (200, 100)
    clip = np.ones((40, *shape, 3), np.float32)  # 9.6 MB; one frame in float64 takes 0.5 MB
    FORMS[form](tmp_path / form, clip)
    # The least of three: other threads of the process may allocate meanwhile.
    peak = min(peak_of(open_frames(tmp_path / form, shape)) for _ in range(3))
    assert 1e5 < peak < 3e6


@pytest.mark.parametrize("form", FORMS)
def test_bad_frame_is_named_when_its_turn_comes(form, tmp_path):
    clip, mask = CLIP.copy(), np.ones(SHAPE, bool)
    clip[7, 3, 4, 1], mask[3, 4] = np.nan, False
    FORMS[form](tmp_path / form, clip)
    np.testing.assert_array_equal(read(tmp_path / form, mask), clip)
    place = {"folder": "folder/y7.npy"}.get(form, f"{form}, frame 7")
    frames, seen = open_frames(tmp_path / form, SHAPE), []
    with pytest.raises(PhotographError, match=f"^{tmp_path / place}: "):
        seen.extend(frame.values for frame in frames)
    assert len(frames) == 12


@pytest.mark.parametrize("form", ["y.npy", "y.zarr"])
def test_stack_of_another_form_is_refused(form, tmp_path):
    for k, clip in enumerate((
        CLIP[:, :5], CLIP[:, :, :4], CLIP[0], CLIP[..., :0], CLIP[..., 0], CLIP[:0], CLIP * 1j,
        CLIP > 1.5,
    )):  # fmt: skip
        path = tmp_path / f"{k}{form}"
        if form == "y.zarr":
            zarr.create_group(path).create_array("photograph", data=clip)
        else:
            np.save(path, clip)
        with pytest.raises(PhotographError, match=f"^{path}: ") as caught:
            open_frames(path, SHAPE)
        assert "\n" not in str(caught.value)


def test_folder_or_archive_without_photographs_or_with_two_kinds_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    np.savez(tmp_path / "y.npz", frames=CLIP)
    zarr.create_group(tmp_path / "y.zarr").create_array("frames", data=CLIP)
    (tmp_path / "empty").mkdir()
    for name, message in (("y.npz", "'photograph'"), ("y.zarr", "'photograph'"), ("empty", "")):
        with pytest.raises(PhotographError, match=f"{name}: .*{message}"):
            open_frames(tmp_path / name, SHAPE)
    write_exr(tmp_path / "y1.exr", CLIP[0], {})
    with pytest.raises(PhotographError, match=r"y1\.exr.*y\.npz|y\.npz.*y1\.exr"):
        open_frames(tmp_path, SHAPE)
    with pytest.raises(PhotographError, match=r"y1\.exr"):
        open_frames(tmp_path / "y1.exr", SHAPE)


def test_values_that_stand_for_others_are_refused(tmp_path):
    """xarray writes a missing photograph, NaN, as its fill value: 65535 is no light."""
    for packing in [
        {"dtype": "int16", "scale_factor": 1e-4, "add_offset": 0.5, "_FillValue": -1},
        {"dtype": "uint16", "_FillValue": 65535},
        {"_FillValue": 999.0},
    ]:
        clip = CLIP.astype(packing["dtype"]) if packing.get("_FillValue") == 65535 else CLIP
        path = tmp_path / f"{len(packing)}y.zarr"
        save_zarr(path, clip, **packing)
        with pytest.raises(PhotographError, match=r"y\.zarr"):
            open_frames(path, SHAPE)


def test_an_archive_of_other_values_or_dimensions_than_it_seems_is_refused(tmp_path):
    """A chunk that nobody wrote reads as the fill value, which would be light, or black."""
    for k, (written, names, attributes) in enumerate((
        (2, ("frame", "row", "column", "channel"), {}),
        (3, ("frame", "column", "row", "channel"), {}),
        (3, ("frame", "x", "y", "channel"), {}),
        (3, None, {"_Unsigned": "true"}),
    )):  # fmt: skip
        group = zarr.open_group(tmp_path / f"{k}.zarr", mode="w", zarr_format=3)
        array = group.create_array(
            "photograph", shape=CLIP[:3].shape, dtype="f4", chunks=(1, *SHAPE, 3),
            dimension_names=names, attributes=attributes, fill_value=7,
        )  # fmt: skip
        array[:written] = CLIP[:written]
        with pytest.raises(PhotographError, match=rf"{k}\.zarr"):
            open_frames(tmp_path / f"{k}.zarr", SHAPE)


def test_damaged_zarr_chunk_is_named_by_its_frame(tmp_path):
    save_zarr(tmp_path / "y.zarr", CLIP)
    (tmp_path / "y.zarr" / "photograph" / "c" / "1" / "0" / "0" / "0").write_bytes(b"torn")
    with pytest.raises(PhotographError, match=r"y\.zarr, frame 5: "):
        read(tmp_path / "y.zarr")


class Trap:
    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def test_pickles_are_never_loaded(tmp_path):
    crate = np.full(CLIP.shape, Trap(tmp_path / "sprung"), dtype=object)
    np.save(tmp_path / "y.npy", crate)
    np.savez(tmp_path / "y.npz", photograph=crate)
    zarr.create_group(tmp_path / "y.zarr", zarr_format=2)  # whose filters may be pickles
    for name in ("y.npy", "y.npz", "y.zarr"):
        with pytest.raises(PhotographError, match=name):
            read(tmp_path / name)
    assert not (tmp_path / "sprung").exists()


PATCHES = (2, 3)
SENT = RNG.integers(0, 256, (4, 4, 6, 3)).astype(np.uint8)


def averaged(light):
    """Means of 2 x 2 pixels."""
    return light.reshape(-1, 2, 2, 3, 2, 3).mean(axis=(2, 4))


def hidden(path, count=4):
    return np.array(list(read_hidden_frames(path, PATCHES, count)))


def test_hidden_frames_are_decoded_and_averaged_in_natural_order(tmp_path):
    (tmp_path / "folder").mkdir()
    for k, codes in zip((1, 2, 10, 11), SENT, strict=True):
        Image.fromarray(codes).save(tmp_path / f"folder/f{k}.png")
    shown = SENT / 255
    light = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)
    assert np.allclose(hidden(tmp_path / "folder"), averaged(light))
    for stack in (light.astype(np.float32), SENT, np.uint16(257) * SENT):
        np.save(tmp_path / "f.npy", stack)
        assert np.allclose(hidden(tmp_path / "f.npy"), averaged(light), atol=1e-6), stack.dtype


def test_one_image_stands_for_every_frame(tmp_path):
    light = SENT[0] / 255
    (tmp_path / "folder").mkdir()
    for name, values in (("f.npy", light), ("folder/f.npy", light), ("stack.npy", light[None])):
        np.save(tmp_path / name, values)
    for name in ("f.npy", "folder", "stack.npy"):
        found = hidden(tmp_path / name)
        assert found.shape == (4, *PATCHES, 3) and np.allclose(found, averaged(light)), name


def test_stack_that_is_not_of_the_photographs_is_refused(tmp_path):
    for stack, place, count in [
        (SENT, "f.npy", 1),
        (SENT, "f.npy", 5),
        (np.where(np.arange(4)[:, None, None, None] == 2, -1.0, SENT), "frame 2", 4),
        (np.where(np.arange(4)[:, None, None, None] == 3, np.nan, SENT), "frame 3", 4),
        (SENT.astype(np.int32), "frame 0", 4),
        (SENT[..., :2] / 1.0, "f.npy", 4),
        (SENT * 1j, "f.npy", 4),
    ]:
        np.save(tmp_path / "f.npy", stack)
        with pytest.raises(PhotographError, match=place):
            hidden(tmp_path / "f.npy", count)
