"""Frames as they come: from a folder, from a video by FFmpeg's libraries, or from a function.

A source yields each frame as soon as it is whole. It reports a fault in one line and goes on where
it can.
"""

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Condition, Event
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.extras import require
from periscopy_sim.photographs.develop import SensorImage, sensor_image
from periscopy_sim.storage.formats.decoding import LINEAR, SRGB
from periscopy_sim.storage.formats.table import suffixes
from periscopy_sim.storage.photographs import read_sensor_image

POLL = 0.2
"""Seconds between two looks at a folder; a file whose size stays the same between them is whole."""

PATIENCE = 10.0
"""Seconds that a file may stay unreadable, as while it is written, or a stream without a frame."""

RETRIES, PAUSE = 10, 2.0
"""Attempts to open a stream again that ended or stalled, and the seconds before each."""

LINEAR_TRANSFER = 8
"""FFmpeg's number of linear light (ITU-T H.273)."""

Item = TypeVar("Item")
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One photograph of a series.

    `values` are codes of 8 or 16 bits, (rows, columns, channels), of the `encoding` sRGB or linear;
    or a `SensorImage`, linear light. `time` is that of `time.monotonic` when the frame arrived.
    """

    values: NDArray[np.unsignedinteger] | SensorImage
    encoding: str = SRGB
    time: float = field(default_factory=time.monotonic)

    @property
    def size(self) -> tuple[int, int]:
        """(rows, columns)."""
        pixels = self.values.values if isinstance(self.values, SensorImage) else self.values
        rows, columns = pixels.shape[:2]
        return rows, columns


class FrameSource(Protocol):
    """Where frames come from.

    Late frames of a live source are dropped; another one, a recording, waits. `dropped` counts the
    frames that the source itself left out.
    """

    is_live: bool
    dropped: int

    def frames(self, stopped: Event, say: Say) -> Iterator[CameraFrame]:
        """Yield frames until the source ends, or `stopped` is set; `say` reports in one line."""


class Latest(Generic[Item]):
    """A place for one item between two threads: a newer item replaces it, and is counted.

    With `keeps`, `put` waits for the place instead, and no item is dropped. Iterate to take the
    items until `close`.
    """

    def __init__(self, *, keeps: bool = False) -> None:
        self.dropped, self._keeps = 0, keeps
        self._item: Item | None = None
        self._taken: Item | None = None
        self._closed, self._changed = False, Condition()

    def put(self, item: Item) -> None:
        """Offer an item."""
        with self._changed:
            if self._keeps:
                self._changed.wait_for(lambda: self._item is None or self._closed)
            self.dropped += self._item is not None and self._item is not self._taken
            self._item = item
            self._changed.notify_all()

    def repeat(self) -> None:
        """Offer the item that was last taken once more, unless a newer one waits."""
        with self._changed:
            self._item = self._taken if self._item is None else self._item
            self._changed.notify_all()

    def close(self) -> None:
        """End the iteration after the item that is there."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __iter__(self) -> Iterator[Item]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._item is not None or self._closed)
                if (item := self._item) is None:
                    return
                self._item, self._taken = None, item
                self._changed.notify_all()
            yield item


def open_source(source: Any, *, linear: bool = False, has_black: bool = False) -> FrameSource:
    """Return the source that a folder, a video device, file or URL, or a function is.

    With `linear`, codes are linear light whatever the source declares; for `has_black` of a folder
    see `read_sensor_image`. A PeriscopyError says that there is none, or it cannot be opened.
    """
    if callable(source):
        return FunctionSource(source, LINEAR if linear else SRGB)
    if Path(source).is_dir():
        return FolderSource(Path(source), has_black=has_black)
    return VideoSource(str(source), LINEAR if linear else None)


class FileVersion(NamedTuple):
    """A file of a folder as it was last written; a later one is larger."""

    time: int  # of the last change, ns
    name: str
    size: int  # bytes


