"""What a sweep lacks, and how long it takes by the first of each part, before it starts."""

import math
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from periscopy_sim.errors import PeriscopyError, SceneError
from periscopy_sim.evaluation.sweep import Sweep, cell_seconds
from periscopy_sim.evaluation.sweep_store import Values
from periscopy_sim.evaluation.world import flipped_names
from periscopy_sim.evaluation.worlds import ASSUMED, Worlds
from periscopy_sim.measurement import noise_to_signal
from periscopy_sim.memo import Memo
from periscopy_sim.numerics.machine import LONG
from periscopy_sim.photograph import Photograph
from periscopy_sim.rendering.ambient.background import Background
from periscopy_sim.scenario import Scenario

LIGHT_COST = {
    "ceiling_panels": 1.8, "desk_lamps": 2.8, "corridor": 7.9, "window_left": 28,
    "window_right": 55,
}  # fmt: skip
"""Processor time of ambient conditions over that of overcast, of the others 1: on the chair's wall
of 126 x 126 pixels, where overcast takes 6.6 s. That of window_right follows from five rounds."""

SCENES = 8
"""Scenes that are loaded before a sweep starts, to see which ambient light is missing."""


@dataclass(eq=False)
class SweepWork:
    """What a sweep makes: results, of which some are missing, and what these need."""

    sweep: Sweep  # of `Worlds`
    sizes: dict[str, int]  # of the axes; backgrounds without their flips
    flips: int
    missing: int
    first: Values | None = None  # missing cell whose methods need a matrix
    cells: Counter[str] = field(default_factory=Counter)  # missing, by method, without calibrations
    photographs: set[Any] = field(default_factory=set)
    lights: dict[Any, str] = field(default_factory=dict)  # names of ambient light
    matrices: dict[Any, int] = field(default_factory=dict)
    fits: set[Any] = field(default_factory=set)
    calibrations: set[Any] = field(default_factory=set)  # photographs that calibrate

    @property
    def results(self) -> int:
        """The number of results, those that are there included."""
        return self.flips * math.prod(self.sizes.values())

    @property
    def to_make(self) -> dict[str, int]:
        """Numbers of photographs, ambient light, matrices and calibrations."""
        return {
            "photograph": len(self.photographs), "ambient_light": len(self.lights),
            "matrix": sum(self.matrices.values()), "calibration": len(self.calibrations),
        }  # fmt: skip

    @classmethod
    def of(cls, sweep: Sweep, missing: Sequence[Values]) -> Self:
        """Return what missing cells of a sweep need."""
        worlds: Worlds = sweep.world
        sizes = {name: len(values) for name, values in sweep.axes.items()}
        flips = len(flipped_names("", worlds.flips))
        sizes["background"] //= flips
        work, places = cls(sweep, sizes, flips, len(missing)), dict[str, Any]()
        rendered = worlds.shown.keys() - worlds.photographs.keys()
        for cell in missing:
            values = {name: cell[name] for name in sweep.vary}
            place = worlds.place(values)
            places.setdefault(place, values)
            work.photographs |= {(place, name, cell["snr"]) for name in rendered}
            if count := worlds.matrices(values):
                light, snr = worlds.light(values), cell["snr"]
                way = light.samples or snr, light.by
                work.matrices[worlds.place(values, ASSUMED), *way] = count
                work.fits.add((snr, *values.values()))
                work.cells[cell["algorithm"]] += 1
                work.first = work.first or cell
            else:
                work.calibrations.add((*(v for name, v in cell.items() if name != "algorithm"),))
        for values in [*places.values()][:SCENES]:
            with suppress(SceneError):  # which fails alone
                work.lights |= worlds.at(values).missing_ambient(worlds.traced)
        return work

    def seconds(self, threads: int) -> float | None:
        """Return how long the missing cells take on some threads, but for calibrations.

        The parts of the first one's world, which are made, and one more fit are timed. None where
        all calibrate, or that world is an error, which the sweep meets.
        """
        worlds: Worlds = self.sweep.world
        if (first := self.first) is None:
            return None
        values, snr = {name: first[name] for name in self.sweep.vary}, first["snr"]
        try:
            started = time.perf_counter()
            for name in worlds.shown:
                wall = worlds.signal(name, snr, values)
            of_photographs = time.perf_counter() - started
            of_matrices, of_fit = self._fit(worlds, snr, values, wall)
            if of_matrices + of_fit < LONG:  # without what the first one compiles
                fresh = replace(worlds, scenario=replace(worlds.scenario, memo=Memo()))
                of_matrices, of_fit = self._fit(fresh, snr, values, wall)
            even = Background(np.ones_like(wall.values), 0.0, 0.0)
            world = worlds.world(snr, values, dict.fromkeys(worlds.ambient, even))
            trial = {name: {**first, "algorithm": name} for name in self.cells}
            of_cell, writing = cell_seconds(self.sweep, world, trial)
            of_lights = self._light(worlds.at(values), worlds)
        except PeriscopyError:
            return None
        return (
            of_photographs * (len(self.photographs) / len(worlds.shown) - 1)
            + of_lights
            + of_matrices * (sum(self.matrices.values()) / worlds.matrices(values) - 1)
            + of_fit * (len(self.fits) - 1)
            + sum(self.cells[n] * (each / threads + writing) for n, each in of_cell.items())
        )

    @staticmethod
    def _fit(worlds: Worlds, snr: float, values: Values, wall: Photograph) -> tuple[float, float]:
        """Return the seconds of the matrices, and of fits to them."""
        scene, started = worlds.assumed(values), time.perf_counter()
        for method in worlds.methods.values():
            scene.transport(noise_to_signal(snr, np.inf), method)
        made = time.perf_counter()
        worlds.fitted(snr, values, wall)
        return made - started, time.perf_counter() - made

    def _light(self, scenario: Scenario, worlds: Worlds) -> float:
        """Return the seconds of missing ambient light but for the quickest, which is made."""
        costs = sum(LIGHT_COST.get(name, 1.0) for name in self.lights.values())
        missing = scenario.missing_ambient(worlds.traced).values()
        if not missing:
            return 0.0
        name = min(missing, key=lambda each: LIGHT_COST.get(each, 1.0))
        started = time.perf_counter()
        scenario.ambient(name, progress=worlds.progress)
        return (time.perf_counter() - started) * (costs / LIGHT_COST.get(name, 1.0) - 1)
