"""How values that a calibration finds depend on numbers of the scene that it leaves as they are.

Were a number p of those wrong by δ, the photograph would be explained best elsewhere, by

    δθ = −(I_θθ)⁻¹ I_θp δ,

I the Fisher information on the free parameters θ and on p ("consider" analysis: Bierman,
Factorization Methods for Discrete Sequential Estimation, 1977, chapter 8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from periscopy_sim.calibration.evidence import Explanation
from periscopy_sim.calibration.levenberg_marquardt import Curvature, curvature
from periscopy_sim.calibration.parameters import start_values
from periscopy_sim.calibration.resolution_level import Level, Values
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Array


@dataclass(frozen=True, eq=False)
class Uncertain:
    """Numbers of a scene that stay, and how well they are known.

    Attributes
    ----------
    names
        Of the scene's ``<default>``s.
    values
        (U,) at which they stay.
    standard_errors
        (U,) of those.
    """

    names: tuple[str, ...]
    values: Values
    standard_errors: Values


def uncertain_numbers(
    path: Path, free: tuple[str, ...], given: Mapping[str, str], errors: Mapping[str, float]
) -> Uncertain:
    """Look up numbers that stay.

    Parameters
    ----------
    path
        The scene file.
    free
        Names of the parameters that do not stay.
    given
        Values of some ``<default>``s.
    errors
        Standard errors, by name.

    Raises
    ------
    SceneError
        If one is not declared, no finite number, free, or its error not positive.
    """
    names = tuple(errors)
    for name in names:
        if name in free:
            raise SceneError(
                f"'{name}' is both free and uncertain: name it in --free or --uncertain"
            )
        if not (np.isfinite(errors[name]) and errors[name] > 0):
            raise SceneError(f"standard error {errors[name]:g} of '{name}': give a positive number")
    values = start_values(path, names, given) if names else np.empty(0)
    return Uncertain(names, values, np.array([errors[name] for name in names], np.float64))


def require_effect(level: Level, values: Values, uncertain: Uncertain) -> None:
    """Look whether errors of uncertain numbers, to either side, change what is seen.

    Raises
    ------
    SceneError
        If one changes nothing, or the scene is not physical then.
    """
    joint = level.varying((*level.names, *uncertain.names))
    for k, (name, error) in enumerate(zip(uncertain.names, uncertain.standard_errors, strict=True)):
        offset = np.zeros(len(uncertain.names))
        offset[k] = error
        try:
            sides = [
                joint.matrix(np.concatenate([values, uncertain.values + sign * offset]))
                for sign in (1, -1)
            ]
        except SceneError as unphysical:
            raise SceneError(
                f"--uncertain {name}={error:g}: give a smaller error ({unphysical})"
            ) from None
        if np.array_equal(sides[0], sides[1]):
            raise SceneError(
                f"--uncertain {name}={error:g}: the photograph does not show such an error; leave "
                "it out"
            )


def sensitivity(
    level: Level, values: Values, explanation: Explanation, steps: Values, uncertain: Uncertain
) -> tuple[Curvature, Array]:
    """Tell what the photograph knows of the free parameters, and what they owe to the others.

    Parameters
    ----------
    level
        Where to look, of the free parameters.
    values
        (P,) where they ended.
    explanation
        There.
    steps
        (P,) differences by which slopes are taken; of an uncertain number it is its error.
    uncertain
        The numbers that stay.

    Returns
    -------
    curvature
        Of the free parameters.
    moves
        (P, U) how far each would have ended elsewhere, had a number been one standard error more.
    """
    count = len(values)
    about = curvature(
        level.varying((*level.names, *uncertain.names)),
        np.concatenate([values, uncertain.values]),
        explanation,
        np.concatenate([steps, uncertain.standard_errors]),
    )
    own = about.first(count)
    moves = -np.linalg.solve(own.invertible(), about.information[:count, count:])
    return own, np.asarray(moves * uncertain.standard_errors)
