"""Frames on their way to the page: read, prepared and averaged, reconstructed and shown.

Each of the three steps has a thread. Between two steps one frame waits; a newer one replaces it,
so that no picture is late.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from statistics import median
from threading import Condition, Event, RLock, Thread

import numpy as np

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.live.frames import CameraFrame, FolderSource, FunctionSource, Latest
from periscopy_sim.live.pictures import (
    Choice,
    FrameMethod,
    LivePictures,
    Overtaken,
    SizedLaboratory,
)
from periscopy_sim.live.preparation import Companions, Preparation, PreparedFrames
from periscopy_sim.photograph import Photograph
from periscopy_sim.photographs.marks import WallTags
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.scenario import Scenario

SHOWN = 60
"""Frames whose rate and latency the page shows."""

JUDGED = 10.0
"""Seconds from one verdict on the scene to the next; each takes some 0.3 s of a core."""

REPEATS = 10.0
"""Seconds that the page shows a line, and before the same one is printed again."""

Average = tuple[Photograph, float, tuple[float, float, float]]
"""An average, when its latest frame arrived, and its number of frames, noise and noise left."""


@dataclass(frozen=True)
class Progress:
    """The numbers of a stream when a frame is shown."""

    frame: int  # number of the frame, from 0
    time: float  # seconds since the first frame
    latency: float  # seconds from the frame's arrival to its pictures
    rate: float  # frames a second, of the latest ones
    dropped: int  # frames that came too late to be shown, so far
    averaged: float  # frames whose mean has as little noise
    noise: float  # of a frame, over its mean light; 0 where only one has come
    noise_left: float  # of the average

    def lines(self, latency: float) -> list[str]:
        """Return the numbers in a few lines, with the median latency in seconds."""
        return [
            f"{self.rate:.1f} frames a second, latency {1000 * latency:.0f} ms",
            f"{self.dropped} late frames dropped",
            f"average of {self.averaged:.3g} frames: noise {100 * self.noise_left:.2g} %, of one "
            f"frame {100 * self.noise:.2g} %"
            if self.noise or self.averaged > 1
            else "one frame, whose noise is not known",
        ]


class Stream:
    """The frames of a source for a scene, in a thread of each step between `start` and `stop`.

    `count` is that of `PreparedFrames.add`. `show` gets the pictures of each frame, `say` a line
    about what happened, and `show_lines` that line beneath the numbers; all in the threads.
    `form_anew` is called when methods must be formed anew; they arrive by `use`. `describe` returns
    a report's sentences, `verdict` the latest one on the scene. `ended` is set by `stop`, when the
    source has ended and its last average is shown in full size, or by an error, then the `fault`:
    of the source, of which no frame could be shown, of `show`, or of the first two frames, which
    no later one of their size would mend.
    """

    def __init__(
        self,
        source: FolderSource | FunctionSource,
        scenario: Scenario,
        companions: Companions | None = None,
        count: int = 1,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._source, self.scenario = source, scenario
        self.companions, self.count = companions or Companions(), count
        self._say, self._said = say, dict[str, float]()
        self.show: Callable[[LivePictures, Progress, list[str]], None] = lambda *_: None
        self.form_anew: Callable[[], None] = lambda: None
        self.show_lines: Callable[[list[str]], None] = lambda _: None
        self.describe: Callable[[Report], Sequence[str]] = lambda _: ()
        self.verdict: Report | None = None
        self.ended = Event()
        self.fault: Exception | None = None
        self._read = Latest[CameraFrame | PhotographError]()
        self._averaged = Latest[Average]()
        self._frames: PreparedFrames | None = None
        self._averaging = RLock()  # held where `_frames` change
        self._formed: FrameMethod | None = None
        self._coarse: FrameMethod | None = None  # the latest
        self._changed = Condition()
        self.latencies = deque[float](maxlen=1000)
        self.shown, self.notice = 0, "waiting for the first frame"
        self._lines, self._expires = list[str](), 0.0
        self._is_rejected = False  # no method of full size can be formed of what there is
        self._is_over = False  # no other frame will come, nor a better method for the last one
        self._refusal = ""  # why the latest frame cannot be prepared

    def start(self) -> None:
        """Begin to read."""
        self.show_lines([self.notice])
        steps = self._read_frames, self._average_frames, self._show_frames, self._judge_scene
        for step in steps:
            Thread(target=self._guarded, args=(step,), daemon=True).start()

    def stop(self) -> None:
        """End all steps; the frames on their way are dropped."""
        self.ended.set()
        for place in (self._read, self._averaged):
            place.close()
        with self._changed:
            self._changed.notify_all()

    @property
    def dropped(self) -> int:
        """The number of frames that were not shown because a newer one came."""
        return self._source.dropped + self._read.dropped + self._averaged.dropped

    @property
    def wall(self) -> Photograph | None:
        """The present average with its conditions; None before the first frame."""
        with self._averaging:
            return None if self._frames is None else self._frames.photograph()

    @property
    def record(self) -> dict[str, object]:
        """The stream's numbers for metadata, with those of the view by marks and the verdict."""
        view = {} if self._frames is None else self._frames.prepare.record
        judged = self.verdict and self.verdict.residual
        return {
            "frames_shown": self.shown,
            "frames_dropped": self.dropped,
            "median_latency": median(self.latencies) if self.latencies else None,
            "average": self.count,
            **view,
            **(judged.numbers() if judged else {}),
        }

    def form(
        self, laboratory: SizedLaboratory, choice: Choice, unless_overtaken: Callable[..., None]
    ) -> FrameMethod:
        """Form a method for the present frames; a PeriscopyError says that there are none.

        Before the first, it is formed for frames without a mask, and kept by the laboratory.
        """
        if self._frames is None:
            shape, colours = self.scenario.photograph_shape, self.companions.colour_matrix
            channels = 3 if colours is None else len(colours.matrix)
            light, mask = np.ones((*shape, channels)), np.ones(shape, bool)
            blank = Photograph(light, mask, colour_matrix=colours)
            with suppress(PeriscopyError):
                laboratory.form(choice, unless_overtaken, blank)
        if (wall := self.wall) is None:
            raise PeriscopyError(self.notice)
        try:
            return laboratory.form(choice, unless_overtaken, wall)
        except Exception as error:
            if not (laboratory.is_coarse or isinstance(error, Overtaken)):
                self.report(str(error))
                with self._changed:
                    self._is_rejected = True
                    if self._coarse is not None and self._coarse.choice == choice:
                        self._formed = self._coarse
                    self._changed.notify_all()
            raise

    def use(self, formed: FrameMethod) -> None:
        """Use a method from the latest frame on.

        A coarse one does not replace a full one of the same choice, unless a new one fails.
        """
        with self._changed:
            former, self._is_rejected = self._formed, False
            if formed.is_coarse:
                self._coarse = formed
                if former and not former.is_coarse and former.choice == formed.choice:
                    return
            self._formed, self.verdict = formed, None
            self._averaged.repeat()
            self._changed.notify_all()

    @property
    def has_monitor_off(self) -> bool:
        """Whether an average is in use as the photograph with the monitor off."""
        return self._frames is not None and self._frames.page_off is not None

    def toggle_monitor_off(self) -> None:
        """Make the present average the photograph with the monitor off, or drop a former one."""
        with self._averaging:
            if self._frames is None or self.wall is None:
                self.report("no frame has come yet")
                return
            self._frames.toggle_monitor_off()
        taken = "the present average is the monitor-off frame; turn the monitor on"
        self.report(taken if self.has_monitor_off else "the monitor-off frame is dropped")
        self.form_anew()

    def report(self, line: str) -> None:
        """Print a line, unless the same was just printed, and show it on the page."""
        self.notice, now = line, time.monotonic()
        self._expires = now + REPEATS
        self.show_lines(self._status())
        kind = line.rpartition(": ")[2]  # without numbers that change
        if now >= self._said.get(kind, 0.0):
            self._said[kind] = now + REPEATS
            self._say(line)

    # -- the three steps ---------------------------------------------------------------------------

    def _guarded(self, step: Callable[[], None]) -> None:
        try:
            step()
        except Exception as error:
            self.fault = error
            self.stop()

    def _read_frames(self) -> None:
        for frame in self._source.frames(self.ended, self.report):
            self._read.put(frame)
        self._read.close()

    def _average_frames(self) -> None:
        for frame in self._read:
            try:
                with self._averaging:
                    item, is_other = self._average(frame)
            except PeriscopyError as error:
                may_differ = isinstance(self.companions.marks, WallTags) or self._frames is not None
                if str(error) == self._refusal and not may_differ:
                    raise
                self._refusal = str(error)
                self.report(self._refusal)
                continue
            if is_other:
                self.form_anew()
            if item is not None:
                self._averaged.put(item)
        with self._changed:  # the last average is shown in full size
            self._changed.wait_for(self._is_final)
            self._is_over = True
            self._changed.notify_all()
        self._averaged.close()

    def _is_final(self) -> bool:
        """Return whether no better method for the last average will come."""
        formed, is_lost = self._formed, self._is_rejected or self.ended.is_set()
        return is_lost or self.wall is None or (formed is not None and not formed.is_coarse)

    def _average(self, frame: CameraFrame | PhotographError) -> tuple[Average | None, bool]:
        """Return the average with one frame more, and whether methods must be formed anew."""
        if isinstance(frame, PhotographError):
            raise frame
        frames = self._frames_like(frame)
        wall = frames.wall
        for line in frames.add(frames.prepare(frame), self.count):
            self.report(line)
        average, numbers = frames.photograph(), (frames.averaged, frames.noise, frames.noise_left)
        item = None if average is None else (average, frame.time, numbers)
        return item, frames.wall is not wall

    def _frames_like(self, frame: CameraFrame) -> PreparedFrames:
        """Return the average of frames of this size: a new one for the first and another size."""
        before = self._frames
        if before is not None:
            (*old, channels), (*new, own) = before.prepare.shape, frame.pixels.shape
            if own != channels:
                raise PhotographError(
                    f"a frame has {own} channels, the first one {channels}; give frames of one "
                    "camera"
                )
            if old == new:
                return before
            sizes = ("{} x {}".format(*each) for each in (old, new))
            self.report("the frames changed from {} to {} pixels".format(*sizes))
        prepare = Preparation(frame, self.scenario, self.companions)
        for line in prepare.warnings:
            self.report(line)
        self._frames = PreparedFrames(prepare, None if before is None else before.page_off)
        return self._frames

    def _show_frames(self) -> None:
        first, times = 0.0, deque[float](maxlen=SHOWN)
        latest, used = None, None  # the frame shown, and its method
        for item in self._averaged:
            if (formed := self._method()) is None:
                break
            is_again = item is latest
            if is_again and formed is used:
                continue
            wall, arrived, numbers = item
            number = self.shown - is_again
            try:
                pictures = formed.see(wall, numbers[-1], number)
            except PeriscopyError as error:
                self.report(str(error))
                continue
            latest, used = item, formed
            first, now = first or arrived, time.monotonic()
            if not is_again:
                times.append(now)
            rate = (len(times) - 1) / (now - times[0]) if len(times) > 1 else 0.0
            progress = Progress(
                number, arrived - first, now - arrived, rate, self.dropped, *numbers
            )
            recent = median(list(self.latencies)[-SHOWN:] or [now - arrived])
            self._lines = progress.lines(recent)
            self.show(pictures, progress, self._status())
            if not is_again:
                self.latencies.append(time.monotonic() - arrived)
                self.shown += 1
        if not self.ended.is_set():  # the source has ended
            if self.verdict is None:
                self._judge()
            if not self.shown:
                self.fault = PeriscopyError(f"no frame was shown: {self.notice}")
        self.stop()

    def _status(self) -> list[str]:
        """Return the numbers, the verdict and what has just happened."""
        verdict = self.verdict
        sentences = () if verdict is None else self.describe(verdict)
        news = [self.notice] if time.monotonic() < self._expires else []
        return [*self._lines, *sentences, *news]

    def _judge_scene(self) -> None:
        """Judge the scene by the present average, now and then."""
        while not self.ended.wait(JUDGED):
            if self.shown:
                self._judge()
                self.show_lines(self._status())

    def _judge(self) -> None:
        formed, wall = self._formed, self.wall
        if formed is None or formed.is_coarse or wall is None or not formed.may_judge:
            return
        with suppress(PeriscopyError):  # the frame's picture reports it
            verdict = formed.judge(wall)
            with self._changed:
                if self._formed is formed:
                    self.verdict = verdict

    def _method(self) -> FrameMethod | None:
        """Wait for a method; None after `stop`, or where none will come."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._formed is not None or self._is_over or self.ended.is_set()
            )
            return None if self.ended.is_set() else self._formed
