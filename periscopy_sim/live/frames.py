"""Frames as they come: from a folder, or from a function that returns the next one.

A source yields each frame as soon as it is whole. It reports a fault in one line and goes on where
it can.
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Condition, Event
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.numerics import Mask
from periscopy_sim.numerics.validation import plain_array
from periscopy_sim.own_code import OwnCode, own_errors
from periscopy_sim.photograph import with_channels
from periscopy_sim.photographs.defects import plateaus
from periscopy_sim.photographs.develop import SensorImage, sensor_image
from periscopy_sim.storage.formats.decoding import LINEAR, SRGB
from periscopy_sim.storage.formats.table import suffixes
from periscopy_sim.storage.photographs import read_sensor_image

POLL = 0.2
"""Seconds between two looks at a folder; a file that stays the same between them is whole."""

ZEROS = 4096, 3.0
"""Bytes at a file's end that are all 0 where a program has set the size before it writes, as copies
over networks do; seconds that such a file must stay the same."""

PATIENCE = 10.0
"""Seconds that a file may stay unreadable, as while it is written."""

Item = TypeVar("Item")
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One photograph of a series.

    `values` are codes of 8 or 16 bits, (rows, columns, channels), of the `encoding` sRGB or linear
    and saturated from `white` on, None for the largest; or a `SensorImage`, linear light. `time` is
    that of `time.monotonic` when the frame arrived.
    """

    values: NDArray[np.unsignedinteger] | SensorImage
    encoding: str = SRGB
    white: float | None = None
    time: float = field(default_factory=time.monotonic)

    @property
    def pixels(self) -> NDArray[Any]:
        """(rows, columns, channels) codes or light."""
        return self.values.values if isinstance(self.values, SensorImage) else self.values

    @property
    def full(self) -> int:
        """The code from which on a pixel is saturated."""
        most = np.iinfo(self.pixels.dtype).max
        return most if self.white is None else int(np.ceil(self.white))

    @property
    def saturated(self) -> Mask:
        """(rows, columns) bool, where a channel is saturated."""
        if isinstance(self.values, SensorImage):
            return self.values.saturated
        return np.asarray((self.values >= self.full).any(axis=2))


class Latest(Generic[Item]):
    """A place for one item between two threads: a newer item replaces it, and is counted.

    Iterate to take the items until `close`.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._item: Item | None = None
        self._taken: Item | None = None
        self._closed, self._changed = False, Condition()

    def put(self, item: Item) -> None:
        """Offer an item."""
        with self._changed:
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
            yield item


def open_source(
    source: Any, *, linear: bool = False, white: float | None = None, has_black: bool = False
) -> "FolderSource | FunctionSource":
    """Return the source that a folder is, or a function, itself or as ``file.py:function``.

    With `linear`, integers of a function are linear light. `white` is the value from which on a
    pixel is saturated; None for a function: the largest of its integers' type. For a folder see
    `read_sensor_image`. A PeriscopyError says that there is none, or it cannot be imported.
    """
    encoding = LINEAR if linear else SRGB
    if callable(source):
        name = getattr(source, "__qualname__", type(source).__name__)
        return FunctionSource(source, name, encoding, white)
    folder, own = Path(source), OwnCode("camera", str(source))
    if folder.is_dir():
        return FolderSource(folder, white, has_black=has_black)
    if not own.is_complete:
        raise PeriscopyError(
            f"{source}: is no folder; name a folder, or a camera as file.py:function"
        )
    if not callable(function := own.load()):
        raise PeriscopyError(f"camera '{source}' is no function; name one that returns frames")
    return FunctionSource(function, own.name, encoding, white)


class FileVersion(NamedTuple):
    """A file of a folder as it was last written; a later one is larger."""

    time: int  # of the last change, ns
    name: str
    size: int  # bytes


class FolderSource:
    """A folder into which a camera writes photographs, of one format; the newest one counts.

    `dropped` counts those that it left out for a newer one.
    """

    def __init__(
        self, folder: Path, white: float | None = None, *, has_black: bool = False
    ) -> None:
        self.dropped, self._folder = 0, folder
        self._white, self._has_black = white, has_black
        self._waiting: dict[FileVersion, float] = {}  # since when
        self._done: set[FileVersion] = set()
        self._format = ""
        self._old: set[FileVersion] | None = None  # there at the first look

    def frames(self, stopped: Event, say: Say) -> Iterator[CameraFrame]:
        """Yield the newest whole photograph at each look; `say` reports a fault in one line."""
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
        """Return the files that are new and whole, the newest first."""
        present = set[FileVersion]()
        with os.scandir(self._folder) as entries:
            for entry in entries:
                with suppress(OSError):  # removed meanwhile, or a link that leads nowhere
                    if entry.name[0] != "." and entry.is_file():
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
        same = (each for each in self._waiting if each in before and each.size)
        return [each for each in sorted(same, reverse=True) if self._is_whole(each, now)]

    def _is_whole(self, version: FileVersion, now: float) -> bool:
        """Return whether a file that has not just changed is written to its end."""
        count, seconds = ZEROS
        if now - self._waiting[version] > seconds:
            return True
        try:
            with (self._folder / version.name).open("rb") as file:
                file.seek(max(0, version.size - count))
                return any(file.read())
        except OSError:  # removed meanwhile
            return False

    def _read(self, version: FileVersion, say: Say) -> SensorImage | None:
        """Return a photograph; None for one that cannot be read, which may still be written."""
        file = self._folder / version.name
        try:
            light, warnings = read_sensor_image(file, self._white, has_black=self._has_black)
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


class FunctionSource:
    """A function that returns the next frame when a camera has it, or None at the end.

    It returns (rows, columns[, channels]), which the source copies: unsigned integers of 8 or 16
    bits are codes of the `encoding`, other numbers linear light. Whatever it raises is a
    PeriscopyError that names it.
    """

    def __init__(
        self, function: Callable[[], Any], name: str, encoding: str, white: float | None = None
    ) -> None:
        self.dropped, self._function, self._name = 0, function, name
        self._encoding, self._white = encoding, white

    def frames(self, stopped: Event, say: Say) -> Iterator[CameraFrame | PhotographError]:
        """Yield what the function returns, or the error of what is no photograph."""
        is_first = True
        while not stopped.is_set():
            with own_errors(f"camera '{self._name}' failed"):
                values = self._function()
            if values is None:
                return
            try:
                frame = self._frame(values)
            except PhotographError as error:
                yield error
                continue
            if is_first and not frame.saturated.any():
                for line in plateaus(frame.pixels, "the frame"):
                    say(line)
            is_first = False
            yield frame

    def _frame(self, values: Any) -> CameraFrame:
        """Return a copy of what the function returned: its next frame may use the same memory."""
        array = with_channels(plain_array(values, "the frame"), "the frame")
        if array.shape[2] == 4 and array.size and np.ptp(array[..., 3]) == 0:
            raise PhotographError(
                "the frame: the fourth of its channels is the same everywhere, as transparency is; "
                "return the three colours, frame[..., :3]"
            )
        if array.dtype.kind != "u" or array.dtype.itemsize > 2:
            return CameraFrame(sensor_image(array, "the frame", self._white), LINEAR)
        codes = np.array(array, array.dtype.newbyteorder("="))
        return CameraFrame(codes, self._encoding, self._white)
