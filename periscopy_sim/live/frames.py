"""Frames as they come, from a folder or a function, prepared and averaged into photographs.

A source yields each frame as soon as it is whole. It reports a fault in one line and goes on where
it can.
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import count
from pathlib import Path
from threading import Event
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.methods import OwnCode, own_errors, place_of
from periscopy_sim.numerics import Array, Mask, validation
from periscopy_sim.photograph import ColourMatrix, Photograph, blackened, with_channels
from periscopy_sim.photographs import develop
from periscopy_sim.photographs.prepare import FilmPixels
from periscopy_sim.photographs.wall_view import WallPoints, WallTags
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage import formats, photographs, rasters

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
    def light(self) -> develop.SensorImage:
        """The frame as linear light, and where it is saturated."""
        values = self.values if self.table is None else self.table[self.values]
        full = np.isinf(values)
        values = np.where(full, np.max(values, where=~full, initial=0), values)
        return develop.SensorImage(values.astype(np.float32), full.any(axis=2), self.cell)


@cache
def light_of_codes(
    kind: np.dtype[np.unsignedinteger], *, linear: bool, white: float | None = None
) -> NDArray[np.float32]:
    """Return the light of each code, infinite from `white` on, None for the largest code.

    The others are 1 at most by the sRGB curve, or the codes themselves.
    """
    codes = np.arange(np.iinfo(kind).max + 1, dtype=kind)
    light = (codes if linear else rasters.srgb_light(codes)).astype(np.float32)
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
            read = partial(photographs.read_sensor_image, white=white, has_black=has_black)
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


def _version(name: str, state: os.stat_result) -> FileVersion:
    return state.st_mtime_ns, name, state.st_size


class CameraFolder:
    """A folder into which a camera writes photographs, of one format; the newest one counts.

    `read` returns a file's photograph with warnings. A frame's number counts those that the source
    left out for a newer one, too.
    """

    def __init__(
        self, folder: Path, read: Callable[[Path], tuple[develop.SensorImage, Sequence[str]]]
    ) -> None:
        self._folder, self._read_file = folder, read
        self._since = dict[FileVersion, float]()  # when those that are not done were first there
        self._failures = dict[FileVersion, str]()  # why it cannot be read, or not yet
        self._restless = dict[str, float]()  # names written as they were read, since when
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
                        present.add(_version(entry.name, entry.stat()))
        self._old = present if self._old is None else self._old
        self._done &= present
        for version in present - self._done:
            file = self._folder / version[1]
            kind = formats.suffixes().get(file.suffix.lower())
            if kind is None or self._format not in ("", kind):
                why = "another format than the first photograph" if kind else "no photograph"
                say(f"{file}: {file.suffix or 'a name without suffix'} is {why}; ignored")
                self._done.add(version)
        now = time.monotonic()
        self._since = {each: self._since.get(each, now) for each in present - self._done}
        return sorted((each for each in self._since if self._since[each] < now), reverse=True)

    def _read(self, version: FileVersion, say: Say) -> develop.SensorImage | None:
        """Return a photograph; None for one that cannot be read, which may still be written."""
        _, name, size = version
        file, is_new = self._folder / name, time.monotonic() - self._since[version] < PATIENCE
        try:
            with file.open("rb") as stream:
                stream.seek(max(0, size - ZEROS))
                if is_new and not any(stream.read()):
                    return None
            light, warnings = self._read_file(file)
            if not self._has_rested(version):
                return None
        except (OSError, PhotographError) as error:
            self._failures[version] = str(error)
            if not is_new:
                self._give_up(version, say)
            return None
        self._done.add(version)
        if version not in (self._old or ()):  # what lay there may be another camera's
            self._format = self._format or formats.suffixes()[file.suffix.lower()]
        for warning in warnings:
            say(warning)
        return light

    def _has_rested(self, version: FileVersion) -> bool:
        """Return whether a file is still of the version that was looked at, or is gone.

        Else it may be half of each, and the next look sees the other one. A camera that always
        writes while its file is read is believed after `PATIENCE`.
        """
        with suppress(OSError):
            if _version(version[1], (self._folder / version[1]).stat()) != version:
                since = self._restless.setdefault(version[1], time.monotonic())
                return time.monotonic() - since > PATIENCE
            self._restless.pop(version[1], None)
        return True

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
            curve = "decoded by the sRGB curve; if the camera sends linear light, pass `linear`"
            how = "taken as linear light" if linear else curve
            say(f"{8 * frame.values.dtype.itemsize}-bit frames, {how}")
        is_saturated = not is_first or frame.light.saturated.any()
        for line in () if is_saturated else develop.plateaus(frame.values, "the frame"):
            say(line)
        is_first = False
        yield frame


def _frame_of(
    values: Any, origin: str, linear: bool, white: float | None, number: int
) -> CameraFrame:
    """Return a copy of what a function returned: its next frame may use the same memory."""
    try:
        array = with_channels(validation.plain_array(values, "the frame"), "the frame")
    except (TypeError, ValueError, RuntimeError) as error:  # of parts that make no array, too
        raise PhotographError(f"{origin} returned a {type(values).__name__}: {error}") from error
    if array.dtype.kind != "u" or array.dtype.itemsize > 2:
        return CameraFrame(develop.sensor_image(array, "the frame", white).infinite, number=number)
    codes = np.array(array, array.dtype.newbyteorder("="))
    table = light_of_codes(codes.dtype, linear=linear, white=white)
    return CameraFrame(codes, table, number=number)


EXPOSURE, EVEN = 0.05, 1 / 3
"""Change of the light's logarithm that counts as another exposure, and its spread over the pixels,
over its size, up to which they change alike."""

LINES = 40
"""Rows and columns of pixels, at least, that show such a change."""

STEADY = 10.0
"""Seconds between two changes of the mask: a method needs some of them to be formed anew."""

TAKEN = "the average with the monitor off"
"""Name of the monitor-off photograph that is taken from the frames."""

NOISE_FRAMES = 30
"""Frames over which the noise of a frame is averaged."""


@dataclass(frozen=True, eq=False)
class Companions:
    """What belongs to all frames of a camera at rest, as `prepare` and `Photograph` have it.

    `mask` is of the frames' size or of the film's. `dark` and the values of `monitor_off` are of
    the frames' size, in linear light; the latter may be of the film's.
    """

    marks: WallPoints | WallTags | None = None
    mask: Mask | None = None
    black: float = 0.0
    dark: develop.SensorImage | None = None
    monitor_off: Mapping[str, develop.SensorImage] = field(default_factory=dict)
    colour_matrix: ColourMatrix | None = None


class RunningAverage:
    """The running average of frames of one camera and size, with the noise that it leaves.

    It forgets exponentially; the first frames are averaged evenly. It starts anew when the exposure
    changes. `wall` is a `Photograph` with the mask and the photographs with the monitor off: a new
    object whenever these change. `warnings` are one line each, `record` the numbers of the view by
    marks. Errors are those of `prepare`, or say that a companion is not of the frames' size.
    """

    def __init__(
        self,
        first: CameraFrame,
        scenario: Scenario,
        companions: Companions,
        page_off: Array | None = None,
    ) -> None:
        self.shape, self._colours = first.values.shape, companions.colour_matrix
        self._pixels = FilmPixels(first.light, scenario, companions.marks, companions.mask)
        film, self.warnings = self._pixels.film, self._pixels.warnings
        self.record = film.view.record(film.placement) if film else {}
        self._offset: Array | float = companions.black
        if companions.dark is not None:
            self._offset = self._averaged(companions.dark, "the dark frame")
        self._monitor_off = {
            name: each.values.astype(np.float64)
            if each.size == scenario.photograph_shape != self.shape[:2]
            else self._averaged(each, name) - self._offset
            for name, each in companions.monitor_off.items()
        }
        self.page_off = page_off
        self.wall: Photograph | None = None
        self._variance, self._differences = 0.0, 0  # of a frame's noise over the mean light
        self._first = self._latest = np.empty(0)  # frames of the average
        self._restart()

    def _averaged(self, picture: develop.SensorImage, name: str) -> Array:
        develop.check_same_size(picture.values.shape, self.shape, name)
        return self._pixels.average(picture.values)

    def prepare(self, frame: CameraFrame) -> Array:
        """Return a frame in the film's pixels, (rows, columns, C); saturated light is infinite."""
        return np.asarray(self._pixels.average(frame.values, frame.table) - self._offset, float)

    def _restart(self) -> None:
        self.average: Array | None = None
        self._share, self._frames = 1.0, 0  # of a frame's variance in the average; frames in it
        self._mask = self._pixels.mask  # without pixels that were saturated
        self._due = 0.0  # when the mask of `wall` may change

    def add(self, camera_frame: CameraFrame, count: int = 1) -> list[str]:
        """Average one frame more; return what a person should know, one line each.

        The average leaves as little noise as the mean of `count` frames.
        """
        frame, lines, times = self.prepare(camera_frame), list[str](), 0.0
        full: Mask = np.asarray(np.isinf(frame).any(axis=2))
        # The hidden picture may have moved since the average began; an exposure may drift slowly.
        if self.average is not None:
            times = self._change(self._latest, frame) or self._change(self._first, frame)
        if times:
            self._restart()
            lines.append(
                f"the light is {times:.3g} times what it was, and the average starts anew: fix "
                "exposure and gain, and expose for whole periods of lamps that flicker"
            )
        elif count > 1 and self.average is not None:
            change = develop.change_beyond_noise(self.average, frame, self._mask & ~full)
            if change:
                lines.append(f"the frames are averaged, though {develop.differing(change)}")
        if (full & self._mask).any():
            self._mask = self._mask & ~full
            fewer, every = self._mask.sum(), self._pixels.mask.sum()
            of = f"{every - fewer} of {every} pixels"
            lines.append(f"saturated: {of} are left out; shorten the exposure")
        if self.average is None:
            self.average, self._first = np.nan_to_num(frame, posinf=0), frame
        elif self._mask.any():
            self._measure_noise(frame)
        self._frames += 1
        weight = 1 / min(self._frames, (count + 1) / 2)
        # Where it is saturated, a method that still uses the pixel sees what was before.
        seen = np.where(full[..., np.newaxis], self.average, frame)
        self.average = self.average + weight * (seen - self.average)
        self._share = (1 - weight) ** 2 * self._share + weight**2
        self._latest = frame
        if not self._mask.any():
            self._restart()
            self.wall = None
            raise PhotographError("all pixels are saturated or masked; shorten the exposure")
        is_other = self.wall is None or not np.array_equal(self._mask, self.wall.pixels)
        if is_other and time.monotonic() >= self._due:
            self._make_wall(self.average)
        return lines

    def _change(self, before: Array, frame: Array) -> float:
        """Return the factor of the exposure since a frame before; 0 if it is the same."""
        step = max(1, min(self._mask.shape) // LINES)
        few = np.s_[::step, ::step]
        old, new = (each[few][self._mask[few]].mean(axis=-1) for each in (before, frame))
        lit = (old > 0) & (new > 0) & np.isfinite(new)
        if not lit.any():
            return 0.0
        ratios = np.log(new[lit] / old[lit])
        change = float(np.median(ratios))
        spread = develop.gaussian_spread(ratios - change)
        is_other = abs(change) > EXPOSURE and spread < EVEN * abs(change)
        return float(np.exp(change)) if is_other else 0.0

    def _measure_noise(self, frame: Array) -> None:
        difference = frame[self._mask] - self._latest[self._mask]
        level = float(np.mean(frame[self._mask])) or 1.0
        # A median, since the hidden picture may move; two frames' noise differ.
        variance = (develop.gaussian_spread(difference) / level) ** 2 / 2
        self._differences += 1
        self._variance += (variance - self._variance) / min(self._differences, NOISE_FRAMES)

    @property
    def numbers(self) -> tuple[int, float, float]:
        """What `Progress` says of the average: `averaged`, `noise` and `noise_left`."""
        noise = float(np.sqrt(self._variance))
        return round(1 / self._share), noise, noise * float(np.sqrt(self._share))

    def photograph(self) -> Photograph | None:
        """Return the average under the conditions of `wall`; None where there is none yet."""
        if self.wall is None or self.average is None:
            return None
        return replace(self.wall, values=self.average)  # a method fitted before may use more pixels

    def toggle_monitor_off(self) -> Photograph | None:
        """Make the average a photograph with the monitor off, or drop a former one; return it."""
        if self.average is not None:
            self.page_off = self.average if self.page_off is None else None
            self._make_wall(self.average)
        return self.photograph()

    def _make_wall(self, average: Array) -> None:
        off = dict(self._monitor_off)
        if self.page_off is not None:
            off[TAKEN] = self.page_off
        self.wall = Photograph.of(
            blackened(average, self._mask), name="the frames", mask=self._mask,
            monitor_off={name: blackened(each, self._mask) for name, each in off.items()},
            colour_matrix=self._colours,
        )  # fmt: skip
        self._due = time.monotonic() + STEADY
