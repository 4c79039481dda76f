"""What a sweep will do, and how long it takes, printed before it does it."""

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from periscopy_sim.cli.output import progress, record, say
from periscopy_sim.cli.session import Session
from periscopy_sim.cli.study.forecast import counted, show_parts, show_time
from periscopy_sim.errors import SceneError
from periscopy_sim.evaluation.world import flipped_names
from periscopy_sim.evaluation.worlds import Watcher, WorldParts
from periscopy_sim.numerics.machine import LONG

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.method import Note

Given = ParamSpec("Given")
Made = TypeVar("Made")

LIGHT_COST = {
    "ceiling_panels": 1.8, "desk_lamps": 2.8, "corridor": 7.9, "window_left": 28,
    "window_right": 55,
}  # fmt: skip
"""Processor time of ambient conditions over that of overcast, of the others 1: on the chair's wall
of 126 x 126 pixels, where overcast takes 6.6 s. That of window_right follows from five rounds."""

AXES = {
    "algorithm": "method", "image": "image", "background": "place", "sbr": "SBR", "snr": "SNR",
    "seed": "seed",
}  # fmt: skip
"""Axes that every sweep has, in words."""

SCENES = 8
"""Scenes that are loaded before a sweep starts."""


@dataclass(eq=False)
class SweepForecast(Watcher):
    """What a sweep lacks, and how long it takes by the first of each part; its times and notes."""

    session: Session  # which warns
    threads: int  # that reconstruct
    seconds: dict[str, list[float]] = field(default_factory=dict)  # of photographs, by method
    photographs: set[Path] = field(default_factory=set)  # to render; who renders one removes it
    matrices: dict[Any, int] = field(default_factory=dict)  # numbers by `Worlds.key`; likewise
    lights: dict[Path, str] = field(default_factory=dict)
    fits: int = 0  # scenes to which the methods are fitted
    cells: "Counter[str]" = field(default_factory=Counter)  # missing, without calibrations
    calibrations: int = 0  # photographs that calibrate; nothing shows their time before the first
    first: dict[str, Mapping[str, Any]] = field(default_factory=dict)  # missing cell of a method
    rate: float = 0.0  # seconds of ambient light whose `LIGHT_COST` is 1
    is_shown: bool = False  # whether the time is printed
    _sweep: Any = field(init=False)
    _seconds: dict[str, list[float]] = field(default_factory=dict, init=False)

    progress = staticmethod(progress)

    def begin(self, sweep: Any, missing: Sequence[Mapping[str, Any]]) -> None:
        """Print the results as a product over the axes, and what those that are missing need.

        Of more than `SCENES` scenes, the first ones show which ambient light is rendered.
        """
        self._sweep, worlds = sweep, sweep.world
        of_world = dict[tuple[Any, ...], int]()
        trials, fits = set[tuple[Any, ...]](), set[tuple[Any, ...]]()
        places, flips = dict[Path, Mapping[str, Any]](), len(flipped_names("", worlds.flips))
        for cell in missing:
            values = {name: value for name, value in cell.items() if name not in AXES}
            if (key := (*values.values(), cell["snr"])) not in of_world:
                of_world[key] = worlds.matrices(values)
                places.setdefault(worlds.ambient_folder(values), values)
                self.photographs |= worlds.missing_signals(cell["snr"], values)
                if of_world[key]:
                    self.matrices[worlds.key(values)] = of_world[key]
                    fits.add(key[:-1])
            if of_world[key]:
                self.cells[cell["algorithm"]] += 1
                self.first.setdefault(cell["algorithm"], cell)
            else:
                trials.add((*(value for name, value in cell.items() if name != "algorithm"),))
        self.calibrations, self.fits = len(trials), len(fits)
        for of_place in [*places.values()][:SCENES]:
            with suppress(SceneError):  # which fails alone
                self.lights |= worlds.missing_lights(of_place)
        sizes = {name: len(values) for name, values in sweep.axes.items()}
        results = math.prod(sizes.values())
        record(missing=len(missing), results=results)
        if missing:
            sizes["background"] //= flips
            words = [
                counted(size, AXES[name]) if name in AXES else f"{size} values of {name}"
                for name, size in sizes.items() if size > 1 or name in ("algorithm", "image")
            ] + [counted(flips, "flip")] * (flips > 1)  # fmt: skip
            left = f"{len(missing):,} of " if len(missing) < results else ""
            say(f"{left}{counted(results, 'result')}: {' x '.join(words)}")
            show_parts(
                photograph=len(self.photographs), ambient_light=len(self.lights),
                matrix=sum(self.matrices.values()), calibration=self.calibrations,
            )  # fmt: skip

    def timed(
        self, part: str, make: Callable[Given, Made], *given: Given.args, **named: Given.kwargs
    ) -> Made:
        """Return what a function makes, and keep the time of this part."""
        started = time.perf_counter()
        made = make(*given, **named)
        self._seconds.setdefault(part, []).append(time.perf_counter() - started)
        return made

    def made(self, part: Any) -> None:
        """Take a photograph's file, or the key of matrices, off what is missing."""
        self.photographs.discard(part)
        self.matrices.pop(part, None)

    def took(self, method: str, seconds: float) -> None:
        """Keep the time of a photograph by a method."""
        self.seconds.setdefault(method, []).append(seconds)

    def note(self, notes: "Sequence[Note | str]") -> None:
        """Print notes on a scene, or lines."""
        self.session.warn_of(each for each in notes if not isinstance(each, str))
        self.session.warn(*(line for line in notes if isinstance(line, str)))

    def see(self, world: WorldParts) -> None:
        """Print how long the rest takes, by the parts of the first world and some more."""
        from periscopy_sim.evaluation.sweep import cell_seconds

        if self.is_shown:
            return
        if self._seconds["fit"][-1] < LONG:  # without what the first one compiles
            self.timed("fit", world.fit)
        even = world.evenly_lit({cell["background"] for cell in self.first.values()})
        seconds, writing = cell_seconds(self._sweep, even, self.first)
        if missing := [file for file in world.lights if file in self.lights]:
            file = min(missing, key=lambda each: LIGHT_COST.get(self.lights[each], 1.0))
            name = self.lights.pop(file)
            self.timed("light", world.trace, name)
            self.rate = self._seconds["light"][-1] / LIGHT_COST.get(name, 1.0)
        matrices, fits = (self._seconds.get(part, []) for part in ("matrix", "fit"))
        of_fit = fits[-1] - sum(matrices[-(len(matrices) // len(fits)) :])
        show_time(
            max(self._seconds["photograph"]) * len(self.photographs)
            + self.rate * sum(LIGHT_COST.get(name, 1.0) for name in self.lights.values())
            + max(matrices) * sum(self.matrices.values())
            + of_fit * (self.fits - 1)
            + sum(self.cells[n] * (each / self.threads + writing) for n, each in seconds.items()),
            *([counted(self.calibrations, "calibration")] if self.calibrations else []),
        )
        self.is_shown = True
