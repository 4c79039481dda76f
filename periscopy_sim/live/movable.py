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

Arrays = Mapping[str, Array]
Numbers = Mapping[str, float]


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


def find_movables(scenario: Scenario) -> tuple[tuple[Movable, ...], tuple[Handle, ...]]:
    """Return the movable parameters of a scene, in the file's order, and its handles.

    Numbers that no neighbour can replace, such as whole ones, and those that change the
    photograph's size are left out. A SceneError says that nothing can be moved.
    """
    document, parts = scenario.document, parts_of(scenario)
    errors, movables = declared_errors(document), list[Movable]()
    moves = dict[frozenset[str], dict[str, Array]]()  # by parts: what shifts them, metres per unit
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
        every = np.concatenate([*speeds.values(), np.zeros((0 if speeds else 1, 3))])
        shift, fastest = every.mean(axis=0), float(np.linalg.norm(every, axis=1).max())
        rounding = 1e-3 * np.linalg.norm(shift)
        if is_place := bool(speeds) and np.abs(every - shift).max() <= rounding:
            shift[np.abs(shift) < rounding] = 0  # rounding would turn the handle
            moves.setdefault(frozenset(speeds), {})[name] = shift
        limits = _limits(value, errors.get(name, 0.0), fastest, is_place=bool(is_place))
        # The unit of a number that scales a shape may be metres or not.
        movables.append(Movable(name, value, *limits, document.units.get(name, "")))
    if not movables:
        raise SceneError(
            f"scene '{scenario.path}' declares nothing that can be moved; declare a number, such "
            'as <default name="occluder_dx" value="0"/>, and use it as $occluder_dx'
        )
    values = {each.name: each.value for each in movables}
    # A subset of another set of parts has no handle: it would stand in the other's way.
    sets = [group for group in moves if not any(group < other for other in moves)]
    return tuple(movables), tuple(_handle(group, moves[group], values, parts) for group in sets)


def parts_of(scenario: Scenario) -> dict[str, Array]:
    """Return points, (n, 3), of the parts of a scene, by name."""
    occluders = scenario.view.occluders
    shapes = {o.name: o.bounds if o.vertices is None else o.vertices for o in occluders}
    surfaces = {name: surface.centers for name, surface in scenario.hidden.items()}
    parts = {"camera": scenario.view.centers, **surfaces, **shapes}
    return {name: points for name, points in parts.items() if points is not None}


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


def _handle(group: frozenset[str], shifts: Arrays, values: Numbers, parts: Arrays) -> Handle:
    """Return the handle of a set of parts that some parameters shift together."""
    points = np.concatenate([parts[name] for name in sorted(group)])
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    start = np.array([values[name] for name in shifts])
    heads = (name.removeprefix(f"{HIDDEN}_").split("_")[0] for name in sorted(group))
    title = " + ".join(dict.fromkeys(heads))
    return Handle(title, tuple(shifts), np.array(list(shifts.values())), center, start)
