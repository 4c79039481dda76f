"""The movable parameters of a scene, its ``<default>``s, and handles for those that move things.

No names say which parameter moves what: a small change of each shows it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from periscopy_sim.calibration.prior import declared_errors
from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import CALIBRATED, HIDDEN

SLIDER = {"errors": 10.0, "metres": 0.1, "steps": 200}
"""Reach to either side, in standard errors of the prior, farther than anyone calibrates, or, where
the scene declares none, in metres by which places move; least steps from the middle to an end."""

Moves = dict[str, tuple[frozenset[str], Array]]
"""The parts that a parameter shifts together, by names, and the shift, (3,), per unit of it."""


@dataclass(frozen=True)
class Movable:
    """A number that a scene declares, and the range and the steps in which a person moves it."""

    name: str
    value: float
    low: float
    high: float
    step: float
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Handle:
    """A thing at `center`, (3,), in metres, that some parameters shift: drag it, and they follow.

    `directions`, (K, 3), are the metres that it moves per unit of the K parameters `names`, which
    have the values `start`, (K,), at its centre.
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
    def axes(self) -> tuple[bool, ...]:
        """Whether it moves along x, y and z."""
        return tuple(np.any(self.directions != 0, axis=0).tolist())


def find_movables(scenario: Scenario) -> tuple[tuple[Movable, ...], tuple[Handle, ...]]:
    """Return the movable parameters of a scene, in the file's order, and its handles.

    Numbers that no neighbour can replace, such as whole ones, and those that change the
    photograph's size are left out. A SceneError says that nothing can be moved.
    """
    document, errors = scenario.document, declared_errors(scenario.document)
    parts = parts_of(scenario)
    movables: list[Movable] = []
    moves: Moves = {}
    for name, text in document.values.items():
        if name in document.errors or name == CALIBRATED:
            continue
        try:
            value = float(text)
            nudge = 1e-3 * (abs(value) or 1.0)
            nudged = scenario.at(**{name: f"{value + nudge:.17g}"})
        except (ValueError, SceneError):
            continue
        if nudged.photograph_shape != scenario.photograph_shape:
            continue
        speeds = {
            part: (points - parts[part]) / nudge
            for part, points in parts_of(nudged).items()
            if part in parts and points.shape == parts[part].shape
            and not np.allclose(points, parts[part], rtol=0, atol=1e-7)  # single precision
        }  # fmt: skip
        shift = _shift(speeds)
        if shift is not None:
            moves[name] = frozenset(speeds), shift
        fastest = max((np.linalg.norm(v, axis=1).max() for v in speeds.values()), default=0.0)
        unit = document.units.get(name, "")  # a number that scales a shape may be in metres or not
        limits = _limits(value, errors.get(name, 0.0), float(fastest), is_place=shift is not None)
        movables.append(Movable(name, value, *limits, unit))
    if not movables:
        raise SceneError(
            f"scene '{scenario.path}' declares nothing that can be moved; declare a number, such "
            'as <default name="occluder_dx" value="0"/>, and use it as $occluder_dx'
        )
    values = {each.name: each.value for each in movables}
    return tuple(movables), tuple(_handles(values, moves, parts))


def parts_of(scenario: Scenario) -> dict[str, Array]:
    """Return points, (n, 3), of the parts of a scene, by name."""
    occluders = scenario.view.occluders
    shapes = {o.name: o.bounds if o.vertices is None else o.vertices for o in occluders}
    surfaces = {name: surface.centers for name, surface in scenario.hidden.items()}
    parts = {"camera": scenario.view.centers, **surfaces, **shapes}
    return {name: points for name, points in parts.items() if points is not None}


def _shift(speeds: Mapping[str, Array]) -> Array | None:
    """Return the common velocity, (3,), of all parts that move; None where there is none."""
    if not speeds:
        return None
    every = np.concatenate(list(speeds.values()))
    shift = every.mean(axis=0)
    rounding = 1e-3 * float(np.linalg.norm(shift))
    if np.abs(every - shift).max() > rounding:
        return None
    return np.where(np.abs(shift) < rounding, 0, shift)  # rounding would turn the handle


def _limits(
    value: float, error: float, fastest: float, *, is_place: bool
) -> tuple[float, float, float]:
    """Return the ends of a range of whole decimal steps, which keeps a size positive, and the step.

    The range follows from the prior's error, or from how fast things move, in metres per unit.
    """
    if np.isfinite(error) and error > 0:
        reach = SLIDER["errors"] * error
    elif value and not is_place:
        reach = abs(value) / 2
    else:
        reach = SLIDER["metres"] / fastest if fastest else 1.0
    step = float(10.0 ** np.floor(np.log10(reach / SLIDER["steps"] * 1.001)))
    low = value - reach if is_place or value <= 0 else max(value - reach, value / 10)
    low, high = (
        float(f"{value + step * round((end - value) / step):.12g}") for end in (low, value + reach)
    )
    return low, high, step


def _handles(values: Mapping[str, float], moves: Moves, parts: Mapping[str, Array]) -> list[Handle]:
    """Return a handle for each set of parts that some parameters shift together.

    A subset of another set has none: it would stand in the other's way.
    """
    sets = dict.fromkeys(group for group, _ in moves.values())
    handles = []
    for group in sets:
        if any(group < other for other in sets):
            continue
        shifts = {name: shift for name, (moved, shift) in moves.items() if moved == group}
        points = np.concatenate([parts[name] for name in sorted(group)])
        center = (points.min(axis=0) + points.max(axis=0)) / 2
        start = np.array([values[name] for name in shifts])
        heads = (name.removeprefix(f"{HIDDEN}_").split("_")[0] for name in sorted(group))
        title = " + ".join(dict.fromkeys(heads))
        handles.append(Handle(title, tuple(shifts), np.array(list(shifts.values())), center, start))
    return handles