class FolderSource:
    """A folder into which a camera writes photographs, of one format; the newest one counts."""

    is_live = True

    def __init__(self, folder: Path, *, has_black: bool = False) -> None:
        self.dropped, self._folder, self._has_black = 0, folder, has_black
        self._waiting: dict[FileVersion, float] = {}  # since when
        self._done: set[FileVersion] = set()
        self._format = ""
        self._old: set[FileVersion] | None = None  # there at the first look

    def frames(self, stopped: Event, say: Say) -> Iterator[CameraFrame]:
        """Yield the newest whole photograph at each look; see `FrameSource`."""
        said, is_lost = set[str](), False

        def say_once(text: str) -> None:
            kind = text.partition(": ")[2]
            if kind not in said:
                said.add(kind)
                say(text)

        while not stopped.wait(POLL):
            try:
                whole = self._whole_files(say_once)
            except OSError as error:
                if not is_lost:
                    say(f"{self._folder}: {error.strerror}; waiting for the folder")
                is_lost = True
                continue
            is_lost = False
            for k, file in enumerate(whole):
                if (light := self._read(file, say_once)) is not None:
                    others = whole[k + 1 :]
                    self._done |= {*others}
                    self.dropped += len({*others} - (self._old or set()))
                    yield CameraFrame(light, LINEAR)
                    break

    def _whole_files(self, say: Say) -> list[FileVersion]:
        """Return the files that are new and have stopped growing, the newest first."""
        present = set[FileVersion]()
        with os.scandir(self._folder) as entries:
            for entry in entries:
                if entry.name[0] != "." and not entry.is_dir():
                    with suppress(OSError):  # removed meanwhile
                        state = entry.stat()
                        present.add(FileVersion(state.st_mtime_ns, entry.name, state.st_size))
        self._done &= present
        if self._old is None:
            self._old = set(present)
        known, now, before = suffixes(), time.monotonic(), self._waiting
        self._waiting = {}
        for version in present - self._done:
            file = self._folder / version.name
            kind = known.get(file.suffix.lower())
            if kind is None or self._format not in ("", kind):
                why = "another format than the first photograph" if kind else "no photograph"
                say(f"{file}: {file.suffix or 'a name without suffix'} is {why}; ignored")
                self._done.add(version)
            else:
                self._waiting[version] = before.get(version, now)
        return sorted(
            (each for each in self._waiting if each in before and each.size), reverse=True
        )

    def _read(self, version: FileVersion, say: Say) -> SensorImage | None:
        """Return a photograph; None for one that cannot be read, which may still be written."""
        file = self._folder / version.name
        try:
            light, warnings = read_sensor_image(file, has_black=self._has_black)
        except PhotographError as error:
            if time.monotonic() - self._waiting[version] > PATIENCE:
                self._done.add(version)
                say(str(error))
            return None
        self._done.add(version)
        if version not in (self._old or ()):  # what lay there may be another camera's
            self._format = self._format or suffixes()[file.suffix.lower()]
        for warning in warnings:
            say(warning)
        return light


