"""A camera for `periscopy watch camera.py:frame`: a device, a stream or a file, by PyAV.

Check what it decodes: white must be 255, and twice the light must be twice the decoded light.
"""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av

SOURCE = "/dev/video0"  # or "rtsp://...", "http://...", "wall.mkv"


def decoded() -> Iterator[Any]:
    """Yield codes of 8 bits, (rows, columns, 3)."""
    with av.open(SOURCE, format="v4l2" if SOURCE.startswith("/dev/") else None) as video:
        for picture in video.decode(video=0):
            if Path(SOURCE).is_file():  # in its own time
                time.sleep(1 / float(video.streams.video[0].average_rate))
            yield picture.to_ndarray(format="rgb24")


pictures = decoded()


def frame() -> Any:
    """Return the next picture, None at the end."""
    return next(pictures, None)
