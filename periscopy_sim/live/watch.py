"""From Python: photographs as they come, reconstructed on a page."""

from collections.abc import Callable, Mapping
from typing import Any

from numpy.typing import ArrayLike

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.frames import open_source
from periscopy_sim.live.pictures import Choice, LivePictures
from periscopy_sim.live.preparation import Companions
from periscopy_sim.live.session import LiveSession
from periscopy_sim.live.stream import Progress, Stream
from periscopy_sim.methods import find_method
from periscopy_sim.numerics import Mask
from periscopy_sim.photographs.develop import SensorImage, sensor_image
from periscopy_sim.photographs.marks import WallPoints, WallTags
from periscopy_sim.reconstruction.registry import DEFAULT, installed_methods
from periscopy_sim.scenario import Scenario


def watch(
    source: str | Callable[[], Any],
    scenario: Scenario,
    *,
    average: int = 30,
    marks: WallPoints | WallTags | None = None,
    mask: Mask | None = None,
    dark: SensorImage | ArrayLike | None = None,
    monitor_off: Mapping[str, SensorImage | ArrayLike] | None = None,
    white: float | None = None,
    linear: bool = False,
    method: str = DEFAULT,
    record: Callable[[LivePictures, Progress], None] = lambda *_: None,
    save: Callable[[LivePictures], str] = lambda _: "give watch() a function `save`",
    host: str = "127.0.0.1",
    port: int = 8080,
) -> None:
    """Show what a camera's frames reveal on a page, until the source ends.

    It prints the page's address and what happens, one line each.

    Parameters
    ----------
    source
        A folder; or a function, itself or as ``file.py:function``, that returns the next frame when
        the camera has it, (rows, columns[, channels]), and None at the end.
    scenario
        The scene of the frames.
    average
        Frames of the running average.
    marks, mask
        As of `prepare`.
    dark, monitor_off
        Frames with the lens covered, and with the monitor off, by name: linear light, of the
        frames' size.
    white
        The value from which on a pixel is saturated, such as 4095 of 12 bits. None: the largest of
        a function's integers, and what a folder's files say.
    linear
        Whether a function's integers are linear light; otherwise the sRGB curve decodes them.
    method
        Name of the first method, see `find_method`.
    record
        Called with the pictures of each frame, whose `image` is the hidden one, and its numbers.
    save
        Called with the full pictures when the page's button is pressed; returns a line to show.
    host, port
        Where to listen; port 0 takes a free one.

    Raises
    ------
    PeriscopyError
        If there is no such source or method, the function raises an error, the first two frames
        cannot be used, the port is taken, or an extra is not installed.
    """
    find_method(method)
    if average < 1:
        raise PeriscopyError(f"average is {average}; give 1 frame or more")
    companions = Companions(
        marks, mask, 0.0, None if dark is None else sensor_image(dark, "the dark frame"),
        {name: sensor_image(each, name) for name, each in (monitor_off or {}).items()},
    )  # fmt: skip
    frames = open_source(source, linear=linear, white=white)
    stream = Stream(frames, scenario, companions, average, print)
    with LiveSession(
        scenario, Choice({}, "", method=method), (), installed_methods(), save, lambda _: (),
        stream=stream, record=record, host=host, port=port,
    ) as session:  # fmt: skip
        print(session.page.gate.url, flush=True)
        session.run()
    if stream.fault is not None:
        raise stream.fault
