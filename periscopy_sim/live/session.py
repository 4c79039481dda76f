"""A laboratory, its light and its page, from their opening until nothing of them is left."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Self

import numpy as np

from periscopy_sim.live.choice import Choice
from periscopy_sim.live.laboratory import LiveLaboratory
from periscopy_sim.live.level import Level, LivePictures, coarse_sizes
from periscopy_sim.live.light import AmbientLight
from periscopy_sim.live.movable import find_movables
from periscopy_sim.live.page import Offered, Page
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.report import Report
from periscopy_sim.scenario import Scenario


class LiveSession:
    """A laboratory on a page; a context, at whose end neither thread nor process is left.

    `scenario` is the scene at its full sizes, `first` the first choice but for the scene's values,
    `photograph` a given one or None for synthetic ones. The page's button calls `save` with the
    full pictures and shows the line that it returns. Port 0 takes a free one. A PeriscopyError says
    that the extra is not installed, the port is taken, or nothing of the scene can be moved.
    """

    def __init__(
        self,
        scenario: Scenario,
        first: Choice,
        offered: Offered,
        save: Callable[[LivePictures], str],
        describe: Callable[[Report], Sequence[str]],
        *,
        photograph: Photograph | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        path, given, hidden = scenario.path, scenario.parameters, scenario.hidden_shape
        is_given = photograph is not None
        used = 1.0 if photograph is None else len(photograph.used) / np.prod(photograph.shape)
        sizes = scenario.photograph_shape, hidden
        small = coarse_sizes(*sizes, used)
        self._light = AmbientLight(path, given, small[0], self._arrive)
        light = self._light.photograph
        coarse = Level(path, given, small, light, photograph, is_coarse=True)
        full = Level(path, given, sizes, light, photograph, is_coarse=False)
        movables, handles = find_movables(path, given, coarse.scenario)
        first = replace(first, values={each.name: each.value for each in movables})
        self.page = Page(
            host, port, scenario, movables, handles, offered, first,
            is_given=is_given, describe=describe,
        )  # fmt: skip
        self._laboratory = LiveLaboratory(coarse, full, self.page.show, self.page.tell)
        self.page.want = self._want
        self.page.save = lambda: self._laboratory.save(lambda p: self.page.tell(save(p)))

    def __enter__(self) -> Self:
        """Open nothing more: the page is open already."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all; the page first, which may ask for light."""
        self.stop()
        self.page.close()
        self._light.close()

    def run(self) -> None:
        """Show whatever is set, until `stop`."""
        from threadpoolctl import threadpool_limits

        # Coarse pictures, full ones and the browser share the cores: products split among threads
        # would wait for each other, and 0.1 s become seconds.
        with threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures that are gone in a moment
            self._want(self.page.choice, 0.0)
            self._laboratory.run()

    def stop(self) -> None:
        """End `run` after the present stage of its work."""
        self._laboratory.stop()

    def _want(self, choice: Choice, rest: float) -> None:
        self._light.want(choice.place)
        self._laboratory.want(choice, rest)

    def _arrive(self, place: str) -> None:
        if self.page.choice.place == place:
            self._laboratory.want(self.page.choice)
