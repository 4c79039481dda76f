"""A laboratory that follows a person's choices, and its page, from their opening to their end."""

import logging
import time
import warnings
from collections.abc import Callable
from functools import partial
from threading import Event, Thread
from typing import Self

from threadpoolctl import threadpool_limits

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.page import Describe, Page
from periscopy_sim.live.pictures import (
    Check,
    Choice,
    LivePictures,
    Overtaken,
    SizedLaboratory,
    coarse,
)  # fmt: skip
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.photograph import Photograph
from periscopy_sim.scenario import Scenario

LOG = logging.getLogger(__name__)
Job = Callable[[], None]


class LiveSession(Page):
    """A laboratory on a page that follows a person's choices; a context, which closes the page.

    It shows coarse pictures at once, full ones at rest. There is no queue: it takes the latest
    choice when it is free, and a newer one ends full pictures.

    `scenario` has its full sizes, and `first` lacks the scene's values. For `photograph`, `light`
    and `seed` see `SizedLaboratory`; `mask` says which pixels are used of what a function returns.
    The page's button calls `save` with the full pictures and shows the line that it returns. For
    the others, and errors, see `Page`.
    """

    def __init__(
        self,
        scenario: Scenario,
        first: Choice,
        save: Callable[[LivePictures], str],
        describe: Describe,
        *,
        photograph: Photograph | Callable[[], Photograph] | None = None,
        mask: Mask | None = None,
        light: Array | None = None,
        seed: int = 0,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        mask = photograph.pixels if isinstance(photograph, Photograph) else mask
        small = coarse(scenario, 1.0 if mask is None else float(mask.mean()))
        self._coarse = SizedLaboratory(small, photograph, light, is_coarse=True, seed=seed)
        self._full = SizedLaboratory(scenario, photograph, light, is_coarse=False, seed=seed)
        self._behind = list[SizedLaboratory]()  # the latest choice, coarse before full
        self._changed, self.ended, self._jobs = Event(), Event(), list[Job]()
        self._done: Choice | None = None  # in full
        self._rests = 0.0  # when the latest choice counts as at rest
        self._save, self.steps = save, list[Job]()  # what runs beside it, each in a thread
        super().__init__(host, port, small, first, describe)

    def follow(self, laboratory: SizedLaboratory, choice: Choice, check: Check) -> None:
        """Compute and show the pictures of a choice; for `check` see `SizedLaboratory.fit`."""
        pictures = laboratory.fit(choice, check).pictures()
        check()
        self.show(pictures)

    def want(self, rest: float = 0.0) -> None:
        """Follow the present choice; in full, unless another one comes within so many seconds."""
        self._rests = time.monotonic() + rest
        is_done, self._done = self._done == self.choice, None  # it is not shown coarsely again
        self._behind = [self._full] if is_done else [self._coarse, self._full]
        self._changed.set()

    def save(self) -> None:
        """Save the full pictures of the present choice, and show the line that this returns."""

        def write() -> None:
            self.gate.publish(trouble=[self._save(self._full.fit(self.choice).pictures())])

        self.at_rest(write)

    def at_rest(self, job: Job) -> None:
        """Call a function once the latest choice is done in full, or has failed; do so at once."""
        self._jobs.append(job)
        self._rests = 0.0
        self._changed.set()

    def stop(self) -> None:
        """End `run` after the present stage of its work."""
        self.ended.set()
        self._changed.set()

    def run(self) -> None:
        """Show whatever is set, until `stop`."""
        # Coarse pictures, full ones and the browser share the cores: products split among threads
        # would wait for each other, and 0.1 s become seconds.
        with threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures that are gone in a moment
            self.want()
            for step in self.steps:
                Thread(target=step, daemon=True).start()
            while (work := self._next()) is not None:
                laboratory, job = work
                try:
                    job()
                except Overtaken:
                    pass
                except Exception as error:  # one choice that fails must not end the page
                    fault = error
                    if not isinstance(error, PeriscopyError):
                        LOG.error("the page goes on after an error", exc_info=error)
                        fault = PeriscopyError(f"{type(error).__name__}: {error}")
                    self.show_trouble(str(fault), is_coarse=laboratory is self._coarse)

    def _next(self) -> tuple[SizedLaboratory | None, Job] | None:
        """Wait for a laboratory that is behind the latest choice, or for another job."""
        while not self.ended.is_set():
            self._changed.clear()  # before a look at what is wanted: no change is missed
            pause, behind = None, self._behind
            if behind:
                pause = 0.0 if behind[0] is self._coarse else self._rests - time.monotonic()
                if pause <= 0:
                    laboratory = behind.pop(0)
                    return laboratory, partial(self._follow, laboratory, self.choice)
            elif self._jobs:
                return None, self._jobs.pop(0)
            self._changed.wait(pause)
        return None

    def _follow(self, laboratory: SizedLaboratory, choice: Choice) -> None:
        def check(*_: object) -> None:
            # Coarse pictures are finished, so that a drag shows some.
            if self.ended.is_set() or (laboratory is self._full and self._coarse in self._behind):
                raise Overtaken

        self.follow(laboratory, choice, check)
        self._done = choice if laboratory is self._full else None
        self.show_trouble("")

    def __enter__(self) -> Self:
        """Return the session, whose page is open."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all."""
        self.stop()
        self.gate.close()
