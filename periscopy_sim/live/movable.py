"""What of a scene can be moved: its ``<default>``s, and handles for those that move things.

Which parameter moves what is not told by names: each is changed a little, and what has moved is
compared with what stood there before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from periscopy_sim.calibration.prior import declared_errors
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import CALIBRATED, read_document
from periscopy_sim.scenario import Array, Scenario

REACH = 10.0
"""Ruler's errors that a slider reaches to either side: farther than anyone calibrates."""

FAR = 0.1
"""Metres by which things move at a slider's ends, where no ruler's error is known."""

STEPS = 200
"""Of a slider, from its middle to either end."""

NUDGE = 1e-3
"""By how much a parameter is changed to see what it moves; as a part of it, unless it is 0."""

STILL = 1e-7
"""Metres that count as not moved: Mitsuba's single precision."""

RIGID = 1e-3
"""Part of a move by which points may differ from it, and still move as one."""

Points = Mapping[str, Array]


@dataclass(frozen=True)
class Movable:
    """A number that a scene declares, and the range and the steps in which a person moves it."""

    name: str
    value: float
    low: float
    high: float
    step: float

    def within(self, value: float) -> float:
        """Return the value nearest to one that is within the range."""
        return min(max(value, self.low), self.high)


@dataclass(frozen=True, eq=False)
class Handle:
    """Something that moves as one by some parameters: drag it, and these follow.

    Attributes
    ----------
    name
        What moves, in words.
    names
        The K parameters.
    directions
        (K, 3) metres that it moves for each unit of them; linearly independent.
    center
        (3,) where it is, in metres, at the parameters' `start`, (K,).
    """

    name: str
    names: tuple[str, ...]
    directions: Array
    center: Array
    start: Array

    def position(self, values: Mapping[str, float]) -> Array:
        """Return where it is, (3,), at some values."""
        moved = np.array([values[name] for name in self.names]) - self.start
        return np.asarray(self.center + moved @ self.directions)

    def values(self, position: Array) -> dict[str, float]:
        """Return the values that bring it nearest to a position, (3,)."""
        moved = np.linalg.lstsq(self.directions.T, position - self.center, rcond=None)[0]
        return dict(zip(self.names, (self.start + moved).tolist(), strict=True))

    @property
    def axes(self) -> tuple[bool, bool, bool]:
        """Whether it moves along x, y and z, each by itself."""
        _, _, span = np.linalg.svd(self.directions, full_matrices=False)
        along = np.linalg.norm(span, axis=0) > 1 - RIGID
        return bool(along[0]), bool(along[1]), bool(along[2])


def find_movables(
    path: Path, given: Mapping[str, str], load: Callable[[Mapping[str, str]], Scenario]
) -> tuple[tuple[Movable, ...], tuple[Handle, ...]]:
    """Return what of a scene can be moved, in the file's order, and its handles.

    `load` makes a scenario of values for the scene's ``<default>``s, one of a small photograph.
    Numbers that no neighbour can replace, such as whole ones, and those that change the
    photograph's size are left out. A SceneError says that nothing can be moved.
    """
    errors = declared_errors(path, given)
    here = load(given)
    before = _things(here)
    movables, moves = [], {}
    for name, value in _numbers(path, given).items():
        nudge = NUDGE * (abs(value) or 1.0)
        there = _beside(load, given, name, value, nudge)
        if there is None:
            continue
        scenario, apart = there
        if scenario.photograph_shape != here.photograph_shape:
            continue
        moved = _moved(before, _things(scenario), apart)
        if (shift := _shift(moved)) is not None:
            moves[name] = (frozenset(moved), shift)
        movables.append(
            _movable(name, value, errors.get(name, 0.0), _farthest(moved), is_place=name in moves)
        )
    if not movables:
        raise SceneError(
            f"scene '{path}' declares nothing that can be moved; declare a number, such as "
            '<default name="occluder_dx" value="0"/>, and use it as $occluder_dx'
        )
    return tuple(movables), tuple(_handles(movables, moves, before))


def _numbers(path: Path, given: Mapping[str, str]) -> dict[str, float]:
    """Return the numbers that a scene declares, as they are set, but for the ruler's errors."""
    document = read_document(path)
    numbers = {}
    for name, text in document.defaults.items():
        if name in document.errors or name == CALIBRATED:
            continue
        try:
            value = float(given.get(name, text))
        except ValueError:
            continue
        if np.isfinite(value):
            numbers[name] = value
    return numbers


