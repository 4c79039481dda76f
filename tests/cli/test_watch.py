import csv
import errno
import json
import os
import signal
import socket
from functools import partial, partialmethod

import numpy as np
import pytest
import tifffile
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.cli.laboratory import Recorder
from periscopy_sim.cli.session import Session
from periscopy_sim.storage.photographs import read_sensor_image
from periscopy_sim.storage.rasters import LINEAR, srgb_bytes

pytest.importorskip("websockets")
pytestmark = pytest.mark.usefixtures("jit")
SCENE = ("--scene", "plate", "--hidden", "3x4", "-D", "resolution=24")
IMAGE = ps.read_hidden_image(ps.find_image("bars"), (3, 4))


@pytest.fixture(scope="module")
def codes():
    """Frames of the plate's wall, 4 x 4 pixels for one of the film's, black 8 bits at the left."""
    scenario = ps.load_scenario("plate", (3, 4), {"resolution": "24"})
    light = (ps.transport(scenario) @ IMAGE.reshape(-1, 3)).reshape(24, 24, 3)
    light = (0.3 * light / light.mean() + 0.1).repeat(4, axis=0).repeat(4, axis=1)
    rng = np.random.default_rng(0)
    frames = light * (1 + rng.normal(0, 0.01, (15, *light.shape)))
    return srgb_bytes(frames + rng.uniform(-0.002, 0.002, frames.shape))


CAMERA = """
import time
import numpy as np
shots = iter(np.load(__file__.replace(".py", ".npy")))
def frame():
    time.sleep(0.02)
    return next(shots, None)
"""


@pytest.fixture
def camera(tmp_path):
    """Write a camera that returns frames in turn, of a name; return what `watch` takes."""

    def make(frames, name="wall"):
        np.save(tmp_path / f"{name}.npy", frames)
        (tmp_path / f"{name}.py").write_text(CAMERA)
        return f"{name}.py:frame"

    return make


def test_a_camera_is_watched_to_its_end_and_recorded(codes, camera, periscopy, tmp_path):
    mask = np.ones((24, 24), bool)
    mask[:, :2] = False
    np.save(tmp_path / "mask.npy", mask)
    ran = periscopy(
        "watch", camera(codes), *SCENE, "--mask", "mask.npy", "--port", 0, "--average", 50,
        "--out", "out",
    )  # fmt: skip
    assert ran.code == 0 and "decoded by the sRGB curve" in ran.told
    assert len([*(tmp_path / "out").iterdir()]) == 3
    images = np.load(tmp_path / "out" / "frames.npy")
    with (tmp_path / "out" / "metrics.csv").open() as table:
        rows = [*csv.DictReader(table)]
    assert images.shape == (len(rows), 3, 4, 3)
    assert ps.psnr_gain_matched(images[-1], IMAGE) > 30
    assert {row["method"] for row in rows} == {"noise-aware"} and float(rows[-1]["time"]) >= 0
    assert float(rows[-1]["averaged"]) > 5
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["frames"] == len(rows) and summary["median_latency"] > 0
    assert summary["frames_shown"] + summary["frames_dropped"] == len(codes)
    assert summary["diagnosis"] == "fits" and "The scene fits" in ran.out


def test_a_camera_of_which_no_frame_can_be_shown_ends_with_the_reason(
    codes, camera, periscopy, tmp_path
):
    few = np.zeros((24, 24), bool)
    few[0, :3] = True
    np.save(tmp_path / "few.npy", few)
    (tmp_path / "broken.py").write_text("def frame():\n    return [][0]\n")
    for options, reason in {
        (camera(codes[:3]), "--mask", "few.npy"): "no frame was shown",
        (camera(codes[:3, :94], "odd"),): "94 x 96 pixels",
        (camera(codes[:0], "none"),): "no frame was shown",
        ("broken.py:frame",): "IndexError: list index out of range (broken.py:2)",
    }.items():
        ended = periscopy("watch", *options, *SCENE, "--port", 0, "--out", "out")
        assert ended.code == 2 and reason in ended.err.splitlines()[-1]
        assert not (tmp_path / "out").exists()


