"""Photographs as they come: read, prepared and averaged, reconstructed and shown on a page.

Each of the three steps has a thread. Between two steps one frame waits; a newer one replaces it,
so that no picture is late.
"""

import re
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from statistics import median
from threading import Lock, RLock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.live.frames import (
    CameraFrame,
    Companions,
    Latest,
    RunningAverage,
    Say,
    Source,
    open_source,
)
from periscopy_sim.live.looks import Movable
from periscopy_sim.live.pictures import Check, Choice, FittedChoice, LivePictures, SizedLaboratory
from periscopy_sim.live.session import Control, Describe, Job, LiveSession, button, slider
from periscopy_sim.methods import find_method
from periscopy_sim.numerics import Mask, validation
from periscopy_sim.photograph import Photograph
from periscopy_sim.photographs.develop import SensorImage, sensor_image
from periscopy_sim.photographs.wall_view import WallPoints, WallTags
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.reconstruction.registry import DEFAULT
from periscopy_sim.scenario import Scenario

RECENT = 60
"""Frames whose rate and latency the page shows."""

JUDGED = 10.0
"""Seconds from one verdict on the scene to the next; each takes some 0.3 s of a core."""

NEWS, REPEATS = 10.0, 60.0
"""Seconds that the page shows a line; without one of its kind, before it is printed again."""


@dataclass(frozen=True)
class Progress:
    """The numbers of an average when its latest frame has come, and is shown."""

    frame: int  # number of the latest frame, from 0
    time: float  # seconds, by `time.monotonic`, when that came; shown: since the first one
    averaged: int  # frames whose mean has as little noise
    noise: float  # of a frame, over its mean light; 0 where only one has come
    noise_left: float  # of the average
    latency: float = 0.0  # seconds from the frame's arrival to its pictures
    dropped: int = 0  # frames that were not shown, so far


Record = Callable[[LivePictures, Progress], None]


