"""What a sweep lacks, and how long it takes by the first of each part, before it starts."""

import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.evaluation.sweep import Sweep, cell_seconds
from periscopy_sim.evaluation.sweep_store import Values
from periscopy_sim.evaluation.world import flipped_names
from periscopy_sim.evaluation.worlds import Worlds
from periscopy_sim.memo import Memo
from periscopy_sim.numerics.machine import LONG
from periscopy_sim.rendering.ambient.background import Background

Result = TypeVar("Result")

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


def work_of(sweep: Sweep, missing: Sequence[Values]) -> SweepWork:
    """Return what missing cells of a sweep of `Worlds` need."""
    worlds: Worlds = sweep.world
    sizes, flips = {n: len(v) for n, v in sweep.axes.items()}, len(flipped_names("", worlds.flips))
    work = SweepWork({**sizes, "background": sizes["background"] // flips}, flips, len(missing))
    rendered, places = worlds.shown.keys() - worlds.photographs.keys(), dict[str, Any]()
    for cell in missing:
        values = {name: cell[name] for name in sweep.vary}
        place = worlds.place(values)
        places.setdefault(place, values)
        work.photographs |= {(place, name, cell["snr"]) for name in rendered}
        if count := worlds.matrices(values):
            light = worlds.light(values)
            work.matrices[worlds.place(values, "assumed."), light.samples, light.by] = count
            work.fits.add((*values.values(),))
            work.cells[cell["algorithm"]] += 1
            work.first = work.first or cell
        else:
            work.calibrations.add((*(v for name, v in cell.items() if name != "algorithm"),))
    for values in [*places.values()][:SCENES]:
        with suppress(SceneError):  # which fails alone
            work.lights |= worlds.at(values).missing_ambient(worlds.traced)
    return work


def seconds_of(sweep: Sweep, work: SweepWork, first: Values, threads: int) -> float:
    """Return how long the missing cells of a sweep take, but for calibrations.

    The parts of the first one's world, which are made, and one more fit are timed.
    """
    worlds: Worlds = sweep.world
    values, snr = {name: first[name] for name in sweep.vary}, first["snr"]
    shots = [_clock(worlds.signal, name, snr, values) for name in worlds.shown]
    wall = shots[0][1]
    fresh = replace(worlds, scenario=replace(worlds.scenario, memo=Memo()))
    for each in (worlds, fresh):  # without what the first one compiles
        scene = each.assumed(values)
        of_matrices = sum(
            _clock(scene.transport, each.noise, method)[0] for method in each.methods.values()
        )
        of_fit, _ = _clock(each.fitted, values, wall)
        if of_matrices + of_fit > LONG:
            break
    even = Background(np.ones_like(wall.values), 0.0, 0.0)
    world = worlds.world(snr, values, dict.fromkeys(worlds.ambient, even))
    trial = {name: {**first, "algorithm": name} for name in work.cells}
    of_cell, writing = cell_seconds(sweep, world, trial)
    place, costs = worlds.at(values), [LIGHT_COST.get(each, 1.0) for each in work.lights.values()]
    of_light = 0.0
    if missing := [*place.missing_ambient(worlds.traced).values()]:
        name = min(missing, key=lambda each: LIGHT_COST.get(each, 1.0))
        of_light, _ = _clock(place.ambient, name, progress=worlds.progress)
        of_light /= LIGHT_COST.get(name, 1.0)
        costs.remove(LIGHT_COST.get(name, 1.0))
    return (
        max(seconds for seconds, _ in shots) * (len(work.photographs) - len(shots))
        + of_light * sum(costs)
        + of_matrices * (sum(work.matrices.values()) / worlds.matrices(values) - 1)
        + of_fit * (len(work.fits) - 1)
        + sum(work.cells[n] * (each / threads + writing) for n, each in of_cell.items())
    )


def _clock(make: Callable[..., Result], *given: Any, **named: Any) -> tuple[float, Result]:
    """Return how long a call takes, in seconds, and its result."""
    started = time.perf_counter()
    made = make(*given, **named)
    return time.perf_counter() - started, made
