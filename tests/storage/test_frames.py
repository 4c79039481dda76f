"""Sequences of photographs and of hidden images, in every form."""

import json
import os
import pickle
import subprocess
import sys
import tracemalloc
import zipfile

import numpy as np
import OpenEXR
import png
import pytest
import tifffile
import xarray as xr
import zarr
from PIL import Image

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.exr import write_exr
from periscopy_sim.storage.frames import open_frames
from periscopy_sim.storage.hidden_frames import read_hidden_frames
from periscopy_sim.storage.stacks import mapped_stack, npy_stack

SHAPE = (6, 5)
RNG = np.random.default_rng(17)
CLIP = RNG.uniform(1, 2, (12, *SHAPE, 3)).astype(np.float32)
COUNTS = RNG.integers(1, 65536, (3, *SHAPE, 3)).astype(np.uint16)


def read(path):
    return [frame.values for frame in open_frames(path, SHAPE)]


def save_folder(path, clip=CLIP):
    path.mkdir()
    for k, frame in enumerate(clip):
        np.save(path / f"y{k}.npy", frame)


def save_npz(path, clip=CLIP):
    with path.open("wb") as stream:
        np.savez_compressed(stream, photograph=clip, other=np.zeros(3))


def save_zarr(path, clip=CLIP, zarr_format=3, chunks=(5, *SHAPE, 3)):
    dimensions = ("frame", "row", "column", "channel")
    dataset = xr.Dataset({"photograph": (dimensions, clip)})
    encoding = {"photograph": {"chunks": chunks}}
    dataset.to_zarr(path, zarr_format=zarr_format, consolidated=False, encoding=encoding)


def save_bare_zarr(path, clip=CLIP, zarr_format=3, **settings):
    zarr.create_array(path, data=clip, zarr_format=zarr_format, **settings)


def save_exr(path, clip=CLIP, channels="RGB", **header):
    parts = [
        OpenEXR.Part(
            {"name": f"part{k}", "type": OpenEXR.scanlineimage, **header},
            {c: np.ascontiguousarray(frame[..., i]) for i, c in enumerate(channels)},
        )
        for k, frame in enumerate(clip)
    ]
    with OpenEXR.File(parts) as file:
        file.write(str(path))


WRITERS = {
    "folder": save_folder,
    "y.npy": lambda path, clip=CLIP: np.save(path, clip),
    "y.npz": save_npz,
    "y.zarr": save_zarr,
    "v2.zarr": lambda path, clip=CLIP: save_zarr(path, clip, zarr_format=2),
    "bare.zarr": save_bare_zarr,
    "bare2.zarr": lambda path, clip=CLIP: save_bare_zarr(path, clip, zarr_format=2),
    "y.exr": save_exr,
}


def with_frame(k, value, at=...):
    clip = CLIP.copy()
    clip[k][at] = value
    return clip


def line_of(caught):
    text = str(caught.value)
    assert "\n" not in text
    return text


# -- what is read --------------------------------------------------------------------------------


@pytest.mark.parametrize("form", WRITERS)
def test_every_form_gives_the_frames_in_order(form, tmp_path):
    WRITERS[form](tmp_path / form)
    frames = open_frames(tmp_path / form, SHAPE)
    assert len(frames) == len(frames.names) == 12 and frames.warnings == ()
    for _ in range(2):  # as often as wanted
        values = [frame.values for frame in frames]
        assert all(v.dtype == np.float64 and v.flags.writeable for v in values)
        assert np.array_equal(values, CLIP)


def test_names_are_those_of_files_and_parts_and_numbers_of_the_rest(tmp_path):
    names = {}
    for form, write in WRITERS.items():
        write(tmp_path / form)
        names[form] = open_frames(tmp_path / form, SHAPE).names
    assert names.pop("folder") == tuple(f"y{k}.npy" for k in range(12))
    assert names.pop("y.exr") == tuple(f"part{k}" for k in range(12))
    assert set(names.values()) == {tuple(str(k) for k in range(12))}


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


