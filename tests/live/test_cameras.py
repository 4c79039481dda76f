"""The cameras that the command prints and the page shows: those without a device here, too."""

import re
import sys
from pathlib import Path
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest

from periscopy_sim.cli.laboratory import EXAMPLE
from periscopy_sim.live.frames import open_source

PAGE = (Path(__file__).parents[2] / "docs" / "watch.md").read_text("utf-8")
BLOCKS = dict(re.findall(r"^```python file=(\w+)_camera.py\n(.*?)^```$", PAGE, re.M | re.S))
CODES = np.random.default_rng(3).integers(0, 256, (5, 16, 24, 3), np.uint8)
"""Red differs from blue."""


def frames_of(text, folder):
    (folder / "mine.py").write_text(text)
    frames = [*open_source(f"{folder / 'mine.py'}:frame")(Event(), print)]
    return [each.values for each in frames]


def write_video(path):
    """Write the codes without loss."""
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", 100)
        stream.height, stream.width = CODES.shape[1:3]
        stream.pix_fmt = "bgr0"
        for codes in CODES:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(codes, format="rgb24")))
        container.mux(stream.encode(None))


def test_the_printed_camera_decodes_a_file(tmp_path):
    write_video(tmp_path / "wall.mkv")
    text = EXAMPLE.read_text("utf-8").replace("/dev/video0", str(tmp_path / "wall.mkv"))
    np.testing.assert_array_equal(frames_of(text, tmp_path), CODES)


def test_the_camera_of_opencv_decodes_a_file(tmp_path):
    pytest.importorskip("cv2")
    write_video(tmp_path / "wall.mkv")
    text = BLOCKS["opencv"].replace("VideoCapture(0)", f"VideoCapture('{tmp_path}/wall.mkv')")
    np.testing.assert_array_equal(frames_of(text, tmp_path), CODES)


class Picamera2:
    """Returns frames of the format that it was configured for; see its manual, appendix A."""

    def create_video_configuration(self, main):
        return main

    def configure(self, configuration):
        self.step = {"BGR888": 1, "RGB888": -1}[configuration["format"]]

    def set_controls(self, controls):
        assert "ExposureTime" in controls

    def start(self):
        self.frames = iter([*CODES, None])

    def capture_array(self):
        frame = next(self.frames)
        return None if frame is None else frame[..., :: self.step]


class InstantCamera:
    """Gives each frame in a buffer that is free after its release."""

    def __init__(self, device):
        assert device == "first"
        self.PixelFormat, self.is_open = SimpleNamespace(Value="Mono8"), False

    def Open(self):  # noqa: N802
        self.is_open = True

    def StartGrabbing(self, strategy):  # noqa: N802
        assert strategy == "latest" and self.is_open
        self.frames = iter([*(16 * CODES[..., 0].astype(np.uint16)), None])

    def RetrieveResult(self, timeout, handling):  # noqa: N802
        assert timeout > 100 and handling == "raise" and self.PixelFormat.Value == "Mono12"
        return SimpleNamespace(Array=next(self.frames), Release=lambda: None)


def test_cameras_without_a_device_here_return_frames_by_a_stand_in(tmp_path, monkeypatch):
    factory = SimpleNamespace(CreateFirstDevice=lambda: "first")
    pylon = SimpleNamespace(
        InstantCamera=InstantCamera, TlFactory=SimpleNamespace(GetInstance=lambda: factory),
        GrabStrategy_LatestImageOnly="latest", TimeoutHandling_ThrowException="raise",
    )  # fmt: skip
    monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=Picamera2))
    monkeypatch.setitem(sys.modules, "pypylon", SimpleNamespace(pylon=pylon))
    np.testing.assert_array_equal(frames_of(BLOCKS["pi"], tmp_path), CODES)
    grey = frames_of(BLOCKS["basler"], tmp_path)
    np.testing.assert_array_equal(grey, 16 * CODES[..., :1].astype(np.uint16))
    assert BLOCKS.keys() == {"opencv", "pi", "basler"}