def _things(scenario: Scenario) -> dict[str, Array]:
    """Return points, (n, 3), of what a scene consists of, by its name."""
    shapes = {
        each.name: each.vertices if each.vertices is not None else each.bounds
        for each in scenario.occluders
    }
    seen = {"camera": scenario.wall_points, "monitor": scenario.patch_centers}
    return seen | {name: points for name, points in shapes.items() if points is not None}


def _beside(
    load: Callable[[Mapping[str, str]], Scenario],
    given: Mapping[str, str],
    name: str,
    value: float,
    nudge: float,
) -> tuple[Scenario, float] | None:
    """Return the scene with a parameter a little beside its value, and how far; or None."""
    for apart in (nudge, -nudge):
        try:
            return load({**given, name: f"{value + apart:.17g}"}), apart
        except SceneError:
            continue
    return None


def _moved(before: Points, after: Points, apart: float) -> dict[str, Array]:
    """Return how far the points of each thing have moved, (n, 3), for each unit of a parameter."""
    moved = {}
    for name in before.keys() & after.keys():
        if before[name].shape != after[name].shape:
            continue
        change = after[name] - before[name]
        if np.abs(change).max() > STILL:
            moved[name] = change / apart
    return moved


def _farthest(moved: Points) -> float:
    """Return how far the farthest point moves, in metres for each unit; 0 if none does."""
    return max((float(np.linalg.norm(each, axis=1).max()) for each in moved.values()), default=0.0)


def _shift(moved: Points) -> Array | None:
    """Return the direction, (3,), in which all that has moved does so as one; None otherwise."""
    if not moved:
        return None
    every = np.concatenate(list(moved.values()))
    shift = every.mean(axis=0)
    length = float(np.linalg.norm(shift))
    if np.abs(every - shift).max() > RIGID * length:
        return None
    exact = shift / length
    exact[np.abs(exact) < RIGID] = 0  # of rounding, a handle would be turned a little
    return np.asarray(length * exact / np.linalg.norm(exact))


def _movable(name: str, value: float, error: float, farthest: float, *, is_place: bool) -> Movable:
    """Return a parameter with its range, from a ruler's error or from how far things move."""
    half = FAR / farthest if farthest > 0 else abs(value) / 2 or 1.0
    if np.isfinite(error) and error > 0:
        half = REACH * error
    elif value and not is_place:  # a size, a factor, an exponent
        half = min(half, abs(value) / 2)
    step = _round(half / STEPS)
    below = STEPS
    if 0 < value <= STEPS * step and not is_place:
        below = max(1, int(0.9 * value / step))
    low, high = (float(f"{value + n * step:.12g}") for n in (-below, STEPS))
    return Movable(name, value, low, high, step)


def _round(step: float) -> float:
    """Return the round number next above a positive one: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(step))
    return float(next(n for n in (1, 2, 5, 10) if n * power >= 0.999 * step) * power)


def _handles(
    movables: Sequence[Movable], moves: Mapping[str, tuple[frozenset[str], Array]], things: Points
) -> list[Handle]:
    """Return a handle for each set of things that some parameters move as one.

    What is but a part of such a set has none: it would stand in the other's way.
    """
    values = {each.name: each.value for each in movables}
    handles = []
    sets = dict.fromkeys(group for group, _ in moves.values())
    for which in sets:
        if any(which < other for other in sets):
            continue
        names: list[str] = []
        directions: list[Array] = []
        for name, (group, shift) in moves.items():
            if group != which:
                continue
            spanned = np.array([*directions, shift])
            if np.linalg.matrix_rank(spanned / np.abs(spanned).max(), tol=1e-2) > len(directions):
                names.append(name)
                directions.append(shift)
        points = np.concatenate([things[name] for name in sorted(which)])
        center = (points.min(axis=0) + points.max(axis=0)) / 2
        start = np.array([values[name] for name in names])
        handles.append(Handle(_title(which), tuple(names), np.array(directions), center, start))
    return handles


def _title(which: frozenset[str]) -> str:
    """Return what moves in words: one name, or what several begin with."""
    first, *others = sorted(which)
    if not others:
        return first
    shared = [part for part in first.split("_") if all(part in o.split("_") for o in others)]
    return "_".join(shared) or " + ".join([first, *others][:3])