def test_two_suffixes_of_one_format_go_together(tmp_path):
    for k, suffix in enumerate(("tif", "TIFF", "tiff")):
        FORMATS["TIF"](tmp_path / f"{k}.{suffix}", COUNTS[k])
    assert np.array_equal(read(tmp_path), COUNTS)


def test_other_files_are_left_out_by_name_and_hidden_ones_in_silence(tmp_path):
    save_folder(tmp_path / "y")
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


GREY_WRITERS = {
    "folder": save_folder,
    "y.npy": np.save,
    "y.npz": save_npz,
    "y.zarr": save_bare_zarr,
    "y.exr": lambda path, clip: save_exr(path, clip, channels="Y"),
}


@pytest.mark.parametrize("form", GREY_WRITERS)
def test_a_lone_channel_is_grey(form, tmp_path):
    grey = CLIP[..., :1]
    GREY_WRITERS[form](tmp_path / form, grey)
    assert np.array_equal(read(tmp_path / form), np.repeat(grey, 3, axis=3))


@pytest.mark.parametrize("dtype", [">f8", "<u2", "float16", "int32"])
def test_stack_of_any_real_type_is_read(dtype, tmp_path):
    clip = (CLIP * 100).astype(dtype)
    np.save(tmp_path / "y.npy", np.asfortranarray(clip))
    save_npz(tmp_path / "y.npz", clip)
    save_bare_zarr(tmp_path / "y.zarr", clip.astype(clip.dtype.newbyteorder("=")))
    for name in ("y.npy", "y.npz", "y.zarr"):
        assert np.array_equal(read(tmp_path / name), clip), name


@pytest.mark.parametrize("chunks", [(1, 6, 5, 3), (5, 2, 5, 1), (12, 6, 5, 3)])
@pytest.mark.parametrize("zarr_format", [2, 3])
def test_zarr_chunks_may_lie_anyhow(chunks, zarr_format, tmp_path):
    save_bare_zarr(tmp_path / "y.zarr", chunks=chunks, zarr_format=zarr_format)
    assert np.array_equal(read(tmp_path / "y.zarr"), CLIP)


def test_sharded_zarr_is_read(tmp_path):
    save_bare_zarr(tmp_path / "y.zarr", chunks=(1, 6, 5, 3), shards=(4, 6, 5, 3))
    frames = open_frames(tmp_path / "y.zarr", SHAPE)
    assert frames.warnings == () and np.array_equal([f.values for f in frames], CLIP)


def test_zarr_in_the_current_folder_is_read(tmp_path, monkeypatch):
    save_zarr(tmp_path / "y.zarr", with_frame(7, np.nan))
    monkeypatch.chdir(tmp_path / "y.zarr")
    with pytest.raises(PhotographError, match=r"^\., frame 7: "):
        read(".")


def test_exr_parts_keep_their_order_and_other_channels_are_left_out(tmp_path):
    clip = np.concatenate([CLIP, CLIP[..., :2]], axis=3)
    save_exr(tmp_path / "y.exr", clip, channels="RGBAZ")
    frames = open_frames(tmp_path / "y.exr", SHAPE)
    assert np.array_equal([frame.values for frame in frames], CLIP)
    assert frames.warnings == (f"{tmp_path / 'y.exr'}: left out the channels A, Z",)


def test_exr_of_one_part_is_one_frame(tmp_path):
    write_exr(tmp_path / "y.exr", CLIP[0], {})
    assert np.array_equal(read(tmp_path / "y.exr"), CLIP[:1])


@pytest.mark.parametrize("form", ["y.npy", "y.npz", "y.zarr", "folder"])
def test_one_frame_at_a_time_is_in_memory(form, tmp_path):
    shape = (200, 100)
    clip = np.ones((40, *shape, 3), np.float32)  # 9.6 MB; one frame in float64 takes 0.5 MB
    if form == "y.zarr":
        save_zarr(tmp_path / form, clip, chunks=(1, *shape, 3))
    else:
        WRITERS[form](tmp_path / form, clip)
    frames = iter(open_frames(tmp_path / form, shape))
    next(frames)  # what is imported on the way
    tracemalloc.start()
    try:
        for _ in frames:
            pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 1e5 < peak < 3e6


