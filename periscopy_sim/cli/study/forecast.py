"""What a long command will do, and how long it takes, printed before it does it."""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from periscopy_sim.cli.output import record, say

Given = ParamSpec("Given")
Made = TypeVar("Made")

LIGHT_COST = {"ceiling_panels": 1.8, "desk_lamps": 2.8, "corridor": 7.9}
"""Processor time of ambient conditions over that of overcast, of others 1: on the chair's wall of
126 x 126 pixels."""

AXES = {"algorithm": "method", "background": "place", "sbr": "SBR", "snr": "SNR"}
"""Axes of a sweep in words."""

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


@dataclass(eq=False)
class SweepForecast:
    """What a sweep lacks, and how long it takes by the first of each part.

    Attributes
    ----------
    photographs
        Their files.
    matrices
        Patterns of their files, with the number of those that are needed, by folder.
    lights
        Ambient conditions that are rendered, by their files in the user's cache.
    fits
        Scenes to which the methods are fitted.
    cells
        Missing results of each method, but those of calibrations.
    calibrations
        Photographs that calibrate the scene; nothing shows their time before the first.
    first
        The first missing result of each method.
    rate
        Seconds of ambient light whose `LIGHT_COST` is 1.
    is_shown
        Whether the time is printed.
    """

    photographs: set[Path] = field(default_factory=set)
    matrices: dict[tuple[Path, str], int] = field(default_factory=dict)
    lights: dict[Path, str] = field(default_factory=dict)
    fits: int = 0
    cells: "Counter[str]" = field(default_factory=Counter)
    calibrations: int = 0
    first: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    rate: float = 0.0
    is_shown: bool = False
    _seconds: dict[str, list[float]] = field(default_factory=dict, init=False)

    def show_work(self, sizes: Mapping[str, int], missing: int) -> None:
        """Print the results as a product over the axes, and what is rendered."""
        words, count = list[str](), 1
        for axis, size in sizes.items():
            count *= size
            if size > 1 or axis in ("algorithm", "image"):
                is_known = axis in (*AXES, "image", "flip", "seed")
                noun = AXES.get(axis, axis)
                words.append(counted(size, noun) if is_known else f"{size} values of {axis}")
        record(missing=missing, results=count)
        if missing:
            left = f"{missing:,} of " if missing < count else ""
            say(f"{left}{counted(count, 'result')}: {' x '.join(words)}")
            photographs, matrices = self._missing()
            show_parts(
                photograph=photographs, ambient_light=len(self.lights), matrix=matrices,
                calibration=self.calibrations,
            )  # fmt: skip

    def _missing(self) -> tuple[int, int]:
        """Return how many photographs and matrices are missing."""
        held = {key: len([*key[0].glob(key[1])]) for key in self.matrices}
        return (
            sum(not file.is_file() for file in self.photographs),
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

    def latest(self, part: str) -> float:
        """Return the latest time of a part."""
        return self._seconds[part][-1]

    def show_time(self, threads: int, seconds: Mapping[str, float]) -> None:
        """Print how long the rest takes, by the seconds of a thread for a result of each method."""
        matrices, fits = (self._seconds.get(part, []) for part in ("matrix", "fit"))
        fit = fits[-1] - (sum(matrices) if len(fits) == 1 else 0.0)
        photographs_left, matrices_left = self._missing()
        show_time(
            max(self._seconds["photograph"]) * photographs_left
            + self.rate * sum(LIGHT_COST.get(name, 1.0) for name in self.lights.values())
            + max(matrices) * matrices_left
            + fit * (self.fits - 1)
            + sum(self.cells[name] * each for name, each in seconds.items()) / threads,
            *([counted(self.calibrations, "calibration")] if self.calibrations else []),
        )
        self.is_shown = True
