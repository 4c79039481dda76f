"""A laboratory that follows what is wanted: coarse at once, full when it comes to rest.

Coarse pictures are computed in a thread of their own, full ones where `run` was called. Neither
has a queue: each takes what is wanted by the time that it is free. What is overtaken meanwhile is
never begun, and full pictures that are overtaken are given up.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from threading import Condition, Thread

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.choice import Choice
from periscopy_sim.live.level import Level, LivePictures, Overtaken

LOG = logging.getLogger(__name__)

Save = Callable[[LivePictures], None]


class LiveLaboratory:
    """A laboratory at its coarse and its full size.

    `show` is given pictures, never older ones after newer, nor coarse ones after full ones of the
    same; `tell` is given what cannot be shown, in one line, empty where all is well. Both are
    called by several threads, one at a time.
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
        self._number = 0  # of what is wanted
        self._rests = 0.0  # when that counts as at rest
        self._shown = (0, False)  # the number of what is shown, and whether in full
        self._showing = Condition()
        self._save: Save | None = None
        self._stopped = False
        self._broken: Exception | None = None

    def want(self, choice: Choice, rest: float = 0.0) -> None:
        """Ask for pictures; in full, unless more is asked for within so many seconds."""
        with self._changed:
            self._choice, self._number = choice, self._number + 1
            self._rests = time.monotonic() + rest
            self._changed.notify_all()

    def save(self, save: Save) -> None:
        """Have something done with the full pictures of what is wanted, once they are shown."""
        with self._changed:
            self._save = save
            self._rests = 0.0
            self._changed.notify_all()

    def stop(self) -> None:
        """End `run`."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def run(self) -> None:
        """Follow what is wanted until `stop`, or an interrupt."""
        coarse = Thread(target=self._follow_coarsely, name="coarse pictures")
        coarse.start()
        try:
            done, pictures = 0, None
            while True:
                with self._changed:
                    while not self._stopped and not self._is_due(done, pictures):
                        self._changed.wait(self._pause(done))
                    if self._stopped:
                        break
                    number, choice, save = self._number, self._choice, self._save
                    if number == done:
                        self._save = None
                if number == done:
                    assert save is not None and pictures is not None
                    self._attempt(partial(save, pictures))
                    continue
                assert choice is not None
                try:
                    pictures = self._pictures(self._full, choice, number)
                except Overtaken:
                    continue
                done = number
        finally:
            self.stop()
            coarse.join()
        if self._broken is not None:
            raise self._broken

    def _is_due(self, done: int, pictures: LivePictures | None) -> bool:
        """Return whether there is something to do in full."""
        if self._number == done:
            if self._save is not None and pictures is None:
                self._save = None  # there is nothing to save, as was told
            return self._save is not None
        return time.monotonic() >= self._rests

    def _pause(self, done: int) -> float | None:
        """Return how long to wait for what is wanted to come to rest; None for no end."""
        if self._number == done:
            return None
        return max(self._rests - time.monotonic(), 0.0) + 1e-3

    def _follow_coarsely(self) -> None:
        try:
            self._coarsely()
        except Exception as error:  # for `run` to raise
            self._broken = error
            self.stop()

    def _coarsely(self) -> None:
        done = 0
        while True:
            with self._changed:
                while not self._stopped and self._number == done:
                    self._changed.wait()
                if self._stopped:
                    return
                number, choice = self._number, self._choice
            assert choice is not None
            self._pictures(self._coarse, choice, number)
            done = number

    def _pictures(self, level: Level, choice: Choice, number: int) -> LivePictures | None:
        """Compute and show pictures; coarse ones are finished even if they are overtaken."""

        def is_overtaken() -> bool:
            return self._stopped or (not level.is_coarse and number != self._number)

        found: list[LivePictures] = []
        try:
            self._attempt(lambda: found.append(level.pictures(choice, is_overtaken)), number)
        except Overtaken:
            if not level.is_coarse:
                raise
        if not found:
            return None
        mark = number, not level.is_coarse
        with self._showing:
            if mark > self._shown:
                self._shown = mark
                self._show(found[0])
        return found[0]

    def _attempt(self, do: Callable[[], None], number: int | None = None) -> None:
        """Do something; tell of what a user can change, if that is still wanted."""
        try:
            do()
            told = ""
        except Overtaken:
            raise
        except Exception as error:  # one wish that fails must not end the page of all
            told = " ".join(str(error).split())
            if not isinstance(error, PeriscopyError):
                told = f"{type(error).__name__}: {told}"
                LOG.exception("pictures failed")
        if number is None and not told:
            return  # what was done has told so itself
        with self._showing:
            if number is None or number == self._number:
                self._tell(told)