# -- what is refused -----------------------------------------------------------------------------


def place_of(form, k):
    return {"folder": f"folder/y{k}.npy"}.get(form, f"{form}, frame {k}")


@pytest.mark.parametrize("form", WRITERS)
@pytest.mark.parametrize(
    ("value", "at", "said"),
    [
        (
            np.nan,
            (3, 4, 1),
            "1 values are NaN or infinite, the first at row 3, column 4, channel 1",
        ),
        (-np.inf, (2,), "15 values are NaN or infinite, the first at row 2, column 0, channel 0"),
        (0, ..., "every value is zero"),
    ],
)
def test_bad_frame_is_named_when_its_turn_comes(form, value, at, said, tmp_path):
    WRITERS[form](tmp_path / form, with_frame(7, value, at))
    frames = open_frames(tmp_path / form, SHAPE)
    seen = []
    with pytest.raises(PhotographError) as caught:
        for frame in frames:
            seen.append(frame.values)
    assert np.array_equal(seen, CLIP[:7])
    assert line_of(caught).startswith(f"{tmp_path / place_of(form, 7)}: {said}")


@pytest.mark.parametrize("form", [form for form in WRITERS if form != "folder"])
def test_frames_of_another_size_are_refused_before_any_is_read(form, tmp_path):
    WRITERS[form](tmp_path / form)
    for shape, said in [((5, 6), "6 x 5 pixels"), ((3, 5), "6 x 5 pixels")]:
        with pytest.raises(PhotographError, match=said) as caught:
            open_frames(tmp_path / form, shape)
        assert line_of(caught).startswith(str(tmp_path / form))
        assert f"the scene's camera has {shape[0]} x {shape[1]}" in line_of(caught)


def test_photograph_of_another_size_in_a_folder_is_named(tmp_path):
    save_folder(tmp_path / "y")
    np.save(tmp_path / "y" / "y3.npy", CLIP[0, :-1])
    with pytest.raises(PhotographError, match=r"y3\.npy: 5 x 5 pixels"):
        read(tmp_path / "y")


@pytest.mark.parametrize("form", ["y.npy", "y.npz", "y.zarr", "bare.zarr"])
@pytest.mark.parametrize(
    ("clip", "said"),
    [
        (CLIP[0], "has shape (6, 5, 3); give a stack (frames, rows, columns, 3)"),
        (CLIP[..., :2], "has shape (12, 6, 5, 2)"),
        (CLIP[..., 0], "has shape (12, 6, 5)"),
        (CLIP[:0], "holds no frames"),
        (CLIP * 1j, "complex numbers"),
        (CLIP > 1.5, "truth values"),
    ],
)
def test_stack_of_another_form_is_refused(form, clip, said, tmp_path):
    if form == "y.zarr":
        group = zarr.create_group(tmp_path / form)
        group.create_array("photograph", data=clip)
    else:
        WRITERS[form](tmp_path / form, clip)
    with pytest.raises(PhotographError) as caught:
        open_frames(tmp_path / form, SHAPE)
    assert line_of(caught).startswith(f"{tmp_path / form}: ") and said in line_of(caught)


def test_folder_without_photographs_or_with_two_kinds_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(PhotographError, match=r"holds no file named \*\.exr, \*\.npy"):
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


def test_missing_array_is_told_with_those_that_are_there(tmp_path):
    np.savez(tmp_path / "y.npz", frames=CLIP)
    zarr.create_group(tmp_path / "y.zarr").create_array("frames", data=CLIP)
    zarr.create_group(tmp_path / "deep.zarr").create_group("photograph")
    for name, said in {
        "y.npz": "has no array 'photograph', only frames",
        "y.zarr": "has no array 'photograph', only frames",
        "deep.zarr": "'photograph' is a group",
    }.items():
        with pytest.raises(PhotographError, match=f"{name}: {said}"):
            open_frames(tmp_path / name, SHAPE)


