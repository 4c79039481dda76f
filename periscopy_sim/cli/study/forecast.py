"""What a long command will do, and how long it takes, printed before it does it."""

import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from periscopy_sim.cli.output import record, say
from periscopy_sim.errors import SceneError
from periscopy_sim.numerics.machine import LONG

if TYPE_CHECKING:
    from periscopy_sim.evaluation.sweep import Sweep
    from periscopy_sim.evaluation.world import World

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

PLURALS = {"matrix": "matrices", "geometry": "geometries"}
"""Nouns whose plural has more than an s."""


def counted(count: int, noun: str) -> str:
    """Return a count with its noun."""
    plural = PLURALS.get(noun, f"{noun}s")
    return f"{count:,} {noun if count == 1 else plural}"


def show_parts(**numbers: int) -> None:
    """Print how many photographs, ambient lights and so on a command makes."""
    record(to_make=numbers)
    words = [counted(n, noun.replace("_", " ")) for noun, n in numbers.items() if n]
    if words:
        say(f"to make: {', '.join(words)}")


def show_time(seconds: float, *apart: str) -> None:
    """Print how long a command takes, but for what is apart."""
    record(estimated_seconds=round(seconds))
    number, unit = max(float(f"{seconds:.2g}"), 1.0), "s"
    for unit_seconds, name in ((3600, "hours"), (60, "minutes")):
        if seconds > 1.5 * unit_seconds:
            number, unit = float(f"{seconds / unit_seconds:.2g}"), name
            break
    say(" and ".join([f"about {number:g} {unit}", *apart]))


@dataclass(frozen=True, eq=False)
class Parts:
    """What a world of a sweep is made of."""

    photographs: set[Path]
    # Folder and pattern of the files, and how many are needed; None where methods calibrate.
    matrices: tuple[Path, str, int] | None
    place: Path  # folder of the ambient light
    lights: Callable[[], Mapping[Path, str]]  # rendered conditions, by files in the user's cache


@dataclass(eq=False)
class SweepForecast:
    """What a sweep lacks, and how long it takes by the first of each part."""

    photographs: set[Path] = field(default_factory=set)  # to render; who renders one removes it
    matrices: dict[tuple[Path, str], int] = field(default_factory=dict)  # numbers, see `Parts`
    lights: dict[Path, str] = field(default_factory=dict)
    fits: int = 0  # scenes to which the methods are fitted
    cells: "Counter[str]" = field(default_factory=Counter)  # missing, without calibrations
    calibrations: int = 0  # photographs that calibrate; nothing shows their time before the first
    first: dict[str, Mapping[str, Any]] = field(default_factory=dict)  # missing cell of a method
    rate: float = 0.0  # seconds of ambient light whose `LIGHT_COST` is 1
    is_shown: bool = False  # whether the time is printed
    _sweep: "Sweep" = field(init=False)
    _seconds: dict[str, list[float]] = field(default_factory=dict, init=False)

    def begin(
        self,
        sweep: "Sweep",
        missing: Sequence[Mapping[str, Any]],
        parts_of: Callable[..., Parts],
        flips: int,
    ) -> None:
        """Print the results as a product over the axes, and what those that are missing need.

        Of more than `SCENES` scenes, the first ones show which ambient light is rendered.
        """
        self._sweep, worlds = sweep, dict[tuple[Any, ...], Parts]()
        trials, fits, places = set[tuple[Any, ...]](), set[tuple[Any, ...]](), dict[Path, Parts]()
        for cell in missing:
            values = {n: value for n, value in cell.items() if n not in AXES}
            if (key := (*values.values(), cell["snr"])) not in worlds:
                worlds[key] = parts = parts_of(cell["snr"], **values)
                places.setdefault(parts.place, parts)
                self.photographs |= parts.photographs
                if parts.matrices:
                    folder, pattern, count = parts.matrices
                    self.matrices[folder, pattern] = count
                    fits.add(key[:-1])
            if worlds[key].matrices:
                self.cells[cell["algorithm"]] += 1
                self.first.setdefault(cell["algorithm"], cell)
            else:
                trials.add((*(value for name, value in cell.items() if name != "algorithm"),))
        self.calibrations, self.fits = len(trials), len(fits)
        for parts in [*places.values()][:SCENES]:
            with suppress(SceneError):  # which fails alone
                self.lights |= parts.lights()
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
            photographs, matrices = self._missing()
            show_parts(
                photograph=photographs, ambient_light=len(self.lights), matrix=matrices,
                calibration=self.calibrations,
            )  # fmt: skip

    def _missing(self) -> tuple[int, int]:
        """Return how many photographs and matrices are left to make."""
        held = {key: len([*key[0].glob(key[1])]) for key in self.matrices}
        return (
            len(self.photographs),
            sum(max(count - held[key], 0) for key, count in self.matrices.items()),
        )

    def timed(
        self, part: str, make: Callable[Given, Made], *given: Given.args, **named: Given.kwargs
    ) -> Made:
        """Return what a function makes, and keep the time of this part."""
        started = time.perf_counter()
        made = make(*given, **named)
        self._seconds.setdefault(part, []).append(time.perf_counter() - started)
        return made

    def measure(
        self,
        fit: Callable[[], Any],
        evenly_lit: "Callable[[Collection[str]], World]",
        own_lights: Collection[Path],
        trace: Callable[[str], Any],
        threads: int,
    ) -> None:
        """Print how long the rest takes, by the parts of the first world and some more.

        The functions fit the methods, return this world in even light of some names, and trace one
        of its own ambient conditions; so many threads reconstruct.
        """
        from periscopy_sim.evaluation.sweep import cell_seconds

        if self._seconds["fit"][-1] < LONG:  # without what the first one compiles
            self.timed("fit", fit)
        world = evenly_lit({cell["background"] for cell in self.first.values()})
        seconds, writing = cell_seconds(self._sweep, world, self.first)
        if missing := [file for file in own_lights if file in self.lights]:
            file = min(missing, key=lambda each: LIGHT_COST.get(self.lights[each], 1.0))
            name = self.lights.pop(file)
            self.timed("light", trace, name)
            self.rate = self._seconds["light"][-1] / LIGHT_COST.get(name, 1.0)
        matrices, fits = (self._seconds.get(part, []) for part in ("matrix", "fit"))
        of_fit = fits[-1] - (sum(matrices) if len(fits) == 1 else 0.0)
        photographs_left, matrices_left = self._missing()
        show_time(
            max(self._seconds["photograph"]) * photographs_left
            + self.rate * sum(LIGHT_COST.get(name, 1.0) for name in self.lights.values())
            + max(matrices) * matrices_left
            + of_fit * (self.fits - 1)
            + sum(self.cells[name] * (seconds[name] / threads + writing) for name in seconds),
            *([counted(self.calibrations, "calibration")] if self.calibrations else []),
        )
        self.is_shown = True
