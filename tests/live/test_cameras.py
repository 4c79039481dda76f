"""The cameras that the command prints and the page shows: those without a device here, too."""

import re
from pathlib import Path
from threading import Event

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