def test_fortran_order_in_an_archive_is_refused(tmp_path):
    save_npz(tmp_path / "y.npz", np.asfortranarray(CLIP))
    with pytest.raises(PhotographError, match="Fortran order"):
        open_frames(tmp_path / "y.npz", SHAPE)


def test_packed_zarr_is_refused(tmp_path):
    dataset = xr.Dataset({"photograph": (("frame", "row", "column", "channel"), CLIP)})
    packing = {"dtype": "int16", "scale_factor": 1e-4, "add_offset": 0.5, "_FillValue": -1}
    dataset.to_zarr(tmp_path / "y.zarr", consolidated=False, encoding={"photograph": packing})
    with pytest.raises(PhotographError, match="packed by add_offset"):
        open_frames(tmp_path / "y.zarr", SHAPE)


@pytest.mark.parametrize("name", ["y.npy", "y.npz", "y.exr"])
@pytest.mark.parametrize("part", [0.02, 0.3, 0.6, 0.95])
def test_truncated_file_is_refused(name, part, tmp_path, capfd):
    WRITERS[name](tmp_path / name)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(part * len(content))])
    with pytest.raises(PhotographError) as caught:
        read(tmp_path / name)
    assert line_of(caught).startswith(str(tmp_path / name))
    assert capfd.readouterr() == ("", "")


def test_truncated_part_of_an_exr_is_named(tmp_path, capfd):
    save_exr(tmp_path / "y.exr")
    content = (tmp_path / "y.exr").read_bytes()
    (tmp_path / "y.exr").write_bytes(content[:-20])
    seen = []
    with pytest.raises(PhotographError, match=r"y\.exr, frame 11: truncated or damaged EXR"):
        for frame in open_frames(tmp_path / "y.exr", SHAPE):
            seen.append(frame.values)
    assert np.array_equal(seen, CLIP[:11])
    assert capfd.readouterr() == ("", "")


def test_archive_whose_checksum_is_wrong_is_refused(tmp_path):
    with (tmp_path / "y.npz").open("wb") as stream:
        np.savez(stream, photograph=CLIP)
    content = bytearray((tmp_path / "y.npz").read_bytes())
    place = bytes(content).index(CLIP[11, 5].tobytes())
    content[place] ^= 1
    (tmp_path / "y.npz").write_bytes(content)
    with pytest.raises(PhotographError, match=r"y\.npz, frame 11: .*CRC"):
        read(tmp_path / "y.npz")


def test_archive_that_holds_more_than_its_header_tells_is_refused(tmp_path):
    with (tmp_path / "y.npz").open("wb") as stream:
        np.savez(stream, photograph=CLIP)
    content = (tmp_path / "y.npz").read_bytes()
    assert b"(12, 6, 5, 3)" in content
    (tmp_path / "y.npz").write_bytes(content.replace(b"(12, 6, 5, 3)", b"(11, 6, 5, 3)"))
    with pytest.raises(PhotographError, match=r"y\.npz, frame 10: cannot be read as NPZ"):
        read(tmp_path / "y.npz")


def test_damaged_zarr_chunk_is_named_by_its_frames(tmp_path):
    save_bare_zarr(tmp_path / "y.zarr", chunks=(5, 6, 5, 3))
    (tmp_path / "y.zarr" / "c" / "1" / "0" / "0" / "0").write_bytes(b"torn")
    with pytest.raises(PhotographError, match=r"y\.zarr, frame 5 ff\.: cannot be read as Zarr"):
        read(tmp_path / "y.zarr")


