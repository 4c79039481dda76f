"""The result of a calibration, and how far to trust it."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from periscopy_sim.calibration.prior import VARIANCES, SceneCovariance, UncertainParameters
from periscopy_sim.numerics import Array, validation

LEARNED = 0.5
"""Fraction of a prior's variance: where more remains, the ruler rather than the photograph
determines a parameter; photographs that reduce all of them by less determine nothing."""


OWN = "name", "trusted"
"""Fields of a `Parameter` that its record leaves to the `Calibration`'s."""


class ParameterSource(StrEnum):
    """What a calibrated value rests on, in words for people."""

    PHOTOGRAPH = "photograph"
    PHOTOGRAPH_ALONE = "photograph if the fixed numbers are right"
    RULER = "ruler"
    NOTHING = "not trusted"


@dataclass(frozen=True)
class Parameter:
    """A parameter that was free.

    Attributes
    ----------
    name
        Name of the scene's ``<default>``.
    start, value
        The measured value, and the calibrated one.
    statistical_error, standard_error
        Of the value in a scene that is otherwise right, and in one with uncertain parameters.
    ruler_error
        Standard deviation of the measured value.
    trusted
        Whether the calibration passed its own checks.
    """

    name: str
    start: float
    value: float
    statistical_error: float
    standard_error: float
    ruler_error: float
    trusted: bool = field(default=True, kw_only=True)

    @property
    def determined(self) -> bool:
        """Whether the photograph determines the parameter better than the ruler does."""
        return self.source is ParameterSource.PHOTOGRAPH

    @property
    def distance(self) -> float:
        """Standard deviations of the measured value from it to the calibrated one."""
        return abs(self.value - self.start) / self.ruler_error

    @property
    def source(self) -> ParameterSource:
        """What the value rests on."""
        if not self.trusted:
            return ParameterSource.NOTHING
        for error, source in (
            (self.standard_error, ParameterSource.PHOTOGRAPH),
            (self.statistical_error, ParameterSource.PHOTOGRAPH_ALONE),
        ):
            if error**2 < LEARNED * self.ruler_error**2:
                return source
        return ParameterSource.RULER

    def record(self) -> dict[str, float | bool | str]:
        """Return the numbers as a JSON file has them."""
        numbers = {name: value for name, value in asdict(self).items() if name not in OWN}
        return {**numbers, "determined": self.determined, "source": self.source}


@dataclass(frozen=True)
class Rival:
    """A scene whose hidden image lies a patch aside, by values of the free parameters."""

    values: Mapping[str, float]
    probability: float  # that it is right, rather than the calibrated scene or another rival


