"""A laboratory that follows a person's wishes, and its page, from their opening to their end.

It shows coarse pictures at once, full ones at rest. There is no queue: it takes the latest wish
when it is free, and a newer wish ends full pictures.
"""

import logging
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from threading import Condition, Event, Thread
from typing import Any

from threadpoolctl import threadpool_limits

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.frames import Say
from periscopy_sim.live.movable import Movable, find_movables
from periscopy_sim.live.page import Control, Page, button, slider
from periscopy_sim.live.pictures import Choice, LivePictures, Overtaken, SizedLaboratory, coarse
from periscopy_sim.live.stream import Progress, Stream
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.scenario import Scenario

LOG = logging.getLogger(__name__)
Level = Callable[[Choice, Callable[..., None]], Any]
Use = Callable[[Any], None]
Record = Callable[[LivePictures, Progress], None]
Describe = Callable[[Report], Sequence[str]]

MOST_AVERAGED = 1000.0
"""Frames of the longest running average: half a minute of a video."""


class LiveLaboratory:
    """A laboratory at its coarse and its full size, see `SizedLaboratory.pictures`.

    It calls `show` with pictures, and `report` with one line about a failure, empty if there is
    none.
    """

    def __init__(self, coarse: Level, full: Level, show: Use, report: Say) -> None:
        self._coarse, self._full = coarse, full
        self._show, self._report = show, report
        self._changed = Condition()
        self._choice: Choice | None = None
        self._behind: list[Level] = []  # the latest wish, coarse before full
        self._rests = 0.0  # when the latest wish counts as at rest
        self._save: Use | None = None
        self._stopped = False

    def want(self, choice: Choice, rest: float = 0.0) -> None:
        """Ask for pictures; in full, unless another wish comes within so many seconds."""
        with self._changed:
            self._choice, self._behind = choice, [self._coarse, self._full]
            self._rests = time.monotonic() + rest
            self._changed.notify()

    def save(self, save: Use) -> None:
        """Call a function with the full pictures of the latest wish, once they are shown."""
        with self._changed:
            self._save, self._rests = save, 0.0
            self._changed.notify()

    def stop(self) -> None:
        """End `run` after the present stage of its work."""
        with self._changed:
            self._stopped = True
            self._changed.notify()

    def run(self) -> None:
        """Follow the wishes until `stop`."""
        pictures = None
        while (work := self._next()) is not None:
            level, choice, save = work
            try:
                if level is not None:
                    pictures = None
                    pictures = level(choice, partial(self._raise_if_overtaken, level))
                    self._show(pictures)
                    self._report("")
                elif save is not None and pictures is not None:
                    save(pictures)
            except Overtaken:
                pass
            except PeriscopyError as error:
                self._report(str(error))
            except Exception as error:  # one wish that fails must not end the page
                LOG.error("the page goes on after an error", exc_info=error)
                self._report(str(PeriscopyError(f"{type(error).__name__}: {error}")))

    def _next(self) -> tuple[Level | None, Any, Use | None] | None:
        """Wait for a level that is behind the latest wish, or for something to save."""
        with self._changed:
            while not self._stopped:
                pause = None
                if self._behind:
                    is_coarse = self._behind[0] is self._coarse
                    pause = 0.0 if is_coarse else self._rests - time.monotonic()
                    if pause <= 0:
                        return self._behind.pop(0), self._choice, None
                elif self._save is not None:
                    save, self._save = self._save, None
                    return None, self._choice, save
                self._changed.wait(pause)
        return None

    def _raise_if_overtaken(self, level: Level, *_: object) -> None:
        # Coarse pictures are finished, so that a drag shows some.
        if self._stopped or (level is self._full and self._coarse in self._behind):
            raise Overtaken


