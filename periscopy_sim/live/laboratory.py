"""A laboratory that follows a person's wishes: coarse pictures at once, full ones at rest.

A thread of its own computes the coarse pictures, the thread that called `run` the full ones. There
is no queue: each takes the latest wish when it is free, and a newer wish ends full pictures.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from threading import Condition, Lock, Thread

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.choice import Choice
from periscopy_sim.live.level import Level, LivePictures, Overtaken

LOG = logging.getLogger(__name__)
Save = Callable[[LivePictures], None]


class LiveLaboratory:
    """A laboratory at its coarse and its full size.

    It calls `show` with pictures, never older ones after newer, nor coarse ones after full ones of
    the same wish. It calls `tell` with one line about a failure, empty where all is well. Two
    threads call both, one at a time.
    """

    def __init__(
        self,
        coarse: Level,
        full: Level,
        show: Callable[[LivePictures], None],
        tell: Callable[[str], None],
    ) -> None:
        self._coarse, self._full, self._show, self._tell = coarse, full, show, tell
        self._changed = Condition()
        self._choice: Choice | None = None
        self._number = 0  # of the latest wish
        self._rests = 0.0  # when it counts as at rest
        self._save: Save | None = None
        self._stopped = False
        self._showing = Lock()
        self._shown = (0, False)  # the number of the wish shown, and whether in full

    def want(self, choice: Choice, rest: float = 0.0) -> None:
        """Ask for pictures; in full, unless another wish comes within so many seconds."""
        with self._changed:
            self._choice, self._number = choice, self._number + 1
            self._rests = time.monotonic() + rest
            self._changed.notify_all()

    def save(self, save: Save) -> None:
        """Call a function with the full pictures of the latest wish, once they are shown."""
        with self._changed:
            self._save, self._rests = save, 0.0
            self._changed.notify_all()

    def stop(self) -> None:
        """End `run`."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def run(self) -> None:
        """Follow the wishes until `stop`, or an interrupt."""
        coarse = Thread(target=self._follow, args=(self._coarse,), name="coarse pictures")
        coarse.start()
        try:
            self._follow(self._full)
        finally:
            self.stop()
            coarse.join()

    def _follow(self, level: Level) -> None:
        done, pictures = 0, None
        while (wish := self._next(level, done)) is not None:
            number, choice, save = wish
            try:
                if save is None:
                    pictures = None
                    pictures = level.pictures(choice, lambda: self._is_overtaken(level, number))  # noqa: B023
                    self._present(number, level, pictures)
                elif pictures is not None:
                    save(pictures)
            except Overtaken:
                continue
            except Exception as error:  # one wish that fails must not end the page
                self._report(error, number)
            done = number

    def _next(self, level: Level, done: int) -> tuple[int, Choice, Save | None] | None:
        """Wait for a wish that is not done, or for something to save; None to stop."""
        with self._changed:
            while not self._stopped:
                pause = None
                if self._number != done:
                    pause = 0.0 if level.is_coarse else self._rests - time.monotonic()
                save = None
                if pause is None and not level.is_coarse:
                    save, self._save = self._save, None
                if save is not None or (pause is not None and pause <= 0):
                    assert self._choice is not None
                    return self._number, self._choice, save
                self._changed.wait(pause)
        return None

    def _is_overtaken(self, level: Level, number: int) -> bool:
        """Return whether to give up; coarse pictures are finished, so that a drag shows some."""
        return self._stopped or (not level.is_coarse and number != self._number)

    def _present(self, number: int, level: Level, pictures: LivePictures) -> None:
        with self._showing:
            mark = number, not level.is_coarse
            if mark > self._shown:
                self._shown = mark
                self._show(pictures)
            if number == self._number:
                self._tell("")

    def _report(self, error: Exception, number: int) -> None:
        text = " ".join(str(error).split())
        if not isinstance(error, PeriscopyError):
            LOG.error("periscopy view goes on after an error", exc_info=error)
            text = f"{type(error).__name__}: {text}"
        with self._showing:
            if number == self._number:
                self._tell(text)