def test_what_cannot_be_watched_is_refused_in_a_line(codes, camera, refused, tmp_path):
    wall = camera(codes[:1])
    np.save(tmp_path / "dark.npy", np.ones((4, 4, 3)))
    deep = np.arange(24 * 24 * 3, dtype=np.uint16).reshape(24, 24, 3)
    tifffile.imwrite(tmp_path / "deep.tif", deep, photometric="rgb")
    (tmp_path / "frames").mkdir()
    (tmp_path / "x.csv").write_text("")
    for options, offender in {
        ("nowhere",): "nowhere: is no folder",
        ("x.csv",): "x.csv: is no folder",
        ("wall.py:shots",): "is no function",
        ("frames", "--points", "x.csv", "--tags", "x.csv"): "--points and --tags",
        ("frames", "--dark", "dark.npy", "--black", "9"): "black level",
        (wall, "--black", "9"): "add --linear",
        (wall, "--white", "9"): "add --linear",
        (wall, "--dark", "deep.tif"): "deep.tif: 16-bit TIFF, but the frames are encoded",
        ("frames", "--method", "nonsense"): "nonsense",
        ("frames", "--average", "0"): "--average",
        ("frames", "--out", "x.csv"): "x.csv",
    }.items():
        assert offender in refused("watch", *options, *SCENE, "--port", 0)


def test_a_recording_is_not_replaced(codes, camera, refused, tmp_path):
    wall = camera(codes[:3])
    (tmp_path / "out").mkdir()
    for name in ("metrics.csv", "summary.json", "frames.npy"):
        (tmp_path / "out" / name).write_text("former")
    assert refused("watch", wall, *SCENE, "--port", 0, "--out", "out").startswith("out ")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        new = ("--port", port, "--out", "new")
        assert str(port) in refused("watch", wall, *SCENE, *new)  # and makes no folder


def test_a_record_that_cannot_be_written_ends_the_command_in_a_line(
    codes, camera, periscopy, monkeypatch
):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(csv.DictWriter, "writerow", full)
    ended = periscopy("watch", camera(codes[:3]), *SCENE, "--port", 0, "--out", "out")
    assert ended.code == 2 and "No space left" in ended.err and "Traceback" not in ended.told
    assert ended.err.splitlines()[-1].startswith("periscopy: error: cannot write")


def test_a_dark_frame_of_linear_codes_is_linear(codes, camera, periscopy, tmp_path):
    Image.fromarray(codes[0]).save(tmp_path / "dark.png")
    files = "--dark", "dark.png", "--monitor-off", "dark.png"
    ended = periscopy("watch", camera(codes[:2]), *SCENE, "--port", 0, "--linear", *files)
    assert "taken as linear light" in ended.told and "sRGB curve" not in ended.told
    dark, warnings = read_sensor_image(tmp_path / "dark.png", encoding=LINEAR)
    np.testing.assert_array_equal(dark.values, codes[0])
    assert not warnings


def test_interrupts_in_a_row_leave_a_whole_recording(codes, camera, periscopy, monkeypatch):
    """As a terminal and a program send both: the second one comes while the summary is written."""
    write = Session.write_summary
    interrupt = partial(os.kill, os.getpid(), signal.SIGINT)

    def interrupted(*given):
        interrupt()
        return write(*given)

    monkeypatch.setattr(Session, "write_summary", interrupted)
    monkeypatch.setattr(Recorder, "__call__", partialmethod(interrupting, interrupt))
    ended = periscopy("watch", camera(codes), *SCENE, "--port", 0, "--out", "out")
    assert ended.code == 0 and "wrote out/summary.json" in ended.out


RECORD = Recorder.__call__


def interrupting(recorder, interrupt, *given):
    """Record pictures, and interrupt the command after the first full ones."""
    RECORD(recorder, *given)
    if recorder._count == 1:
        interrupt()