class LiveSession(AbstractContextManager["LiveSession"]):
    """A laboratory on a page; a context, at whose end the page is closed.

    `scenario` is the scene at its full sizes, `first` the first choice but for the scene's values,
    `light` the ambient light of its place, (rows, columns, 3), `photograph` a given one or None for
    synthetic ones, which a viewer makes of `images`. With a `stream`, photographs are its frames,
    and `record` gets the pictures of each; it has no `images`, nor has a given photograph. `seed`
    is of A's rays. The page's button calls `save` with the full pictures and shows the line that it
    returns. Port 0 takes a free one. A PeriscopyError says that the extra is not installed, the
    port is taken, or nothing of the scene can be moved.
    """

    def __init__(
        self,
        scenario: Scenario,
        first: Choice,
        images: Sequence[str],
        methods: Sequence[str],
        save: Callable[[LivePictures], str],
        describe: Describe,
        *,
        light: Array | None = None,
        photograph: Photograph | None = None,
        stream: Stream | None = None,
        record: Record = lambda *_: None,
        seed: int = 0,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        mask = photograph.pixels if photograph else stream.companions.mask if stream else None
        small = coarse(scenario, 1.0 if mask is None else float(mask.mean()))
        movables, handles = find_movables(small)
        first = replace(first, values={each.name: each.value for each in movables})
        self._stream = stream
        self.page = Page(
            host, port, scenario, movables, handles, images, methods, first, describe,
            self._stream_controls,
        )  # fmt: skip
        quick = SizedLaboratory(small, light, photograph, is_coarse=True, seed=seed)
        full = SizedLaboratory(scenario, light, photograph, is_coarse=False, seed=seed)
        levels: tuple[Level, Level] = quick.pictures, full.pictures
        show: Use = self.page.show
        if stream is not None:
            levels, show = (partial(stream.form, quick), partial(stream.form, full)), stream.use
            self._connect(stream, record, describe)
        self._laboratory = LiveLaboratory(*levels, show, self.page.report)
        self.page.want = self._laboratory.want

        def saved(shown: Any) -> None:
            if stream is not None:  # a method: of the present average, with standard errors
                shown = full.pictures(shown.choice, lambda *_: None, stream.wall or shown.wall)
            self.page.report(save(shown))

        self.page.save = lambda: self._laboratory.save(saved)

    def _connect(self, stream: Stream, record: Record, describe: Describe) -> None:
        """Show a stream's frames and lines on the page."""

        def show(pictures: LivePictures, progress: Progress, lines: Sequence[str]) -> None:
            record(pictures, progress)
            self.page.show(pictures, *lines)

        def show_lines(lines: list[str]) -> None:
            self.page.gate.publish(**{"status" if stream.shown else "trouble": lines})

        stream.show, stream.show_lines, stream.describe = show, show_lines, describe
        stream.form_anew = lambda: self._laboratory.want(self.page.choice)

    def _stream_controls(self, page: Page) -> dict[str, Control]:
        """Return the controls of a stream: its average and its monitor-off frame."""
        if (stream := self._stream) is None:
            return {}
        count = Movable("Average", stream.count, 1.0, MOST_AVERAGED, 1.0, "frames")

        def set_count(value: float) -> None:
            stream.count = round(value)
            page.refresh()

        def press() -> None:
            stream.toggle_monitor_off()
            page.refresh()

        labels = "Take the average as the monitor-off frame", "Drop the monitor-off frame"
        return {
            "average": slider(count, "", set_count, lambda: stream.count),
            "monitor off": button(lambda: labels[stream.has_monitor_off], press),
        }

    def __exit__(self, *_: object) -> None:
        """End all."""
        self.stop()
        self.page.gate.close()

    def run(self) -> None:
        """Show whatever is set, until `stop`."""
        # Coarse pictures, full ones and the browser share the cores: products split among threads
        # would wait for each other, and 0.1 s become seconds.
        with threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures that are gone in a moment
            self._laboratory.want(self.page.choice)
            if (stream := self._stream) is not None:
                stream.start()
                Thread(target=self._stop_after, args=(stream.ended,), daemon=True).start()
            self._laboratory.run()

    def _stop_after(self, ended: Event) -> None:
        ended.wait()
        self.stop()

    def stop(self) -> None:
        """End `run` after the present stage of its work."""
        if self._stream is not None:
            self._stream.stop()
        self._laboratory.stop()
