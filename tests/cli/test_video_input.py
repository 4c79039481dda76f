"""The sequences that `periscopy video` takes, and those that it refuses."""

import numpy as np
import OpenEXR
import pytest
import xarray as xr
from PIL import Image

pytestmark = pytest.mark.usefixtures("jit", "few_lights")


def save_exr(path, clip):
    parts = [
        OpenEXR.Part(
            {"name": f"t{k}"}, {c: y[..., i].astype(np.float32) for i, c in enumerate("RGB")}
        )
        for k, y in enumerate(clip)
    ]
    with OpenEXR.File(parts) as file:
        file.write(str(path))


def save_zarr(path, clip):
    dimensions = ("frame", "row", "column", "channel")
    xr.Dataset({"photograph": (dimensions, clip)}).to_zarr(path, zarr_format=3, consolidated=False)


def save_folder(path, clip):
    path.mkdir()
    for k, y in enumerate(clip):
        np.save(path / f"y{k}.npy", y)


WRITERS = {
    "y.npy": np.save,
    "y.npz": lambda path, clip: np.savez(path, photograph=clip),
    "y.zarr": save_zarr,
    "y.exr": save_exr,
    "folder": save_folder,
}


def test_every_form_gives_the_same_video(few_photographs, video, tmp_path):
    clip = few_photographs.astype(np.float32)
    found = {}
    for form, write in WRITERS.items():
        write(tmp_path / form, clip)
        found[form], _, table = video(form)
        names = {"y.exr": "t{}", "folder": "y{}.npy"}.get(form, "{}")
        assert [row["name"] for row in table] == [names.format(k) for k in range(3)]
    assert all(np.array_equal(frames, found["y.npy"]) for frames in found.values())


def test_what_holds_for_many_photographs_is_said_once(periscopy, tiny, results, tmp_path):
    (tmp_path / "y").mkdir()
    for k in range(5):
        codes = np.random.default_rng(k).integers(99, 256, (24, 24, 3)).astype(np.uint8)
        Image.fromarray(codes).save(tmp_path / "y" / f"{k}.png")
    (tmp_path / "y" / "notes.txt").write_text("x")
    outcome = periscopy("video", "y", *tiny, "--out", "out")
    left_out, gamma, doubt = outcome.err.splitlines()
    assert outcome.code == 0 and left_out == "periscopy: warning: y: left out notes.txt"
    assert gamma.startswith("periscopy: warning: y/0.png: 8-bit PNG, which is normally gamma")
    assert gamma.endswith(" (likewise 4 more)")
    _, summary, _ = results(tmp_path / "out")
    said = [f"periscopy: warning: {warning}" for warning in summary["warnings"]]
    assert said == [left_out, gamma, doubt] and "frame 0.png: " in doubt


def test_frames_that_show_nothing_are_told_by_one_line(
    periscopy, photographs, tiny, results, tmp_path
):
    clip = np.ones((4, 24, 24, 3)) * np.arange(1, 5)[:, None, None, None]
    clip[1] = photographs[0]
    np.save(tmp_path / "y.npy", clip)
    outcome = periscopy("video", "y.npy", *tiny, "--out", "out")
    (line,) = outcome.err.splitlines()
    assert outcome.code == 0 and line.startswith("periscopy: warning: y.npy, frame 0: ")
    assert "hidden image: " in line and line.endswith(" (likewise 2 more)")
    assert results(tmp_path / "out")[1]["warnings"] == [line.partition("warning: ")[2]]


# -- what is refused -----------------------------------------------------------------------------


def test_pictures_of_a_longer_video_are_not_mixed_with_this_one(
    photographs, video, refused, tiny, tmp_path
):
    np.save(tmp_path / "y.npy", photographs)
    np.save(tmp_path / "short.npy", photographs[:4])
    video("y.npy")
    line = refused("video", "short.npy", *tiny, "--out", "out")
    assert line.startswith("out/frames/0004.png is of a longer video; remove out/frames")
    frames, _, _ = video("y.npy", "--coupling", "none")  # the same length may replace it
    assert len(frames) == 9
