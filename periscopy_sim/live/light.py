"""The light of ambient places, rendered in a process of its own while the laboratory goes on."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Mapping
from multiprocessing import get_context
from multiprocessing.pool import Pool
from pathlib import Path

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.scenario import Array
from periscopy_sim.storage.ambient_library import find_condition

QUICK = {"target": 0.05, "rays": 16}
"""Relative error of a pixel, and rays of bounced light, of `render_background`. The error is
smooth, and methods project it out with the rest."""


class AmbientLight:
    """Photographs of a scene's wall by the light of ambient places, as the scene was at first.

    `path` and the values of its ``<default>``s make the scene, `shape` is (rows, columns) of the
    photographs. A thread of its own calls `arrived` with the place whose light has come or failed.
    """

    def __init__(
        self,
        path: Path,
        given: Mapping[str, str],
        shape: tuple[int, int],
        arrived: Callable[[str], None],
    ) -> None:
        self._scene = str(path), dict(given), shape
        self._arrived = arrived
        self._results: dict[str, Array | BaseException | None] = {}  # None while it is rendered
        self._pool: Pool | None = None

    def want(self, place: str) -> None:
        """Render the light of a place after those that are wanted already, unless it is known.

        A PeriscopyError says that there is no such place.
        """
        if not place or place in self._results:
            return
        condition = str(find_condition(place))
        self._results[place] = None

        def arrive(result: Array | BaseException) -> None:
            self._results[place] = result
            self._arrived(place)

        if self._pool is None:
            self._pool = get_context("spawn").Pool(1, _begin)
        self._pool.apply_async(
            _render, (condition, *self._scene), callback=arrive, error_callback=arrive
        )

    def photograph(self, place: str) -> Array | None:
        """Return the light of a place, (rows, columns, 3); None before it has come.

        A PeriscopyError says that it cannot be rendered.
        """
        result = self._results.get(place)
        if isinstance(result, BaseException):
            raise PeriscopyError(str(result))
        return result

    def close(self) -> None:
        """End the process, in whatever it is doing."""
        if self._pool is not None:
            self._pool.terminate()
            self._pool.join()


def _begin() -> None:
    """Let the page's process alone heed Ctrl-C, and write what a renderer prints to stderr."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)


def _render(place: str, path: str, given: dict[str, str], shape: tuple[int, int]) -> Array:
    from periscopy_sim.rendering.ambient.background import render_background
    from periscopy_sim.rendering.scene.load import load_scenario

    scenario = load_scenario(path, (1, 1), given, photograph=shape)
    return render_background(place, scenario, **QUICK).photograph  # type: ignore[arg-type]