def test_zarr_chunk_that_is_not_there_is_told(tmp_path):
    save_bare_zarr(tmp_path / "y.zarr", chunks=(12, 3, 5, 3))
    (tmp_path / "y.zarr" / "c" / "0" / "1" / "0" / "0").unlink()
    frames = open_frames(tmp_path / "y.zarr", SHAPE)
    assert frames.warnings[0].startswith(f"{tmp_path / 'y.zarr'}: 1 of 2 chunks are not there")
    assert (next(iter(frames)).values[3:] == 0).all()


def test_damaged_zarr_is_refused(tmp_path):
    save_zarr(tmp_path / "y.zarr")
    (tmp_path / "y.zarr" / "zarr.json").write_text("{")
    with pytest.raises(PhotographError, match=r"y\.zarr: cannot be read as Zarr"):
        open_frames(tmp_path / "y.zarr", SHAPE)


@pytest.mark.parametrize(
    ("channels", "said"), [("RG", "channels G, R;"), ("YZ", "channels Y, Z;"), ("A", "channels A;")]
)
def test_exr_part_without_one_colour_image_is_named(channels, said, tmp_path):
    save_exr(tmp_path / "y.exr", CLIP[:2, ..., : len(channels)], channels=channels)
    with pytest.raises(PhotographError, match=f"y.exr, frame 0: has {said}"):
        open_frames(tmp_path / "y.exr", SHAPE)


def test_exr_part_of_another_size_is_named(tmp_path):
    sizes = [CLIP[0], CLIP[0], CLIP[0, :-1]]
    window = (np.array([0, 0], np.int32), np.array([4, 5], np.int32))
    save_exr(tmp_path / "y.exr", sizes, displayWindow=window)
    with pytest.raises(PhotographError, match=r"y\.exr, frame 2: 5 x 5 pixels"):
        open_frames(tmp_path / "y.exr", SHAPE)


class Trap:
    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def test_pickles_are_never_loaded(tmp_path):
    crate = np.full(CLIP.shape, Trap(tmp_path / "sprung"), dtype=object)
    np.save(tmp_path / "y.npy", crate)
    np.savez(tmp_path / "y.npz", photograph=crate)
    # A Zarr array of numbers, as its header says, whose chunks a pickle filter decodes.
    save_bare_zarr(tmp_path / "y.zarr", zarr_format=2, chunks=CLIP.shape)
    header = json.loads((tmp_path / "y.zarr" / ".zarray").read_text())
    header |= {"filters": [{"id": "pickle", "protocol": 5}], "compressor": None}
    (tmp_path / "y.zarr" / ".zarray").write_text(json.dumps(header))
    (chunk,) = (tmp_path / "y.zarr").glob("0.*")
    chunk.write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
    for name in ("y.npy", "y.npz", "y.zarr"):
        with pytest.raises(PhotographError, match=r"Python objects|'pickle'"):
            read(tmp_path / name)
    assert not (tmp_path / "sprung").exists()


def test_archive_entry_that_is_no_array_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "y.npz", "w") as archive:
        archive.writestr("photograph.npy", b"a letter")
    with pytest.raises(PhotographError, match="cannot be read as NPZ"):
        open_frames(tmp_path / "y.npz", SHAPE)


# -- hidden frames -------------------------------------------------------------------------------

PATCHES = (2, 3)
SENT = RNG.integers(0, 256, (4, 4, 6, 3)).astype(np.uint8)


def averaged(light):
    """Means of 2 x 2 pixels."""
    return light.reshape(-1, 2, 2, 3, 2, 3).mean(axis=(2, 4))


def decoded(codes):
    shown = codes / 255
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def hidden(path, count=4):
    return np.array(list(read_hidden_frames(path, PATCHES, count)))


def test_folder_of_pictures_is_decoded_and_averaged_in_natural_order(tmp_path):
    for k, codes in zip((1, 2, 10, 11), SENT, strict=True):
        Image.fromarray(codes).save(tmp_path / f"f{k}.png")
    assert np.allclose(hidden(tmp_path), averaged(decoded(SENT)))


