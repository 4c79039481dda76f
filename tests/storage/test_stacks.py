"""Frames stacked in NPY and NPZ files and in Zarr archives."""

import json
import os
import pickle

import numpy as np
import pytest
import xarray as xr
import zarr

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.arrays import mapped_stack
from periscopy_sim.storage.sequences import npy_writer, open_frames

SHAPE = (6, 5)
CLIP = np.random.default_rng(17).uniform(1, 2, (12, *SHAPE, 3)).astype(np.float32)


def read(path):
    return [frame.values for frame in open_frames(path, SHAPE)]


@pytest.mark.parametrize("chunks", [(1, 6, 5, 3), (5, 2, 5, 1), (12, 6, 5, 3)])
@pytest.mark.parametrize("zarr_format", [2, 3])
def test_zarr_chunks_may_lie_anyhow(chunks, zarr_format, save, tmp_path):
    save.bare_zarr(tmp_path / "y.zarr", CLIP, chunks=chunks, zarr_format=zarr_format)
    assert np.array_equal(read(tmp_path / "y.zarr"), CLIP)


@pytest.mark.parametrize("form", ["y.npy", "y.npz", "bare.zarr"])
@pytest.mark.parametrize(
    "clip", [CLIP[0], CLIP[..., :2], CLIP[..., 0], CLIP[:0], CLIP * 1j, CLIP > 1.5]
)
def test_stack_of_another_form_is_refused(form, clip, save, line_of, tmp_path):
    save.by_name(tmp_path / form, clip)
    with pytest.raises(PhotographError) as caught:
        open_frames(tmp_path / form, SHAPE)
    assert line_of(caught).startswith(f"{tmp_path / form}: ")


def test_missing_array_is_reported_with_those_that_are_there(tmp_path):
    np.savez(tmp_path / "y.npz", frames=CLIP)
    zarr.create_group(tmp_path / "y.zarr").create_array("frames", data=CLIP)
    for name in ("y.npz", "y.zarr"):
        with pytest.raises(PhotographError, match=f"{name}: .*'photograph', only frames"):
            open_frames(tmp_path / name, SHAPE)


@pytest.mark.parametrize("zarr_format", [2, 3])
@pytest.mark.parametrize(
    "packing",
    [
        {"dtype": "int16", "scale_factor": 1e-4, "add_offset": 0.5, "_FillValue": -1},
        {"dtype": "uint16", "_FillValue": 65535},
        {"_FillValue": 999.0},
    ],
)
def test_values_that_stand_for_others_are_refused(zarr_format, packing, tmp_path):
    """xarray writes a missing photograph, NaN, as its fill value: 65535 is no light."""
    clip = CLIP.astype(packing["dtype"]) if packing.get("_FillValue") == 65535 else CLIP
    dataset = xr.Dataset({"photograph": (("frame", "row", "column", "channel"), clip)})
    settings = {"zarr_format": zarr_format, "consolidated": False}
    dataset.to_zarr(tmp_path / "y.zarr", encoding={"photograph": packing}, **settings)
    with pytest.raises(PhotographError, match=r"y\.zarr"):
        open_frames(tmp_path / "y.zarr", SHAPE)


def test_damaged_zarr_chunk_is_named_by_its_frame(save, tmp_path):
    save.bare_zarr(tmp_path / "y.zarr", CLIP, chunks=(5, 6, 5, 3))
    (tmp_path / "y.zarr" / "c" / "1" / "0" / "0" / "0").write_bytes(b"torn")
    with pytest.raises(PhotographError, match=r"y\.zarr, frame 5: "):
        read(tmp_path / "y.zarr")


def test_zarr_chunk_that_is_not_there_is_told(save, tmp_path):
    save.bare_zarr(tmp_path / "y.zarr", CLIP, chunks=(12, 3, 5, 3))
    (tmp_path / "y.zarr" / "c" / "0" / "1" / "0" / "0").unlink()
    frames = open_frames(tmp_path / "y.zarr", SHAPE)
    assert frames.warnings[0].startswith(f"{tmp_path / 'y.zarr'}: 1 of 2 chunks")
    assert (next(iter(frames)).values[3:] == 0).all()


class Trap:
    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def test_pickles_are_never_loaded(save, tmp_path):
    crate = np.full(CLIP.shape, Trap(tmp_path / "sprung"), dtype=object)
    np.save(tmp_path / "y.npy", crate)
    np.savez(tmp_path / "y.npz", photograph=crate)
    # A Zarr array of numbers, as its header says, whose chunks a pickle filter decodes.
    save.bare_zarr(tmp_path / "y.zarr", CLIP, zarr_format=2, chunks=CLIP.shape)
    header = json.loads((tmp_path / "y.zarr" / ".zarray").read_text())
    header |= {"filters": [{"id": "pickle", "protocol": 5}], "compressor": None}
    (tmp_path / "y.zarr" / ".zarray").write_text(json.dumps(header))
    (chunk,) = (tmp_path / "y.zarr").glob("0.*")
    chunk.write_bytes(pickle.dumps(Trap(tmp_path / "sprung")))
    for name in ("y.npy", "y.npz", "y.zarr"):
        with pytest.raises(PhotographError, match=r"pickle|Python objects"):
            read(tmp_path / name)
    assert not (tmp_path / "sprung").exists()


def test_stack_written_frame_by_frame_is_the_file_that_numpy_writes(tmp_path):
    with npy_writer(tmp_path / "a.npy", CLIP.shape, np.float32) as write:
        for frame in CLIP.astype(np.float64):
            write(frame[::-1][::-1])
    np.save(tmp_path / "b.npy", CLIP)
    assert (tmp_path / "a.npy").read_bytes() == (tmp_path / "b.npy").read_bytes()
    assert np.array_equal(mapped_stack(tmp_path / "a.npy"), CLIP)
