"""The light of ambient places, each rendered once in a process of its own.

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

TARGET = 0.05
"""Relative error of a pixel: one round of samples reaches it. What is wrong of such light is
smooth, too, so that methods reject it with the rest."""

RAYS = 16
"""Of light that has bounced, see `render_background`."""

PIXELS = 48
"""Along the longer side of what is rendered; between them the light is interpolated."""


class AmbientLight:
    """Photographs of a scene's wall by the light of ambient places, as the scene was at first.

    The scene is given by its path, its ``<default>``s and the size of its hidden image. Where its
    camera moves, the light is taken as it was: lamps are far away. `arrived` is called, in a thread
    of its own, with the name of each place whose light has come, or cannot be had.
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
        self._photographs: dict[str, Array] = {}
        self._failed: dict[str, str] = {}
        self._rendering: dict[str, BaseProcess] = {}

    def photograph(self, place: str) -> Array | None:
        """Return the light of a place, (rows, columns, 3); None while it is being rendered.

        A PeriscopyError says that it cannot be.
        """
        with self._lock:
            if place in self._failed:
                raise PeriscopyError(self._failed[place])
            if place not in self._photographs and place not in self._rendering:
                self._start(place)
            return self._photographs.get(place)

    def close(self) -> None:
        """End what is still being rendered."""
        with self._lock:
            processes = list(self._rendering.values())
        for process in processes:
            process.terminate()
            process.join()

    def _start(self, place: str) -> None:
        here, there = multiprocessing.Pipe(duplex=False)
        spawn = multiprocessing.get_context("spawn")
        process = spawn.Process(
            target=_render, args=(there, find_condition(place), *self._scene), daemon=True
        )
        self._rendering[place] = process
        process.start()
        there.close()  # so that its end is seen here
        Thread(target=self._await, args=(place, here), daemon=True).start()

    def _await(self, place: str, light: Connection) -> None:
        try:
            found = light.recv()
        except EOFError:
            found = f"the light of {place} was not rendered: its process ended"
        with self._lock:
            del self._rendering[place]
            if isinstance(found, str):
                self._failed[place] = found
            else:
                self._photographs[place] = found
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
