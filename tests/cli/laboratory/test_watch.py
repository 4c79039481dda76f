import csv
import errno
import json
import socket
import sys

import numpy as np
import pytest
import tifffile
from PIL import Image

import periscopy_sim as ps
from periscopy_sim.storage.formats.decoding import LINEAR
from periscopy_sim.storage.formats.srgb import srgb_bytes
from periscopy_sim.storage.photographs import read_sensor_image
from tests.scenes.videos import write_video

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


def test_a_video_is_watched_to_its_end_and_recorded(codes, periscopy, tmp_path):
    pytest.importorskip("av")
    pytest.importorskip("websockets")
    write_video(tmp_path / "wall.mkv", codes)
    mask = np.ones((24, 24), bool)
    mask[:, :2] = False
    np.save(tmp_path / "mask.npy", mask)
    ran = periscopy(
        "watch", "wall.mkv", *SCENE, "--mask", "mask.npy", "--port", 0, "--average", 50,
        "--out", "out",
    )  # fmt: skip
    assert ran.code == 0 and "15 frames shown, 0 dropped" in ran.out
    assert "decoded by the sRGB curve" in ran.told
    assert len([*(tmp_path / "out").iterdir()]) == 3
    images = np.load(tmp_path / "out" / "frames.npy")
    assert images.shape == (15, 3, 4, 3)
    psnrs = [ps.psnr_gain_matched(image, IMAGE) for image in images]
    assert psnrs[-1] > 30 and psnrs[-1] > psnrs[0]
    with (tmp_path / "out" / "metrics.csv").open() as table:
        rows = [*csv.DictReader(table)]
    assert [row["frame"] for row in rows] == [str(k) for k in range(15)]
    assert float(rows[-1]["averaged"]) == pytest.approx(15)
    assert {row["method"] for row in rows} == {"noise-aware"} and float(rows[-1]["time"]) > 0
    assert float(rows[-1]["noise_left"]) < float(rows[1]["noise_left"])
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["frames"] == 15 and summary["median_latency"] > 0
    assert summary["diagnosis"] == "fits" and "The scene fits" in ran.out


def test_a_video_of_which_no_frame_can_be_shown_ends_with_the_reason(codes, periscopy, tmp_path):
    pytest.importorskip("av")
    pytest.importorskip("websockets")
    write_video(tmp_path / "wall.mkv", codes[:3])
    few = np.zeros((24, 24), bool)
    few[0, :3] = True
    np.save(tmp_path / "few.npy", few)
    write_video(tmp_path / "odd.mkv", codes[:3, :94])
    for options, reason in {
        ("wall.mkv", "--mask", "few.npy"): "wall.mkv: no frame was shown",
        ("odd.mkv",): "94 x 96 pixels",
    }.items():
        ended = periscopy("watch", *options, *SCENE, "--port", 0, "--out", "out")
        assert ended.code == 2 and reason in ended.err.splitlines()[-1]
        assert not (tmp_path / "out").exists()


def test_what_cannot_be_watched_is_refused_in_a_line(refused, tmp_path, monkeypatch):
    pytest.importorskip("av")
    pytest.importorskip("websockets")
    np.save(tmp_path / "dark.npy", np.ones((4, 4, 3)))
    codes = np.arange(24 * 24 * 3).reshape(24, 24, 3)
    write_video(tmp_path / "v.mkv", codes.astype(np.uint8)[None])
    tifffile.imwrite(tmp_path / "deep.tif", codes.astype(np.uint16), photometric="rgb")
    (tmp_path / "frames").mkdir()
    (tmp_path / "x.csv").write_text("")
    for options, offender in {
        ("nowhere",): "nowhere: no such folder, device or file",
        ("frames", "--points", "x.csv", "--tags", "x.csv"): "--points and --tags",
        ("frames", "--dark", "dark.npy", "--black", "9"): "black level",
        ("v.mkv", "--black", "9"): "add --linear",
        ("v.mkv", "--dark", "deep.tif"): "deep.tif: 16-bit TIFF, but the frames are encoded",
        ("frames", "--method", "nonsense"): "nonsense",
        ("frames", "--average", "0"): "--average",
        ("frames", "--out", "x.csv"): "x.csv",
    }.items():
        assert offender in refused("watch", *options, *SCENE, "--port", 0)
    monkeypatch.setitem(sys.modules, "av", None)
    assert "'.[video]'" in refused("watch", "rtsp://camera", *SCENE)


def test_what_a_stream_reports_is_in_the_json(codes, periscopy, tmp_path):
    pytest.importorskip("av")
    pytest.importorskip("websockets")
    write_video(tmp_path / "wall.mkv", codes[:3])
    ran = periscopy("watch", "wall.mkv", *SCENE, "--port", 0, "--json")
    record = json.loads(ran.out)
    assert record["frames_shown"] == 3 and "sRGB curve" in record["warnings"][0]


def test_a_recording_is_not_replaced(codes, refused, tmp_path):
    pytest.importorskip("av")
    pytest.importorskip("websockets")
    write_video(tmp_path / "wall.mkv", codes[:3])
    (tmp_path / "out").mkdir()
    for name in ("metrics.csv", "summary.json", "frames.npy"):
        (tmp_path / "out" / name).write_text("former")
    assert refused("watch", "wall.mkv", *SCENE, "--port", 0, "--out", "out").startswith("out ")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        new = ("--port", port, "--out", "new")
        assert str(port) in refused("watch", "wall.mkv", *SCENE, *new)  # and makes no folder


def test_a_record_that_cannot_be_written_ends_the_command_in_a_line(
    codes, periscopy, tmp_path, monkeypatch
):
    pytest.importorskip("av")
    pytest.importorskip("websockets")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    write_video(tmp_path / "wall.mkv", codes[:3])
    monkeypatch.setattr(csv.DictWriter, "writerow", full)
    ended = periscopy("watch", "wall.mkv", *SCENE, "--port", 0, "--out", "out")
    assert ended.code == 2 and "No space left" in ended.err and "Traceback" not in ended.told
    assert ended.err.splitlines()[-1].startswith("periscopy: error: cannot write")


def test_a_dark_frame_of_linear_video_is_linear(codes, periscopy, tmp_path):
    pytest.importorskip("av")
    pytest.importorskip("websockets")
    write_video(tmp_path / "wall.mkv", codes[:2])
    Image.fromarray(codes[0]).save(tmp_path / "dark.png")
    files = "--dark", "dark.png", "--monitor-off", "dark.png"
    ended = periscopy("watch", "wall.mkv", *SCENE, "--port", 0, "--linear", *files)
    assert "taken as linear light" in ended.told and "sRGB curve" not in ended.told
    dark, warnings = read_sensor_image(tmp_path / "dark.png", encoding=LINEAR)
    np.testing.assert_array_equal(dark.values, codes[0])
    assert not warnings
