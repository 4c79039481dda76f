"""A laboratory that follows a person's wishes: coarse pictures at once, full ones at rest.

There is no queue: it takes the latest wish when it is free, and a newer wish ends full pictures.
"""

import logging
import time
from collections.abc import Callable
from threading import Condition

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.level import Choice, Level, LivePictures, Overtaken

LOG = logging.getLogger(__name__)
Save = Callable[[LivePictures], None]


class LiveLaboratory:
    """A laboratory at its coarse and its full size.

    It calls `show` with pictures, and `tell` with one line about a failure, empty if there is none.
    """

    def __init__(
        self,
        coarse: Level,
        full: Level,
        show: Callable[[LivePictures], None],
        tell: Callable[[str], None],
    ) -> None:
        self._coarse, self._full = coarse, full
        self._show, self._tell = show, tell
        self._changed = Condition()
        self._choice: Choice | None = None
        self._behind: list[Level] = []  # the latest wish, coarse before full
        self._rests = 0.0  # when the latest wish counts as at rest
        self._save: Save | None = None
        self._stopped = False

    def want(self, choice: Choice, rest: float = 0.0) -> None:
        """Ask for pictures; in full, unless another wish comes within so many seconds."""
        with self._changed:
            self._choice, self._behind = choice, [self._coarse, self._full]
            self._rests = time.monotonic() + rest
            self._changed.notify()

    def save(self, save: Save) -> None:
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
            try:
                if callable(work):
                    if pictures is not None:
                        work(pictures)
                    continue
                pictures = None
                pictures = self._pictures(work)
                self._show(pictures)
                self._tell("")
            except Overtaken:
                pass
            except PeriscopyError as error:
                self._tell(str(error))
            except Exception as error:  # one wish that fails must not end the page
                LOG.error("periscopy view goes on after an error", exc_info=error)
                self._tell(str(PeriscopyError(f"{type(error).__name__}: {error}")))

    def _next(self) -> Level | Save | None:
        """Wait for a level that is behind the latest wish, or for something to save."""
        with self._changed:
            while not self._stopped:
                pause = None
                if self._behind:
                    is_coarse = self._behind[0] is self._coarse
                    pause = 0.0 if is_coarse else self._rests - time.monotonic()
                    if pause <= 0:
                        return self._behind.pop(0)
                elif self._save is not None:
                    save, self._save = self._save, None
                    return save
                self._changed.wait(pause)
        return None

    def _pictures(self, level: Level) -> LivePictures:
        assert self._choice is not None  # a level is behind a wish

        def is_overtaken() -> bool:  # coarse pictures are finished, so that a drag shows some
            return self._stopped or (level is self._full and self._coarse in self._behind)

        return level.pictures(self._choice, is_overtaken)
