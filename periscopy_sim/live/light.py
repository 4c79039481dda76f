"""The light of ambient places, rendered in a process of its own while the laboratory goes on.

A process can be ended at any time. This one has a session of its own: Ctrl-C in the terminal does
not reach it, in whatever moment of its start.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Lock, Thread

import numpy as np

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
        self._scene, self._shape = (str(path), dict(given), shape), shape
        self._arrived = arrived
        self._lock = Lock()
        self._results: dict[str, Array | str] = {}  # a photograph, or why there is none
        self._rendering: tuple[str, subprocess.Popen[bytes]] | None = None

    def want(self, place: str) -> None:
        """Render the light of a place, unless it is known; end the rendering of another place.

        A PeriscopyError says that there is no such place.
        """
        with self._lock:
            if self._rendering is not None:
                if self._rendering[0] == place:
                    return
                process = self._rendering[1]
                self._rendering = None
                process.kill()
                process.wait()
            if place and place not in self._results:
                job = json.dumps([str(find_condition(place)), *self._scene])
                process = subprocess.Popen(
                    [sys.executable, "-m", __name__, job], stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE, start_new_session=True,
                )  # fmt: skip
                self._rendering = place, process
                Thread(target=self._await, args=(place, process), daemon=True).start()

    def photograph(self, place: str) -> Array | None:
        """Return the light of a place, (rows, columns, 3); None before it has come.

        A PeriscopyError says that it cannot be rendered.
        """
        result = self._results.get(place)
        if isinstance(result, str):
            raise PeriscopyError(result)
        return result

    def close(self) -> None:
        """End the present rendering."""
        self.want("")

    def _await(self, place: str, process: subprocess.Popen[bytes]) -> None:
        light, errors = process.communicate()
        result: Array | str = " ".join(errors.decode(errors="replace").splitlines()[-1:])
        if process.returncode == 0:
            result = np.frombuffer(light).reshape(*self._shape, 3)
        with self._lock:
            if self._rendering is None or self._rendering[1] is not process:
                return  # another place is wanted
            self._rendering, self._results[place] = None, result
        self._arrived(place)


def _render(place: str, path: str, given: dict[str, str], shape: tuple[int, int]) -> Array:
    from periscopy_sim.rendering.ambient.background import render_background
    from periscopy_sim.rendering.scene.load import load_scenario

    scenario = load_scenario(path, (1, 1), given, photograph=(shape[0], shape[1]))
    return render_background(place, scenario, **QUICK).photograph  # type: ignore[arg-type]


if __name__ == "__main__":
    out = os.dup(1)
    os.dup2(2, 1)  # a renderer may print
    try:
        light = _render(*json.loads(sys.argv[1]))
    except PeriscopyError as error:
        sys.exit(str(error))
    with open(out, "wb") as stream:  # noqa: PTH123  a descriptor
        stream.write(light.tobytes())
