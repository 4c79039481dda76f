"""When not to believe a calibration, however small its errors."""

from collections.abc import Sequence

import numpy as np

from periscopy_sim.calibration.level import Look
from periscopy_sim.calibration.result import LEARNED
from periscopy_sim.numerics import Array

FARTHEST = 3.0
"""Standard deviations within which a ruler errs: all but 3 of 1000 times."""

MISFIT = 0.4
"""Largest `misfits` of a photograph that is believed: simulated photographs beside near lamps left
more, and their images were worse by 10 dB."""


def learned(look: Look, count: int) -> float:
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
    from scipy.stats import chi2

    return bool(gain > chi2.isf(chance, max(parameters, 1.0)))


def misfits(look: Look, noise: Array) -> Array:
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
    """Return why not to believe parameters; empty where nothing says so.

    Parameters
    ----------
    names, distances
        (P) parameters, and how many of the prior's standard deviations each ended from its start.
    known
        How many of them the photographs determine.
    misfit
        (K,) of `misfits`.
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
                "unexplained: another laboratory, another picture than the shown one, a near lamp, "
                "a poster on the wall, or something that the scene lacks"
            )
    return tuple(reasons)
