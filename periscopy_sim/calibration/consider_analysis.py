"""How values that a calibration finds depend on uncertain parameters, which it leaves as they are.

Were such a parameter p wrong by δ, the photograph would be explained best elsewhere, by

    δθ = −(I_θθ)⁻¹ I_θp δ,

I the Fisher information on the free parameters θ and on p ("consider" analysis: Bierman,
Factorization Methods for Discrete Sequential Estimation, 1977, chapter 8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values
from periscopy_sim.calibration.prior import start_values
from periscopy_sim.calibration.search.fisher_information import (
    differences,
    differentiate,
    information,
)
from periscopy_sim.calibration.search.levenberg_marquardt import Descent
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Array


@dataclass(frozen=True, eq=False)
class UncertainParameters:
    """``<default>``s of a scene that are held at values, (U,), known to standard errors, (U,)."""

    names: tuple[str, ...]
    values: Values
    standard_errors: Values


def uncertain_parameters(
    path: Path, free: tuple[str, ...], given: Mapping[str, str], errors: Mapping[str, float]
) -> UncertainParameters:
    """Return uncertain parameters by their standard errors; the others are `free` or `given`.

    A SceneError says that one is not declared, no finite number, free, or its error not positive.
    """
    names = tuple(errors)
    for name in names:
        if name in free:
            raise SceneError(f"'{name}' is both free and uncertain: name it once")
        if not (np.isfinite(errors[name]) and errors[name] > 0):
            raise SceneError(f"standard error {errors[name]:g} of '{name}': give a positive number")
    values = start_values(path, names, given) if names else np.empty(0)
    return UncertainParameters(
        names, values, np.array([errors[name] for name in names], np.float64)
    )


def require_effect(level: ResolutionLevel, values: Values, uncertain: UncertainParameters) -> None:
    """Check that errors of uncertain parameters, to either side, change what is seen.

    A SceneError says that one changes nothing, or that the scene is not physical then.
    """
    joint = level.varying((*level.names, *uncertain.names))
    for name, error, offset in zip(
        uncertain.names, uncertain.standard_errors, np.diag(uncertain.standard_errors), strict=True
    ):
        try:
            sides = [
                joint.matrix(np.concatenate([values, uncertain.values + sign * offset]))
                for sign in (1, -1)
            ]
        except SceneError as unphysical:
            raise SceneError(
                f"uncertain {name}={error:g}: give a smaller error ({unphysical})"
            ) from None
        if np.array_equal(sides[0], sides[1]):
            raise SceneError(
                f"uncertain {name}={error:g}: the photograph does not show such an error; leave "
                "it out"
            )


def sensitivity(level: ResolutionLevel, end: Descent, uncertain: UncertainParameters) -> Array:
    """Return δθ of the module, (P, U), δ being a standard error of each uncertain parameter."""
    errors = uncertain.standard_errors
    if not len(errors):
        return np.zeros((len(end.values), 0))
    changes = differences(
        level.varying((*level.names, *uncertain.names)),
        np.concatenate([end.values, uncertain.values]),
        np.hstack([np.zeros((len(errors), len(end.values))), np.diag(errors)]),
    )
    jacobian = differentiate(end.explanation, changes)
    shared = information(end.curvature.jacobian, jacobian)
    return np.asarray(-np.linalg.solve(end.curvature.invertible(), shared) * errors)
