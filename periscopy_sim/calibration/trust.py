"""How well photographs determine a scene's parameters, and when not to believe it."""

from collections.abc import Sequence

import numpy as np
from scipy import linalg, special

from periscopy_sim.calibration.evidence import SmoothExplanation
from periscopy_sim.calibration.prior import FARTHEST
from periscopy_sim.calibration.problem import CalibrationProblem
from periscopy_sim.calibration.resolution_level import Candidate, Look
from periscopy_sim.calibration.result import LEARNED
from periscopy_sim.numerics import Array

MARGIN = 1.3
"""Ratio of standard errors to those of the linear theory: the evidence's valleys are curved."""

MISFIT = 0.4
"""Largest `misfits` of a photograph that is believed: simulated photographs beside near lamps left
more, and their images were worse by 10 dB."""


def standard_errors(
    problem: CalibrationProblem, joint: Look, spread: Array | float = 0.0
) -> tuple[Array, Array, Array, Array]:
    """Return standard errors from a look at P parameters, U uncertain ones and the gain.

    They are those in a scene that is otherwise right, (P,), and with the uncertain parameters,
    (P,), none above that of the measured value; the correlation of the latter, (P, P); and the
    `moves` of `Calibration`, (P, U).

    The covariance is that of the linear theory, (I_θθ + Λ)⁻¹, tempered, and the `spread`, (P, P),
    of scenes that it does not reach. Were an uncertain parameter p wrong by δ, the photographs
    would be explained best elsewhere, by −(I_θθ + Λ)⁻¹ I_θp δ.
    """
    count, limit = len(problem.names), problem.errors
    whole, every = _deviations(problem, joint)
    moves = np.clip(every[:count], -limit[:, None], limit[:, None])
    alone = whole[:count, :count] + spread
    covariance = alone + moves @ moves.T
    deviations = np.sqrt(np.diag(covariance))
    statistical = np.minimum(np.sqrt(np.diag(alone)), limit)
    correlation = covariance / np.outer(deviations, deviations)
    return statistical, np.minimum(deviations, limit), correlation, moves


def _deviations(problem: CalibrationProblem, joint: Look) -> tuple[Array, Array]:
    """Return the covariance of all of a look's numbers, and `moves` of all, (., U).

    The fixed numbers are absent from the covariance, and move by a standard error.
    """
    count, errors = len(problem.names), problem.uncertain.standard_errors
    held = np.zeros(len(joint.point), bool)
    held[count : count + len(errors)] = True
    inverse = np.linalg.inv(joint.curvature()[np.ix_(~held, ~held)])
    shared = joint.information[np.ix_(~held, held)] / joint.temperature
    covariance, moves = np.zeros((len(held), len(held))), np.zeros((len(held), len(errors)))
    covariance[np.ix_(~held, ~held)] = MARGIN**2 * inverse
    moves[~held], moves[held] = -inverse @ shared * errors, np.diag(errors)
    return covariance, moves


def colour_matrix(problem: CalibrationProblem, end: Candidate, joint: Look) -> tuple[Array, Array]:
    """Return how the camera mixes the first picture's P primaries, (C, P), and its standard errors.

    The errors are those in a known scene and those that the scene's make: of colours x_c,
    σ_c² (X⊥ᵀX⊥ + α_c K)⁻¹, tempered, and as much as x_c follows motions of the light.
    """
    count = problem.photographs[0].channels
    known, ours = (
        [each for each in look.explanations if isinstance(each, SmoothExplanation)][:count]
        for look in (end, joint)
    )
    rows = np.array([each.coefficients[:, 0] for each in known])
    whole, moves = _deviations(problem, joint)
    pairs = zip(ours, joint.motions, strict=False)
    followed = np.concatenate([each.noise * each.followed(motion)[0] for each, motion in pairs])
    own = linalg.block_diag(*(joint.temperature * MARGIN**2 * each.covariance for each in ours))
    covariance = own + followed @ (whole + moves @ moves.T) @ followed.T
    size = rows.sum() / count  # of which the matrix is a multiple
    change = (np.eye(rows.size) - rows.reshape(-1, 1) / (count * size)) / size
    variances = np.einsum("ij,jk,ik->i", change, covariance, change)
    return rows / size, np.sqrt(variances).reshape(rows.shape)


def determined_count(look: Look, count: int) -> float:
    """Return how many of the first parameters the photographs determine, from 0 to `count`.

    The trace of I (I + Λ)⁻¹, of the information and the prior's precision, the look's other numbers
    unknown.
    """
    covariance = np.linalg.inv(look.curvature())[:count, :count]
    return float(count - np.sum(look.precision[:count] * np.diag(covariance)))


def is_significant(gain: float, parameters: float, chance: float = 0.01) -> bool:
    """Return whether a gain in the objective over the start is more than chance makes it.

    Where the start is right the gain of so many parameters has the χ² distribution (Wilks), and
    exceeds this threshold with a probability of `chance`.
    """
    return bool(gain > special.chdtri(max(parameters, 1.0), chance))


def misfits(look: Candidate, noise: Array) -> Array:
    """Return how much of each photograph no scene explains, (K,): the residual over the light.

    Both exclude the light of far lamps and the camera's white noise, of standard deviation
    `noise`, (K, C) in C channels.
    """
    residuals = np.concatenate([np.sum(each.residual**2, axis=0) for each in look.explanations])
    energies = np.concatenate([each.energy for each in look.explanations])
    background = look.explanations[0].background
    grain = (len(background) - background.shape[1]) * noise**2
    rest, whole = (
        (each.reshape(noise.shape) - grain).sum(axis=1) for each in (residuals, energies)
    )
    return np.asarray(np.sqrt(np.maximum(rest, 0) / np.maximum(whole, np.abs(rest) + 1e-300)))


def doubts(names: Sequence[str], distances: Array, known: float, misfit: Array) -> tuple[str, ...]:
    """Return the reasons not to trust P parameters; empty if there is no reason.

    Each ended `distances`, (P,), of the prior's standard deviations from its start. The photographs
    determine `known` of them, and no scene explains `misfit`, (K,), of these.
    """
    reasons = [
        f"{name} ended {abs(distance):.1f} standard errors from its measured value: the ruler, its "
        "error or the scene is wrong"
        for name, distance in zip(names, distances, strict=True)
        if abs(distance) > FARTHEST
    ]
    if known < LEARNED:
        reasons.append("the photograph determines the parameters less well than the measurements")
    for k, fraction in enumerate(misfit, 1):
        which = f"photograph {k}" if len(misfit) > 1 else "the photograph"
        if fraction > MISFIT:
            reasons.append(
                f"{which}: {100 * fraction:.0f} % of the light that no far lamp explains stays "
                "unexplained: the scene lacks something that the photograph shows"
            )
    return tuple(reasons)
