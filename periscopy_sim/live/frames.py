"""Frames as they come: from a folder, or from a function that returns the next one.

A source yields each frame as soon as it is whole. It reports a fault in one line and goes on where
it can.
"""

import os
import reprlib
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import count
from pathlib import Path
from threading import Event
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.numerics.validation import plain_array
from periscopy_sim.own_code import OwnCode, own_errors, place_of
from periscopy_sim.photograph import with_channels
from periscopy_sim.photographs.defects import plateaus
from periscopy_sim.photographs.develop import SensorImage, sensor_image
from periscopy_sim.storage.formats.srgb import srgb_light
from periscopy_sim.storage.formats.table import suffixes
from periscopy_sim.storage.photographs import read_sensor_image

POLL, PATIENCE = 0.2, 3.0
"""Seconds between two looks at a folder, from one of which to the next a whole file stays the same;
and seconds that a file may stay unreadable, or end in zeros, as while it is written."""

ZEROS = 4096
"""Bytes at a file's end that are 0 where its size was set before, as copies over networks do."""

Item = TypeVar("Item")
Say = Callable[[str], None]
Source = Callable[[Event, Say], "Iterator[CameraFrame | PhotographError]"]
"""Yields frames until the event, or the error of what is no photograph; the function gets lines."""


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One photograph of a series.

    `values`, (rows, columns, channels), are linear light, or codes whose light is `table[values]`;
    saturated light is infinite. For `cell` see `SensorImage`. `number` counts the source's frames,
    from 0, and `time` is that of `time.monotonic` when the frame arrived.
    """

    values: NDArray[Any]
    table: NDArray[np.float32] | None = None
    cell: int = 1
    number: int = 0
    time: float = field(default_factory=time.monotonic)

    @property
    def light(self) -> SensorImage:
        """The frame as linear light, and where it is saturated."""
        values = self.values if self.table is None else self.table[self.values]
        full = np.isinf(values)
        values = np.where(full, np.max(values, where=~full, initial=0), values)
        return SensorImage(values.astype(np.float32), full.any(axis=2), self.cell)


@cache
def light_of_codes(
    kind: np.dtype[np.unsignedinteger], *, linear: bool, white: float | None = None
) -> NDArray[np.float32]:
    """Return the light of each code, infinite from `white` on, None for the largest code.

    The others are 1 at most by the sRGB curve, or the codes themselves.
    """
    codes = np.arange(np.iinfo(kind).max + 1, dtype=kind)
    light = (codes if linear else srgb_light(codes)).astype(np.float32)
    light[codes >= (codes[-1] if white is None else white)] = np.inf
    return light


class Latest(Generic[Item]):
    """The latest item between two threads: a newer one replaces it.

    Iterate to get it after each `put` and, for the last time, after `close`.
    """

    def __init__(self) -> None:
        self.item: Item | None = None
        self._changed, self._is_closed = Event(), False

    def put(self, item: Item | None = None) -> None:
        """Offer an item, or the latest one once more."""
        if item is not None:
            self.item = item
        self._changed.set()

    def close(self) -> None:
        """End the iteration after the latest item."""
        self._is_closed = True
        self._changed.set()

    def __iter__(self) -> Iterator[Item]:
        is_last = False
        while not is_last:
            self._changed.wait()
            self._changed.clear()
            is_last = self._is_closed
            if (item := self.item) is not None:
                yield item


def open_source(
    source: Any, *, linear: bool = False, white: float | None = None, has_black: bool = False
) -> Source:
    """Return the source that a folder is, or a function, itself or as ``file.py:function``.

    For `linear` and `white` see `watch`, for the other words of a folder `read_sensor_image`. A
    PeriscopyError says that there is no such source, or it cannot be imported.
    """
    function, name = source, getattr(source, "__qualname__", type(source).__name__)
    if not callable(source):
        folder, own = Path(source), OwnCode("camera", str(source))
        if folder.is_dir():
            read = partial(read_sensor_image, white=white, has_black=has_black)
            return CameraFolder(folder, read).frames
        if not own.is_complete:
            raise PeriscopyError(
                f"{source}: is no folder; name a folder, or a camera as file.py:function"
            )
        function, name = own.load(), own.name
        if not callable(function):
            raise PeriscopyError(f"camera '{source}' is no function; name one that returns frames")
    return partial(_frames_of, function, f"camera '{name}'", linear, white)


FileVersion = tuple[int, str, int]
"""Time of a file's last change, ns, its name and its size, bytes; a later one is larger."""


