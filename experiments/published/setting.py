"""What every experiment on the published data set gets: its captures, and scenes fitted to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.published.data_set import Capture, DataSet
from experiments.published.layout import (
    FRAMES,
    PLACEMENTS,
    STILLS,
    WITHOUT_AMBIENT,
    Placement,
    place_of,
)
from experiments.report import Table
from experiments.setting import FittedScene
from periscopy_sim.reconstruction.method import StillMethod


@dataclass(frozen=True)
class Tried:
    """A placement, and what it leaves unexplained of a capture; None if none can be read."""

    placement: Placement
    unexplained: float | None


class PublishedSetting:
    """The data set, where its things stood, and the methods fitted to that.

    Parameters
    ----------
    out
        Folder of the run.
    data
        The data set.
    scenes
        Scenes by folder of the data set, in place of what is known of these.
    hidden
        (R, C) of the hidden image.
    photograph
        (rows, columns) that captures are averaged to; None for each scene's film.

    Raises
    ------
    PeriscopyError
        If the data set is not there, or a scene is for a folder that it does not know.
    """

    seed = 0

    def __init__(
        self,
        out: Path,
        data: Path,
        scenes: Mapping[str, str] | None = None,
        hidden: tuple[int, int] = (29, 36),
        photograph: tuple[int, int] | None = None,
    ) -> None:
        self.out = out
        self.hidden = hidden
        self.photograph = photograph
        self.placements = dict(PLACEMENTS)
        for folder, scene in (scenes or {}).items():
            if folder not in PLACEMENTS:
                known = ", ".join(PLACEMENTS)
                raise ps.PeriscopyError(f"no folder '{folder}' has a scene; there are {known}")
            file = ps.find_scene(scene)
            self.placements[folder] = (Placement(f"yours, {scene}", str(file)),)
        self.data = DataSet(data, hidden)
        self._tried: dict[str, list[Tried]] = {}
        self._fitted: tuple[Placement, FittedScene] | None = None

    def identity(self) -> bytes:
        """Return what tells this data set, these scenes and sizes from others."""
        given = [
            Path(placement.scene).read_bytes()
            for placements in self.placements.values()
            for placement in placements
            if Path(placement.scene).is_file()
        ]
        return b"\n".join([self.data.identity(), str(self.photograph).encode(), *given])

    def tried(self, folder: str) -> list[Tried]:
        """Return the placements of a folder, what fits one of its captures best first.

        That is judged by what scene and image leave unexplained of it, without the ground truth.
        """
        place = place_of(folder)
        if place not in self._tried:
            candidates = self.placements[place]
            tried = [
                Tried(placement, self._unexplained(place, placement)) for placement in candidates
            ]
            self._tried[place] = sorted(tried, key=lambda one: one.unexplained or 0)
        return self._tried[place]

    def best(self, folder: str) -> Placement:
        """Return the placement that a folder's photographs are reconstructed with."""
        placements = self.placements[place_of(folder)]
        return placements[0] if len(placements) == 1 else self.tried(folder)[0].placement

    def fitted(self, folder: str) -> FittedScene:
        """Return the scene of a folder's best placement; only the latest one is kept."""
        best = self.best(folder)
        if self._fitted is None or self._fitted[0] is not best:
            self._fitted = None  # gigabytes, before the next ones
            self._fitted = (best, self.scene(best))
        return self._fitted[1]

    def scene(
        self, placement: Placement, parameters: Mapping[str, float] | None = None
    ) -> FittedScene:
        """Return the scene of a placement, further parameters set."""
        values = {**placement.parameters, **(parameters or {})}
        return FittedScene(placement.scene, self.hidden, self.seed, values, self.photograph)

    def shape(self, folder: str) -> tuple[int, int]:
        """Return (rows, columns) of a folder's photographs."""
        if self.photograph is not None:
            return self.photograph
        return self._shapes[place_of(folder)]

    def readable(self, folder: str, names: Sequence[str]) -> list[Capture]:
        """Return those captures of a folder that can be read."""
        return self.data.readable((f"{folder}/{name}" for name in names), self.shape(folder))

    def reference(self, place: str) -> Capture | None:
        """Return the capture that placements of a folder are tried on, without ambient light."""
        names = [
            *filter(None, [WITHOUT_AMBIENT.get(place)]),
            *{**STILLS, **FRAMES}[place],
        ]
        found = (self.data.read(f"{place}/{name}", self.shape(place)) for name in names)
        return next((capture for capture in found if capture is not None), None)

    def not_read(self, folder: str, names: Sequence[str]) -> list[Table]:
        """Return a table of the captures of a folder that cannot be read, if there are any."""
        self.readable(folder, names)
        rows = self.data.problems_of(folder, names)
        return [Table("Not read.", ("capture", "why"), rows)] if rows else []

    @cached_property
    def _shapes(self) -> dict[str, tuple[int, int]]:
        return {
            place: ps.load_scenario(options[0].scene, (1, 1)).photograph_shape
            for place, options in self.placements.items()
        }

    def _unexplained(self, place: str, placement: Placement) -> float | None:
        capture = self.reference(place)
        if capture is None:
            return None
        method = self.scene(placement).noise_aware
        return unexplained(method, capture.photograph, method.solve(capture.photograph))


def unexplained(method: StillMethod[Any], photograph: NDArray[np.float64], found: Any) -> float:
    """Return what scene and solution leave of a photograph, over its root mean square."""
    left = method.residual(photograph, found)
    assert left is not None
    return left.unexplained
