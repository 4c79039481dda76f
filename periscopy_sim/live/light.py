"""The light of ambient places, rendered one at a time in a process of its own.

Rendering takes seconds, in which the laboratory goes on moving. A process, unlike a thread, can be
ended at any time, and does not wait for what else uses Mitsuba here.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Lock, Thread

import numpy as np

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.scenario import Array
from periscopy_sim.storage.ambient_library import find_condition

TARGET, RAYS = 0.05, 16
"""Relative error of a pixel, and rays of bounced light, of `render_background`; the error is
smooth, and methods project it out with the rest."""

PIXELS = 48
"""Along the longer side of what is rendered; between them the light is interpolated."""


class AmbientLight:
    """Photographs of a scene's wall by the light of ambient places, as the scene was at first.

    Path, ``<default>``s and the size of the hidden image make the scene. A thread of its own calls
    `arrived` with the place whose light has come or failed.
    """

    def __init__(
        self,
        path: Path,
        given: Mapping[str, str],
        hidden: tuple[int, int],
        arrived: Callable[[str], None],
    ) -> None:
        self._scene = path, dict(given), hidden
        self._arrived = arrived
        self._lock = Lock()
        self._results: dict[str, Array | str] = {}  # a photograph, or why there is none
        self._rendering: tuple[str, BaseProcess] | None = None

    def want(self, place: str) -> None:
        """Render the light of a place, unless it is known; end the rendering of another place.

        A PeriscopyError says that there is no such place.
        """
        with self._lock:
            if self._rendering is not None and self._rendering[0] == place:
                return
            if self._rendering is not None:
                _, process = self._rendering
                self._rendering = None
                process.terminate()
                process.join()
            if place and place not in self._results:
                self._start(place)

    def photograph(self, place: str) -> Array | None:
        """Return the light of a place, (rows, columns, 3); None before it has come.

        A PeriscopyError says that it cannot be had.
        """
        result = self._results.get(place)
        if isinstance(result, str):
            raise PeriscopyError(result)
        return result

    def close(self) -> None:
        """End the present rendering."""
        self.want("")

    def _start(self, place: str) -> None:
        receiver, sender = multiprocessing.Pipe(duplex=False)
        process = multiprocessing.get_context("spawn").Process(
            target=_render, args=(sender, find_condition(place), *self._scene), daemon=True
        )
        process.start()
        self._rendering = place, process
        sender.close()  # so that the receiver sees the end of the process
        Thread(target=self._await, args=(place, process, receiver), daemon=True).start()

    def _await(self, place: str, process: BaseProcess, receiver: Connection) -> None:
        try:
            result = receiver.recv()
        except (EOFError, OSError):
            result = f"the light of {place} was not rendered: its process ended"
        with self._lock:
            if self._rendering is None or self._rendering[1] is not process:
                return  # another place is wanted
            self._rendering, self._results[place] = None, result
        self._arrived(place)


def _render(
    out: Connection, place: Path, path: Path, given: Mapping[str, str], hidden: tuple[int, int]
) -> None:
    """Render the light of a place, and send it; or send why it cannot be."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who started this ends it
    from periscopy_sim.calibration.level import fitted
    from periscopy_sim.rendering.ambient.background import render_background
    from periscopy_sim.rendering.scene.load import load_scenario

    try:
        shape = load_scenario(path, hidden, given).photograph_shape
        scenario = load_scenario(path, (1, 1), given, photograph=fitted(shape, PIXELS))
        found = render_background(place, scenario, target=TARGET, rays=RAYS)
        out.send(_enlarged(found.photograph, shape))
    except PeriscopyError as error:
        out.send(str(error))


def _enlarged(photograph: Array, shape: tuple[int, int]) -> Array:
    """Return a photograph of more pixels, by cubic splines; nowhere darker than it was."""
    from scipy import ndimage

    factors = [more / fewer for more, fewer in zip(shape, photograph.shape[:2], strict=True)]
    wider: Array = ndimage.zoom(photograph, [*factors, 1], mode="nearest", grid_mode=True)
    return np.asarray(np.maximum(wider, photograph.min()))
