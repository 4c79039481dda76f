"""What a calibration found, and how far it is to be believed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from periscopy_sim.calibration.prior import UncertainParameters
from periscopy_sim.numerics.percentages import percentages
from periscopy_sim.scenario import Array

WELL = 0.7
"""Part of the ruler's error below which the photograph, not the ruler, determines a parameter: it
then tells as much as the ruler, or more."""


@dataclass(frozen=True)
class Parameter:
    """A parameter that was free.

    Attributes
    ----------
    name
        Of the scene's ``<default>``.
    start, value
        Before and after.
    statistical_error
        Standard error of the value in a scene that is otherwise right: from the evidence's
        curvature and the spread of what stays unexplained, or the ruler's where that is less, or
        all that is known, see `trust.bounded`.
    standard_error
        The same in a scene some of whose other parameters are uncertain.
    scale
        How far it must move to change the light transport by a twentieth, to a factor of 2.
    spread
        Half width of the box that was searched, about the start or, where a search without a ruler
        went on, about where it had ended: where shadows have moved by about their own size,
        or move no further, or where no ruler errs so far.
    ruler_error
        Standard deviation of the start, as the ruler has it; infinite where none is known.
    trusted
        Whether the calibration is to be believed.
    """

    name: str
    start: float
    value: float
    statistical_error: float
    standard_error: float
    scale: float
    spread: float
    ruler_error: float = np.inf
    trusted: bool = field(default=True, kw_only=True)

    @property
    def determined(self) -> bool:
        """Whether the photograph determines it: to less than its scale, better than the ruler."""
        return self.trusted and self.standard_error < min(self.scale, WELL * self.ruler_error)

    @property
    def ruler_errors_off(self) -> float:
        """How many of the ruler's errors it ended above its start; 0 where no ruler knows it."""
        return (self.value - self.start) / self.ruler_error


@dataclass(frozen=True, eq=False)
class Visited:
    """Points at which a level was looked at, in order."""

    photograph_shape: tuple[int, int]
    hidden_shape: tuple[int, int]
    values: Array  # (K, P) of the parameters
    evidence: Array  # (K,) infinite where they were not physical


@dataclass(frozen=True, eq=False)
class Calibration:
    """Parameters that explain a photograph.

    Attributes
    ----------
    parameters
        Those that were free.
    uncertain
        Those that were held, but may be wrong.
    moves
        (P, U) how far each free parameter would have ended elsewhere, had an uncertain one been a
        standard error more.
    correlation
        (P, P) of the free parameters' standard errors.
    path
        What was visited, coarse to fine.
    noise_before, noise
        (3,) standard deviation of what the scene leaves unexplained of the photograph, over the
        photograph's root mean square, at the start and at the end.
    residual_before, residual
        (rows, columns, 3) what is left, in the same unit; zero where masked.
    gain
        (rows, columns) what the monitor's light was multiplied by, see `SmoothGain`; 1 where
        masked.
    discrepancy
        How much stronger what is left is than white noise at the scale where it is strongest; about
        1 if it is noise. See the module `discrepancy`.
    overdispersion
        By how much the photograph counts for less, that being made white, since it still varies
        more from place to place; see `Curvature.overdispersion`.
    moved
        Whether the values explain the photograph better than the start does, by more than chance;
        where they do not, and a ruler knows all of them, they are left as they were.
    doubts
        Why the values are not to be believed, a sentence each.
    """

    parameters: tuple[Parameter, ...]
    uncertain: UncertainParameters
    moves: Array
    correlation: Array
    path: tuple[Visited, ...]
    noise_before: Array
    noise: Array
    residual_before: Array
    residual: Array
    gain: Array
    discrepancy: float = 1.0
    overdispersion: float = 1.0
    moved: bool = True
    doubts: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return the values with their errors, what is unexplained, and if it is trusted."""
        found = ", ".join(
            f"{each.name}={each.value:.4g}±{each.standard_error:.2g}" for each in self.parameters
        )
        before, after = percentages(*self.unexplained)
        trust = "trusted" if self.trusted else "not trusted"
        return f"Calibration({found}, unexplained {before} -> {after} %, {trust})"

    @property
    def trusted(self) -> bool:
        """Whether nothing speaks against the values."""
        return not self.doubts

    @property
    def unexplained(self) -> tuple[float, float]:
        """What is left of the photograph, in all channels together: at the start, at the end."""
        before, after = (
            float(np.sqrt(np.mean(noise**2))) for noise in (self.noise_before, self.noise)
        )
        return before, after

    @property
    def values(self) -> dict[str, float]:
        """The calibrated values, by name."""
        return {parameter.name: parameter.value for parameter in self.parameters}
