"""How well photographs determine a scene's parameters, others of which are uncertain."""

from dataclasses import dataclass

import numpy as np

from periscopy_sim.calibration.level import Look
from periscopy_sim.calibration.problem import CalibrationProblem
from periscopy_sim.numerics import Array

MARGIN = 1.3
"""Of standard errors over those of the linear theory: valleys of the evidence are curved."""


@dataclass(frozen=True, eq=False)
class StandardErrors:
    """Standard errors of P parameters, none above that of its measured value."""

    statistical: Array  # (P,) in a scene that is otherwise right
    total: Array  # (P,) with U uncertain parameters
    correlation: Array  # (P, P) of the total errors
    moves: Array  # (P, U), see `Calibration`


def standard_errors(problem: CalibrationProblem, joint: Look) -> StandardErrors:
    """Return standard errors from a look at the parameters, the uncertain ones and the gain.

    The covariance is that of the linear theory, (I_θθ + Λ)⁻¹, tempered. Were an uncertain parameter
    p wrong by δ, the photographs would be explained best elsewhere, by −(I_θθ + Λ)⁻¹ I_θp δ.
    """
    count, limit = len(problem.names), problem.errors
    held = np.zeros(len(joint.point), bool)
    held[count : count + len(problem.uncertain.names)] = True
    inverse = np.linalg.inv(joint.curvature()[np.ix_(~held, ~held)])
    shared = joint.information[np.ix_(~held, held)] / joint.temperature
    moves = (-inverse @ shared * problem.uncertain.standard_errors)[:count]
    moves = np.clip(moves, -limit[:, None], limit[:, None])
    alone = MARGIN**2 * inverse[:count, :count]
    covariance = alone + moves @ moves.T
    deviations = np.sqrt(np.diag(covariance))
    return StandardErrors(
        statistical=np.minimum(np.sqrt(np.diag(alone)), limit),
        total=np.minimum(deviations, limit),
        correlation=covariance / np.outer(deviations, deviations),
        moves=moves,
    )