@pytest.mark.parametrize("scale", [1, 255, 65535])
def test_stack_of_hidden_frames_is_linear(scale, tmp_path):
    light = SENT / 255
    dtype = {1: np.float32, 255: np.uint8, 65535: np.uint16}[scale]
    np.save(tmp_path / "f.npy", np.rint(light * scale).astype(dtype) if scale > 1 else light)
    assert np.allclose(hidden(tmp_path / "f.npy"), averaged(light), atol=1e-6)


def test_one_image_stands_for_every_frame(tmp_path):
    light = SENT[0] / 255
    np.save(tmp_path / "f.npy", light)
    (tmp_path / "folder").mkdir()
    np.save(tmp_path / "folder" / "f.npy", light)
    np.save(tmp_path / "stack.npy", light[None])
    for name in ("f.npy", "folder", "stack.npy"):
        found = hidden(tmp_path / name)
        assert found.shape == (4, *PATCHES, 3) and np.allclose(found, averaged(light)), name


def test_grey_stack_has_three_equal_channels(tmp_path):
    np.save(tmp_path / "f.npy", SENT[..., :1] / 255)
    expected = averaged(np.repeat(SENT[..., :1] / 255, 3, axis=3))
    assert np.allclose(hidden(tmp_path / "f.npy"), expected)


def test_wrong_number_of_hidden_frames_is_refused(tmp_path):
    np.save(tmp_path / "f.npy", SENT)
    for count in (1, 3, 5):
        with pytest.raises(PhotographError) as caught:
            hidden(tmp_path / "f.npy", count)
        said = f"f.npy: holds 4 hidden images for {count} photographs; give as many, or one"
        assert line_of(caught).endswith(said)


@pytest.mark.parametrize(
    ("stack", "said"),
    [
        (
            np.where(np.arange(4)[:, None, None, None] == 2, -1.0, SENT),
            "frame 2: has negative, NaN",
        ),
        (
            np.where(np.arange(4)[:, None, None, None] == 3, np.nan, SENT),
            "frame 3: has negative, N",
        ),
        (SENT.astype(np.int32), "frame 0: holds int32"),
        (SENT[..., :2] / 1.0, "has shape (4, 6, 2)"),
        (SENT * 1j, "complex numbers"),
        (SENT[:0], "holds 0 hidden images"),
    ],
)
def test_stack_that_holds_no_light_is_refused(stack, said, tmp_path):
    np.save(tmp_path / "f.npy", stack)
    with pytest.raises(PhotographError) as caught:
        hidden(tmp_path / "f.npy")
    assert said in line_of(caught)


# -- writing -------------------------------------------------------------------------------------


def test_stack_written_frame_by_frame_is_the_file_that_numpy_writes(tmp_path):
    with npy_stack(tmp_path / "a.npy", CLIP.shape, np.float32) as write:
        for frame in CLIP.astype(np.float64):
            write(frame[::-1][::-1])
    np.save(tmp_path / "b.npy", CLIP)
    assert (tmp_path / "a.npy").read_bytes() == (tmp_path / "b.npy").read_bytes()
    assert np.array_equal(mapped_stack(tmp_path / "a.npy"), CLIP)


def test_unfinished_stack_does_not_pass_for_a_whole_one(tmp_path):
    with npy_stack(tmp_path / "a.npy", CLIP.shape, np.float64) as write:
        write(CLIP[0])
    with pytest.raises(PhotographError, match="cannot be read as NPY"):
        mapped_stack(tmp_path / "a.npy")


def test_import_brings_in_no_decoder():
    script = (
        "import sys, periscopy_sim.storage.frames, periscopy_sim.storage.stacks\n"
        "import periscopy_sim.storage.hidden_frames, periscopy_sim.storage.exr_frames\n"
        "heavy = {'mitsuba', 'scipy', 'OpenEXR', 'tifffile', 'PIL', 'png', 'zarr', 'xarray'}\n"
        "print(*heavy & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert run.stdout.strip() == ""