class VideoSource:
    """A video device, a stream or a file that FFmpeg's libraries open.

    A file plays at its own rate, and no frame of it is dropped; a stream that ends or stalls is
    opened again, `RETRIES` times. `encoding` is that of the codes; None for the file's, or sRGB.
    """

    def __init__(self, place: str, encoding: str | None = None) -> None:
        self._av = require("av")
        self.dropped, self._place, self._encoding = 0, place, encoding
        self.is_live = not Path(place).is_file()
        self._container = self._open()

    def _open(self) -> Any:
        av = self._av
        kind = "v4l2" if re.match(r"/dev/video\d", self._place) else None
        options = {"fflags": "nobuffer"} if self.is_live else {}
        if self._place.startswith("rtsp:"):
            options["rtsp_transport"] = "tcp"  # UDP loses packets
        try:
            container = av.open(self._place, format=kind, options=options, timeout=PATIENCE)
        except av.FFmpegError as error:
            raise PeriscopyError(
                f"{self._place}: {_reason(error)}; name a folder, a video, a stream or a device"
            ) from None
        if not container.streams.video:
            raise PeriscopyError(f"{self._place}: holds no video; name another stream or file")
        container.streams.video[0].thread_type = "SLICE"  # frames in parallel would be late
        return container

    def frames(self, stopped: Event, say: Say) -> Iterator[CameraFrame]:
        """Yield the frames of the stream; see `FrameSource`."""
        while True:
            fault = "ended"
            try:
                yield from self._decoded(stopped, say)
            except self._av.FFmpegError as error:
                fault = f"broke off ({_reason(error)})"
            finally:
                self._container.close()
            if stopped.is_set() or not self.is_live:
                if fault != "ended":
                    say(f"{self._place}: the video {fault}")
                return
            say(f"{self._place}: the stream {fault}; opening it again")
            if not self._reopened(stopped, say):
                return

    def _reopened(self, stopped: Event, say: Say) -> bool:
        for _ in range(RETRIES):
            if stopped.wait(PAUSE):
                return False
            with suppress(PeriscopyError):
                self._container = self._open()
                return True
        say(f"{self._place}: the stream did not come back")
        return False

    def _decoded(self, stopped: Event, say: Say) -> Iterator[CameraFrame]:
        start: float | None = None  # of the file's clock
        damaged = 0
        for packet in self._container.demux(video=0):
            arrived = time.monotonic()
            try:
                frames = packet.decode()
            except self._av.error.InvalidDataError:
                if not damaged:
                    say(f"{self._place}: a frame is damaged; such frames are left out")
                damaged += 1
                continue
            for frame in frames:
                if not self.is_live and frame.time is not None:
                    start = time.monotonic() - frame.time if start is None else start
                    stopped.wait(max(0.0, start + frame.time - time.monotonic()))
                    arrived = time.monotonic()
                if stopped.is_set():
                    return
                declared = LINEAR if frame.color_trc == LINEAR_TRANSFER else SRGB
                yield CameraFrame(_codes(frame), self._encoding or declared, arrived)


def _codes(frame: Any) -> NDArray[np.unsignedinteger]:
    """Return the codes of a frame of FFmpeg's, (rows, columns, 3), or 1 of a grey one."""
    is_deep = max(each.bits for each in frame.format.components) > 8
    is_grey = len(frame.format.components) == 1 and frame.format.name.startswith("gray")
    kind = ("gray16le" if is_deep else "gray") if is_grey else ("rgb48le" if is_deep else "rgb24")
    codes: NDArray[np.unsignedinteger] = frame.to_ndarray(format=kind)
    return codes[..., np.newaxis] if codes.ndim == 2 else codes


def _reason(error: OSError) -> str:
    """Return why FFmpeg cannot read a stream."""
    if isinstance(error, PermissionError):
        return "no permission (on Linux, join the group 'video')"
    if isinstance(error, FileNotFoundError):
        return "no such folder, device or file"
    if type(error).__name__ == "ExitError":  # PyAV's own, after its timeout
        return f"no data for {PATIENCE:g} s"
    return error.strerror or type(error).__name__


class FunctionSource:
    """A function that returns the next frame when a camera has it, or None at the end.

    It returns (rows, columns[, channels]): unsigned integers of 8 or 16 bits are codes of the
    `encoding`, other numbers linear light.
    """

    is_live = True

    def __init__(self, function: Callable[[], Any], encoding: str = SRGB) -> None:
        self.dropped, self._function, self._encoding = 0, function, encoding

    def frames(self, stopped: Event, say: Say) -> Iterator[CameraFrame]:
        """Yield what the function returns; see `FrameSource`."""
        while not stopped.is_set():
            try:
                values = self._function()
                if values is None:
                    return
                yield self._frame(np.asarray(values))
            except PhotographError as error:
                say(str(error))
            except Exception as error:  # whatever the user's own code raises
                say(f"the function of frames raised {type(error).__name__}: {error}")
                return

    def _frame(self, values: NDArray[Any]) -> CameraFrame:
        if values.dtype.kind != "u" or values.dtype.itemsize > 2:
            return CameraFrame(sensor_image(values, "the frame"), LINEAR)
        codes = values.astype(values.dtype.newbyteorder("="), copy=False)
        return CameraFrame(codes[..., np.newaxis] if codes.ndim == 2 else codes, self._encoding)