class CameraFolder:
    """A folder into which a camera writes photographs, of one format; the newest one counts.

    `read` returns a file's photograph with warnings. A frame's number counts those that the source
    left out for a newer one, too.
    """

    def __init__(
        self, folder: Path, read: Callable[[Path], tuple[SensorImage, Sequence[str]]]
    ) -> None:
        self._folder, self._read_file = folder, read
        self._since = dict[FileVersion, float]()  # when those that are not done were first there
        self._failures = dict[FileVersion, str]()  # why it cannot be read, or not yet
        self._done, self._format = set[FileVersion](), ""
        self._old: set[FileVersion] | None = None  # there at the first look

    def frames(self, stopped: Event, say: Say) -> Iterator[CameraFrame]:
        """Yield the newest whole photograph at each look; `say` reports a fault in one line."""
        number = -1
        while not stopped.wait(POLL):
            try:
                unchanged = self._unchanged_files(say)
            except OSError as error:
                say(f"{self._folder}: {error.strerror}; waiting for the folder")
                continue
            for k, version in enumerate(unchanged):
                if (light := self._read(version, say)) is not None:
                    for older in unchanged[k + 1 :]:
                        number += older not in (self._old or ())
                        self._give_up(older, say)
                    number += 1
                    yield CameraFrame(light.infinite, cell=light.cell, number=number)
                    break

    def _unchanged_files(self, say: Say) -> list[FileVersion]:
        """Return the files that are new and have not just changed, the newest first."""
        present = set[FileVersion]()
        with os.scandir(self._folder) as entries:
            for entry in entries:
                with suppress(OSError):  # removed meanwhile, or a link that leads nowhere
                    if entry.name[0] != "." and entry.is_file():
                        state = entry.stat()
                        present.add((state.st_mtime_ns, entry.name, state.st_size))
        self._old = present if self._old is None else self._old
        self._done &= present
        for version in present - self._done:
            file = self._folder / version[1]
            kind = suffixes().get(file.suffix.lower())
            if kind is None or self._format not in ("", kind):
                why = "another format than the first photograph" if kind else "no photograph"
                say(f"{file}: {file.suffix or 'a name without suffix'} is {why}; ignored")
                self._done.add(version)
        now = time.monotonic()
        self._since = {each: self._since.get(each, now) for each in present - self._done}
        return sorted((each for each in self._since if self._since[each] < now), reverse=True)

    def _read(self, version: FileVersion, say: Say) -> SensorImage | None:
        """Return a photograph; None for one that cannot be read, which may still be written."""
        _, name, size = version
        file, is_new = self._folder / name, time.monotonic() - self._since[version] < PATIENCE
        try:
            with file.open("rb") as stream:
                stream.seek(max(0, size - ZEROS))
                if is_new and not any(stream.read()):
                    return None
            light, warnings = self._read_file(file)
        except (OSError, PhotographError) as error:
            self._failures[version] = str(error)
            if not is_new:
                self._give_up(version, say)
            return None
        self._done.add(version)
        if version not in (self._old or ()):  # what lay there may be another camera's
            self._format = self._format or suffixes()[file.suffix.lower()]
        for warning in warnings:
            say(warning)
        return light

    def _give_up(self, version: FileVersion, say: Say) -> None:
        self._done.add(version)
        if failure := self._failures.pop(version, ""):
            say(failure)


def _frames_of(
    function: Callable[[], Any], name: str, linear: bool, white: float | None, stopped: Event,
    say: Say,
) -> Iterator[CameraFrame | PhotographError]:  # fmt: skip
    """Yield what a function returns when a camera has a frame, until it returns None.

    Whatever the function raises is a PeriscopyError that names it.
    """
    is_first = True
    for number in count():
        if stopped.is_set():
            return
        with own_errors(f"{name} failed"):
            values = function()
        if values is None:
            return
        try:
            frame = _frame_of(values, f"{name}{place_of(function)}", linear, white, number)
        except PhotographError as error:
            yield error
            continue
        if is_first and frame.table is not None:
            curve = "decoded by the sRGB curve; if the camera sends linear light, declare it so"
            how = "taken as linear light" if linear else curve
            say(f"{8 * frame.values.dtype.itemsize}-bit frames, {how}")
        is_saturated = not is_first or frame.light.saturated.any()
        for line in () if is_saturated else plateaus(frame.values, "the frame"):
            say(line)
        is_first = False
        yield frame


def _frame_of(
    values: Any, origin: str, linear: bool, white: float | None, number: int
) -> CameraFrame:
    """Return a copy of what a function returned: its next frame may use the same memory."""
    try:
        array = plain_array(values, "the frame")
    except (TypeError, ValueError, RuntimeError) as error:  # of parts that make no array, too
        if hasattr(values, "dtype"):
            raise PhotographError(f"{origin}: {error}") from error
        text = " ".join(reprlib.repr(values).split())
        raise PhotographError(
            f"{origin} returned a {type(values).__name__}, {text}; return an array of numbers, "
            "(rows, columns[, channels])"
        ) from error
    array = with_channels(array, "the frame")
    if array.shape[2] == 4 and array.size and np.ptp(array[..., 3]) == 0:
        raise PhotographError(
            "the frame: the fourth of its channels is the same everywhere, as transparency is; "
            "return the three colours, frame[..., :3]"
        )
    if array.dtype.kind != "u" or array.dtype.itemsize > 2:
        return CameraFrame(sensor_image(array, "the frame", white).infinite, number=number)
    codes = np.array(array, array.dtype.newbyteorder("="))
    table = light_of_codes(codes.dtype, linear=linear, white=white)
    return CameraFrame(codes, table, number=number)