@dataclass(frozen=True, eq=False)
class Calibration:
    """Parameters that explain a photograph.

    Attributes
    ----------
    parameters, uncertain
        The free parameters, and the fixed ones that may be wrong.
    moves
        (P, U) how far each free parameter would have ended elsewhere, had an uncertain one been a
        standard error more.
    correlation
        (P, P) of the free parameters' standard errors.
    path
        (J, P + 1) each: values and evidence of the draws, and of where the coarse, the fine and the
        last descents ended at each temperature; the fine ones include those of images aside.
        Evidences of one kind of descent alone compare.
    residual_before, residual
        (rows, columns, 3) residual of the first photograph at the start and at the end, over the
        root mean square of all photographs; 0 in pixels that the search does not use.
    noise_before, noise
        (C,) standard deviation of the residual of each channel of each photograph, likewise.
    gain
        (rows, columns) what the monitor's light was multiplied by; 1 in pixels not used.
    overdispersion
        Temperature of the search's end: the photographs count for so many times less than white
        noise allows, because else they move parameters farther than chance errs in measured values.
        1 if the measured values are kept.
    moved
        Whether the values explain the photographs better than the start's by more than chance. Else
        they are the start's, and their errors the ruler's.
    colour_matrix, colour_errors
        (3, 3) M, y_c = Σ_k M_ck A f_k, where a picture was known: from the monitor's primaries to
        the camera's channels, its rows' mean sum 1; and its standard errors.
    doubts
        Why not to believe the values, a sentence each.
    rivals
        Scenes whose hidden image lies a patch aside, and which may be right as well.
    images
        If there are rivals, the last photograph's hidden image, coarse, at the end and in each
        rival, as `Hidden.image` has it.
    scenario
        The calibrated scenario, which carries `scene_covariance`; see `Scenario.calibrate`.
    """

    parameters: tuple[Parameter, ...]
    uncertain: UncertainParameters
    moves: Array
    correlation: Array
    path: tuple[Array, ...]
    noise_before: Array
    noise: Array
    residual_before: Array
    residual: Array
    gain: Array
    overdispersion: float = 1.0
    moved: bool = True
    colour_matrix: Array | None = None
    colour_errors: Array | None = None
    doubts: tuple[str, ...] = ()
    rivals: tuple[Rival, ...] = ()
    images: tuple[Any, ...] = ()
    scenario: Any = None

    def __repr__(self) -> str:
        """Return the values with their errors, what is unexplained, and if it is trusted."""
        values = ", ".join(
            f"{each.name}={each.value:.4g}±{each.standard_error:.2g}" for each in self.parameters
        )
        before, after = validation.percentages(*self.unexplained)
        trust = "trusted" if self.trusted else "not trusted"
        return f"Calibration({values}, unexplained {before} -> {after} %, {trust})"

    @property
    def trusted(self) -> bool:
        """Whether nothing speaks against the values."""
        return not self.doubts

    @property
    def assumes_colours(self) -> bool:
        """Whether other cameras rather than the photograph determine the colour matrix."""
        matrix, errors = self.colour_matrix, self.colour_errors
        known = np.diagonal(VARIANCES, axis1=1, axis2=2)
        if matrix is None or errors is None or errors.shape != known.shape:
            return False
        errors = errors / matrix.sum(axis=1, keepdims=True)
        return bool(np.any(np.max(errors**2, axis=1) > LEARNED * np.max(known, axis=1)))

    @property
    def unexplained(self) -> tuple[float, float]:
        """Root mean square of `noise_before` and of `noise`."""
        noises = self.noise_before, self.noise
        before, after = (float(np.sqrt(np.mean(noise**2))) for noise in noises)
        return before, after

    @property
    def values(self) -> dict[str, float]:
        """The calibrated values, by name."""
        return {parameter.name: parameter.value for parameter in self.parameters}

    @property
    def scene_covariance(self) -> SceneCovariance:
        """The covariance that the calibrated scene carries."""
        held = self.uncertain
        errors = np.array([parameter.standard_error for parameter in self.parameters])
        own, shared = self.correlation * np.outer(errors, errors), self.moves * held.standard_errors
        return SceneCovariance(
            (*self.values, *held.names),
            np.array([*self.values.values(), *held.values]),
            np.block([[own, shared], [shared.T, np.diag(held.standard_errors**2)]]),
            self.trusted,
            np.array([*(parameter.start for parameter in self.parameters), *held.values]),
        )

    def record(self) -> dict[str, Any]:
        """Return the result as its JSON file has it."""
        fixed = self.uncertain

        def by_name(values: Iterable[Any]) -> dict[str, Any]:
            return dict(zip(self.values, values, strict=True))

        return {
            "trusted": self.trusted,
            "doubts": self.doubts,
            "better_than_start": self.moved,
            "parameters": {parameter.name: parameter.record() for parameter in self.parameters},
            "uncertain": {
                name: {"value": value, "standard_error": error, "moves": by_name(moves)}
                for name, value, error, moves in zip(
                    fixed.names, fixed.values, fixed.standard_errors, self.moves.T, strict=True
                )
            },
            "correlation": by_name(map(by_name, self.correlation)),
            "unexplained_before": self.noise_before,
            "unexplained": self.noise,
            "overdispersion": self.overdispersion,
            "gain": {"least": self.gain.min(), "largest": self.gain.max()},
            "colour_matrix": self.colour_matrix,
            "colour_errors": self.colour_errors,
            "rivals": [asdict(rival) for rival in self.rivals],
            "path": [{"values": rows[:, :-1], "evidence": rows[:, -1]} for rows in self.path],
        }