class WatchSession(LiveSession):
    """A session whose photographs are averages of a source's frames.

    `count` is that of `RunningAverage.add`. `record` gets the pictures of each frame, `say` a line
    about what happened, both in the threads; `page` are keywords of `LiveSession`. `verdict` is the
    latest one on the scene. `ended` is set by `stop`, after the source's last average is shown in
    full size, or by an error, the `fault`: of the source, of `record`, or of the first two frames.
    """

    def __init__(
        self,
        source: Source,
        scenario: Scenario,
        method: str,
        save: Callable[[LivePictures], str],
        describe: Describe,
        *,
        companions: Companions | None = None,
        count: int = 1,
        say: Say = print,
        record: Record = lambda *_: None,
        **page: Any,
    ) -> None:
        self._source, self._scenario = source, scenario
        self._companions, self.count = companions or Companions(), count
        self._say, self._said, self._saying = say, dict[str, float](), Lock()
        self._record = record
        self.verdict: Report | None = None
        self._read = Latest[CameraFrame | PhotographError]()
        self.fault: Exception | None = None
        self._averages = Latest[tuple[Photograph, Progress]]()
        self._frames: RunningAverage | None = None
        self._averaging = RLock()  # held where `_frames` change
        self._fitted: FittedChoice | None = None
        self._times = deque[tuple[float, float]](maxlen=RECENT)  # of frames shown, with latencies
        self.read, self.shown, self.notice = 0, 0, "waiting for the first frame"
        self._lines, self._expires, self._judged = list[str](), 0.0, 0.0  # due: news, verdict
        super().__init__(
            scenario, Choice({}, "", method=method), save, describe,
            photograph=self.photograph, mask=self._companions.mask, **page,
        )  # fmt: skip
        steps = self._read_frames, self._average_frames, self._show_frames
        self.steps = [partial(self._guarded, step) for step in steps]

    def stop(self) -> None:
        """End all steps; the frames on their way are dropped."""
        super().stop()
        self._read.close()
        self._averages.close()

    @property
    def dropped(self) -> int:
        """The number of frames that were not shown."""
        return self.read - self.shown

    @property
    def record(self) -> dict[str, object]:
        """The stream's numbers for metadata, with those of the view by marks and the verdict."""
        judged = self.verdict and self.verdict.residual
        return {
            "frames_shown": self.shown,
            "frames_dropped": self.dropped,
            "median_latency": median(each for _, each in [*self._times]) if self.shown else None,
            "average": self.count,
            **(self._frames.record if self._frames else {}),
            **(judged.numbers() if judged else {}),
        }

    def photograph(self) -> Photograph:
        """Return the present average; a PeriscopyError says why there is none."""
        if self._averages.item is None:
            raise PeriscopyError(self.notice)
        return self._averages.item[0]

    def follow(self, laboratory: SizedLaboratory, choice: Choice, check: Check) -> None:
        """Fit the method of a choice to the present average, for frames to come."""
        self._fitted = laboratory.fit(choice, check)
        self.verdict, self._judged = None, 0.0
        self._averages.put()

    def show_trouble(self, text: str, *, is_coarse: bool = False) -> None:
        """Show why there are no pictures; print why there will be none in full size."""
        super().show_trouble(text)
        if text and not is_coarse and self._averages.item is not None:
            self.report(text)

    def further_controls(self) -> Mapping[str, Control]:
        """Return the controls of the average and its monitor-off frame."""
        number = Movable("Average", self.count, *validation.RANGES["count"].ends, 1.0, "frames")
        set_count = lambda value: setattr(self, "count", round(value))  # noqa: E731
        labels = "Take the average as the monitor-off frame", "Drop the monitor-off frame"
        return {
            "average": slider(number, "", set_count, lambda: self.count),
            "monitor off": button(lambda: labels[self.has_monitor_off], self.toggle_monitor_off),
        }

    @property
    def has_monitor_off(self) -> bool:
        """Whether an average is in use as the photograph with the monitor off."""
        return self._frames is not None and self._frames.page_off is not None

    def toggle_monitor_off(self) -> None:
        """Make the present average the photograph with the monitor off, or drop a former one."""
        with self._averaging:
            frames, latest = self._frames, self._averages.item
            photograph = frames.toggle_monitor_off() if frames else None
            if photograph is not None and latest is not None:
                self._averages.put((photograph, latest[1]))
        taken = "the present average is the monitor-off frame; turn the monitor on"
        self.report(taken if self.has_monitor_off else "there is no monitor-off frame")
        self.want()

    def report(self, line: str) -> None:
        """Print a line, unless one of its kind was just printed, and show it on the page."""
        self.notice, self._expires = line, time.monotonic() + NEWS
        self._print(line)
        self.gate.publish(**self._status())

    def _print(self, *lines: str) -> None:
        for line in lines:
            kind, now = re.sub(r"[\d.]", "", line.rpartition(": ")[2]), time.monotonic()
            with self._saying:
                if now > self._said.get(kind, -np.inf) + REPEATS:
                    self._say(line)
                self._said[kind] = now

    def _status(self) -> dict[str, list[str]]:
        """Return the numbers, the verdict and what has just happened, for the page."""
        sentences = self._describe(self.verdict) if self.verdict else ()
        news = [self.notice] if time.monotonic() < self._expires else []
        return {"status" if self.shown else "trouble": [*self._lines, *sentences, *news]}

    # -- the three steps ---------------------------------------------------------------------------

    def _guarded(self, step: Job) -> None:
        try:
            step()
        except Exception as error:
            self.fault = error
            self.stop()

    def _read_frames(self) -> None:
        for frame in self._source(self.ended, self.report):
            self.read = self.read if isinstance(frame, PhotographError) else frame.number + 1
            self._read.put(frame)
        self._read.close()

    def _average_frames(self) -> None:
        latest, failures = None, 0
        for frame in self._read:
            if frame is latest:
                continue
            latest = frame
            try:
                with self._averaging:
                    wall = self._frames and self._frames.wall
                    self._average(frame)
                if self._frames and self._frames.wall is not wall:
                    self.want()
            except PeriscopyError as error:
                failures += 1
                may_differ = isinstance(self._companions.marks, WallTags)
                if failures > 1 and self._averages.item is None and not may_differ:
                    raise
                self.report(str(error))
        self.at_rest(self._averages.close)  # the last average is shown in full size

    def _average(self, frame: CameraFrame | PhotographError) -> None:
        """Put the average with one frame more; a new average for the first and another size."""
        if isinstance(frame, PhotographError):
            raise frame
        frames, shape = self._frames, frame.values.shape
        if frames is None or frames.shape != shape:
            if frames and shape[2] != frames.shape[2]:
                raise PhotographError(
                    f"a frame has {shape[2]} channels, the first one {frames.shape[2]}; give "
                    "frames of one camera"
                )
            if frames:
                sizes = ("{} x {}".format(*each) for each in (frames.shape, shape))
                self.report("the frames changed from {} to {} pixels".format(*sizes))
            off = frames.page_off if frames else None
            frames = RunningAverage(frame, self._scenario, self._companions, off)
            for line in frames.warnings:
                self.report(line)
        self._frames = frames
        for line in frames.add(frame, self.count):
            self.report(line)
        if (photograph := frames.photograph()) is not None:
            progress = Progress(frame.number, frame.time, *frames.numbers)
            self._averages.put((photograph, progress))

    def _show_frames(self) -> None:
        first, number, latest = 0.0, -1, tuple[Any, ...]()  # the average and its method
        for average in self._averages:
            fitted, (photograph, progress) = self._fitted, average
            if self.ended.is_set():
                break
            if fitted is None or (average, fitted) == latest:
                continue
            latest = average, fitted
            try:
                pictures = fitted.see(photograph, progress.noise_left, progress.frame)
            except PeriscopyError as error:
                self.report(str(error))
                continue
            first, now = first or progress.time, time.monotonic()
            if progress.frame != number:  # else again, by another method
                number, self.shown = progress.frame, self.shown + 1
                self._times.append((now, now - progress.time))
            progress = replace(
                progress, time=progress.time - first, latency=now - progress.time,
                dropped=progress.frame + 1 - self.shown,
            )  # fmt: skip
            self._lines = self._numbers(progress)
            self._record(pictures, progress)
            self.show(pictures, **self._status())
            if now >= self._judged and not fitted.is_coarse:
                self._judged = now + JUDGED
                self.at_rest(self._judge)
        if not self.ended.is_set():  # the source has ended
            if self.verdict is None:
                self._judge()
            if not self.shown:
                self.fault = PeriscopyError(f"no frame was shown: {self.notice}")
        self.stop()

    def _numbers(self, progress: Progress) -> list[str]:
        times, latencies = zip(*self._times, strict=True)
        noise = "one frame, whose noise is not known"
        rate = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0
        if progress.noise or progress.averaged > 1:
            noise = (
                f"average of {progress.averaged} frames: noise {100 * progress.noise_left:.2g} "
                f"%, of one frame {100 * progress.noise:.2g} %"
            )
        speed = f"{rate:.1f} frames a second, latency {1000 * median(latencies):.0f} ms"
        return [speed, f"{progress.dropped} frames dropped", noise]

    def _judge(self) -> None:
        """Judge the scene by the present average."""
        fitted = self._fitted
        if fitted is None or fitted.is_coarse or self._averages.item is None:
            return
        with suppress(PeriscopyError):  # the frame's picture reports it
            verdict = fitted.judge(self.photograph())
            if verdict and fitted is self._fitted:
                self.verdict = verdict
                doubts = [*self._describe(replace(verdict, notes=()))]
                self._print(*doubts[verdict.verdict.code == "fits" :])
                self.gate.publish(**self._status())


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
    record: Record = lambda *_: None,
    save: Callable[[LivePictures], str] = lambda _: "give watch() a function `save`",
    host: str = "127.0.0.1",
    port: int = 8080,
) -> Report | None:
    """Show what a camera's frames reveal on a page, until the source ends.

    It prints the page's address and what happens, one line each, and returns the last verdict on
    the scene; None where no average was judged.

    Parameters
    ----------
    source
        A folder; or a function, itself or as ``file.py:function``, that returns the next frame when
        the camera has it, (rows, columns[, channels]), and None at the end.
    average
        Frames of the running average.
    marks, mask
        As of `prepare`.
    dark, monitor_off
        Frames with the lens covered, and with the monitor off, by name: linear light, of the
        frames' size.
    white, linear
        The value from which on a pixel is saturated, such as 4095 of 12 bits, and whether a
        function's integers are linear light. By default, the largest of a function's integers and
        the sRGB curve, or what a folder's files say.
    method
        Name of the first method, see `find_method`.
    record, save
        Called with the pictures of each frame, whose `image` is the hidden one, and its numbers;
        and with the full pictures when the page's button is pressed. `save` returns a line to show.
    host, port
        Where to listen; port 0 takes a free one.

    Raises
    ------
    PeriscopyError
        If there is no such source or method, the function raises an error, the first two frames
        cannot be used, the port is taken, or an extra is not installed.
    """
    validation.checked_scene(scenario)
    find_method(method)
    validation.checked("average", average, "count")
    companions = Companions(
        marks, mask, 0.0, None if dark is None else sensor_image(dark, "the dark frame"),
        {name: sensor_image(each, name) for name, each in (monitor_off or {}).items()},
    )  # fmt: skip
    with WatchSession(
        open_source(source, linear=linear, white=white), scenario, method, save, Report.lines,
        companions=companions, count=average, record=record, host=host, port=port,
    ) as session:  # fmt: skip
        print(session.gate.url, flush=True)
        session.run()
    if session.fault is not None:
        raise session.fault
    return session.verdict
