"""A laboratory and its page, from their opening until nothing of them is left."""

import warnings
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

from threadpoolctl import threadpool_limits

from periscopy_sim.live.laboratory import LiveLaboratory
from periscopy_sim.live.level import Choice, Level, LivePictures, coarse
from periscopy_sim.live.movable import find_movables
from periscopy_sim.live.page import Page
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.method import Report
from periscopy_sim.scenario import Scenario


class LiveSession(AbstractContextManager["LiveSession"]):
    """A laboratory on a page; a context, at whose end the page is closed.

    `scenario` is the scene at its full sizes, `first` the first choice but for the scene's values,
    `light` the ambient light of its place, (rows, columns, 3), `photograph` a given one or None for
    synthetic ones, which a viewer makes of `images`. The page's button calls `save` with the full
    pictures and shows the line that it returns. Port 0 takes a free one. A PeriscopyError says that
    the extra is not installed, the port is taken, or nothing of the scene can be moved.
    """

    def __init__(
        self,
        scenario: Scenario,
        first: Choice,
        images: Sequence[str],
        methods: Sequence[str],
        save: Callable[[LivePictures], str],
        describe: Callable[[Report], Sequence[str]],
        *,
        light: Array | None = None,
        photograph: Photograph | None = None,
        host: str = "127.0.0.1",
        port: int = 0,
    ) -> None:
        small = coarse(scenario, 1.0 if photograph is None else float(photograph.pixels.mean()))
        movables, handles = find_movables(small)
        first = replace(first, values={each.name: each.value for each in movables})
        if photograph is not None:
            images = ()
        self.page = Page(host, port, scenario, movables, handles, images, methods, first, describe)
        self._laboratory = LiveLaboratory(
            Level(small, light, photograph, is_coarse=True),
            Level(scenario, light, photograph, is_coarse=False),
            self.page.show, self.page.tell,
        )  # fmt: skip
        self.page.want = self._laboratory.want
        self.page.save = lambda: self._laboratory.save(lambda p: self.page.tell(save(p)))

    def __exit__(self, *_: object) -> None:
        """End all."""
        self.stop()
        self.page.close()

    def run(self) -> None:
        """Show whatever is set, until `stop`."""
        # Coarse pictures, full ones and the browser share the cores: products split among threads
        # would wait for each other, and 0.1 s become seconds.
        with threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pictures that are gone in a moment
            self._laboratory.want(self.page.choice)
            self._laboratory.run()

    def stop(self) -> None:
        """End `run` after the present stage of its work."""
        self._laboratory.stop()
