"""The parameters of a scene that are free, and how far the photograph feels each of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from periscopy_sim.calibration.resolution_level import ResolutionLevel, Values
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.scenario import Array

STEP, SPREAD = 0.05, 0.4
"""Relative changes of the transport matrix: by the step of a difference, and over the half width of
the box that is searched, where shadows have moved by about their own size."""

DOUBLINGS = 40
"""From a millionth of a unit: beyond, a parameter is not seen."""

GROWTH = 1.2
"""Of the change, by doubling, below which it grows no more: a turn comes round again."""


def start_values(path: Path, free: Sequence[str], given: Mapping[str, str]) -> Values:
    """Return where parameters of a scene file start, (P,): as given, or at their defaults.

    A SceneError says that none is free, one is not declared, named twice, or no finite number.
    """
    declared = read_document(path).defaults
    numbers = {name: value for name, value in declared.items() if _number(value) is not None}
    known = ", ".join(f"{name} ({value})" for name, value in numbers.items()) or "none"
    if not free:
        raise SceneError(f"no parameter is free; scene '{path}' declares {known}")
    for name in free:
        if name not in numbers:
            what = "is no number" if name in declared else "is not declared"
            raise SceneError(f"parameter '{name}' {what} in scene '{path}'; it declares {known}")
        if free.count(name) > 1:
            raise SceneError(f"parameter '{name}' is free twice")
        if _number(given.get(name, "0")) is None:
            raise SceneError(f"-D {name}={given[name]}: give a finite number to start from")
    return np.array([float(given.get(name, numbers[name])) for name in free])


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def steps_and_spreads(level: ResolutionLevel, start: Values) -> tuple[Values, Values]:
    """Return how far each parameter must move from its start to change A by `STEP` and by `SPREAD`.

    All are (P,). A SceneError is raised if the start is not physical, or a parameter changes
    nothing that the photograph shows.
    """
    A = level.matrix(start)
    steps, spreads = np.empty(len(start)), np.empty(len(start))
    for k, name in enumerate(level.names):
        offset = np.zeros(len(start))
        reached, spread = 0.0, np.nan
        step = np.nan
        for doubling in range(DOUBLINGS):
            offset[k] = 1e-6 * 2.0**doubling
            change = _change(level, A, start, offset)
            if change is None or (reached >= STEP and change < GROWTH * reached):
                break
            reached, spread = change, offset[k]
            if np.isnan(step) and change >= STEP:
                step = offset[k]
            if change >= SPREAD:
                break
        if np.isnan(spread):
            raise SceneError(
                f"scene '{level.path}': '{name}' cannot be moved from {start[k]:g}; leave it out "
                "of --free, or start it elsewhere by -D"
            )
        if reached == 0:
            raise SceneError(
                f"scene '{level.path}': the photograph cannot see '{name}', however it is moved "
                f"from {start[k]:g}; start it elsewhere by -D, or leave it out of --free"
            )
        if np.isnan(step):
            raise SceneError(
                f"scene '{level.path}': the photograph cannot see '{name}': moved by up to "
                f"{spread:.3g}, it changes the light transport by {100 * reached:.2g} %; leave it "
                "out of --free"
            )
        steps[k], spreads[k] = step, spread
    return steps, spreads


def _change(level: ResolutionLevel, A: Array, start: Values, offset: Values) -> float | None:
    """Return the relative change of A, to either side; None where neither is physical."""
    for sign in (1, -1):
        try:
            return float(np.linalg.norm(level.matrix(start + sign * offset) - A)) / float(
                np.linalg.norm(A)
            )
        except SceneError:
            continue
    return None
