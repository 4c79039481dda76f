"""Find the parameters of a scene that explain a photograph best, coarse to fine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.consider_analysis import (
    UncertainParameters,
    require_effect,
    sensitivity,
    uncertain_parameters,
)
from periscopy_sim.calibration.constraints import InFront
from periscopy_sim.calibration.fisher_information import block_scores
from periscopy_sim.calibration.global_search import explore, points_visited
from periscopy_sim.calibration.levenberg_marquardt import descend, settle
from periscopy_sim.calibration.parameters import start_values, steps_and_spreads
from periscopy_sim.calibration.resolution_level import Resolution, ResolutionLevel, Values, Visit
from periscopy_sim.errors import PhotographError, SceneError, VariantError
from periscopy_sim.photographs.checking import check_photograph
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.variant import install_llvm, is_vectorized
from periscopy_sim.scenario import Array
from periscopy_sim.shipped import find_scene

LEVELS = (Resolution(32, 12, 4, 9), Resolution(63, 36, 16, 4), Resolution(126, 36, 16, 1))
"""Coarse to fine: explored, then descended on. Larger photographs and hidden images are averaged
down to the last. With a quarter of its rays the second has dips that hold a descent, millimetres
from the best."""

ITERATIONS = (12, 6)
"""Of the descents, at most; the last of them gain little and take long."""

SHOWN = 100.0
"""Gain in evidence over a black monitor below which a photograph shows nothing of the scene."""


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
        curvature and the spread of what stays unexplained.
    standard_error
        The same in a scene some of whose other parameters are uncertain.
    scale
        How far it must move to change the light transport by a twentieth, to a factor of 2.
    spread
        Half width of the box that was searched: where shadows have moved by about their own size,
        or move no further.
    """

    name: str
    start: float
    value: float
    statistical_error: float
    standard_error: float
    scale: float
    spread: float

    @property
    def determined(self) -> bool:
        """Whether the photograph determines it: to less than its scale."""
        return self.standard_error < self.scale


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

    @property
    def values(self) -> dict[str, float]:
        """The calibrated values, by name."""
        return {parameter.name: parameter.value for parameter in self.parameters}


def calibrate(
    photograph: NDArray[np.floating[Any]],
    scene: str | Path,
    hidden: tuple[int, int],
    free: Sequence[str],
    *,
    parameters: Mapping[str, str | float] | None = None,
    uncertain: Mapping[str, float] | None = None,
    mask: NDArray[np.bool_] | None = None,
    samples: int = 16,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Find the values of a scene's parameters that explain a photograph best.

    Nothing is known of the hidden image but that it is smooth rather than not, nothing of the
    ambient light but that it comes from afar; see `evidence`. The search goes from
    coarse to fine: many points about the start at a low resolution, then descents.

    Parameters
    ----------
    photograph
        (rows, columns, 3), linear, of any unit.
    scene
        A Mitsuba XML file, or the name of a shipped scene.
    hidden
        (R, C) of the hidden image; of finer ones than 36 patches along a side a coarser one serves.
    free
        Names of the ``<default>``s to find.
    parameters
        Values of ``<default>``s: where free ones start, where others are held.
    uncertain
        Standard errors of ``<default>``s that are held, independent of each other. They change no
        value, but its error: see `consider_analysis`.
    mask
        (rows, columns) pixels to use; None for all.
    samples
        Rays from a pixel to a patch, at the finest level.
    seed
        Of the draws and the rays.
    progress
        Called with the fraction done, 1 at last; what ends early leaps.

    Returns
    -------
    Calibration
        See there.

    Raises
    ------
    SceneError
        If a parameter is unknown or unseen, the start or where the search leads is not physical.
    PhotographError
        If the photograph is not of the camera's size, or holds nothing.
    VariantError
        In scalar variants, which would take days.
    """
    path = find_scene(scene)
    given = {name: str(value) for name, value in (parameters or {}).items()}
    start = start_values(path, free, given)
    held = uncertain_parameters(path, tuple(free), given, uncertain or {})
    first = load_scenario(path, hidden, given)
    if not is_vectorized():
        raise VariantError("calibration renders thousands of photographs; " + install_llvm())
    y = check_photograph(photograph, first.photograph_shape, "photograph", mask)
    in_front = InFront(first)
    resolutions = (*LEVELS[:-1], replace(LEVELS[-1], samples=samples))
    coarse, middle, fine = (
        ResolutionLevel(path, given, tuple(free), y, mask, hidden, resolution, seed, in_front.check)
        for resolution in resolutions
    )
    log = _Log(len(start), progress)
    coarse.background(start)  # too few pixels are told of before anything is rendered
    require_effect(coarse, start, held)
    steps, spreads = steps_and_spreads(coarse, start)
    values = explore(coarse, start, spreads, seed, log.at(coarse))
    seen = coarse.explain(values)
    if seen.darkness - seen.evidence < SHOWN:
        raise PhotographError(
            "the photograph shows no shadows of this scene, wherever its parameters are; nothing "
            "can be learned from it"
        )
    end = descend(middle, values, steps, 5 * steps, ITERATIONS[0], log.at(middle))
    values, _ = settle(middle, end, steps)
    visit = log.at(fine)
    end = descend(fine, values, steps / 2, 5 * steps, ITERATIONS[1], visit)
    if end.unphysical is not None:
        best = ", ".join(f"{name} = {v:.4g}" for name, v in zip(free, end.values, strict=True))
        raise SceneError(
            f"the search left the physical, past {best}: {end.unphysical}; free less, or fix "
            "the one that went too far by -D"
        )
    moves = sensitivity(fine, end, held)
    values, after = settle(fine, end, steps)
    visit(values, after.evidence)
    before = fine.explain(start)
    scores = block_scores(fine, end.explanation, end.curvature.jacobian)
    log.report(1.0)
    alone = end.curvature.covariance(scores)
    errors = alone + moves @ moves.T
    deviations = np.sqrt(np.diag(errors))
    columns = start, values, np.sqrt(np.diag(alone)), deviations, steps, spreads
    return Calibration(
        parameters=tuple(
            Parameter(name, *(float(number) for number in numbers))
            for name, *numbers in zip(free, *columns, strict=True)
        ),
        uncertain=held,
        moves=moves,
        correlation=errors / np.outer(deviations, deviations),
        path=log.path(),
        noise_before=before.noise / fine.scale,
        noise=after.noise / fine.scale,
        residual_before=fine.picture(before.residuals),
        residual=fine.picture(after.residuals),
    )


class _Log:
    """Keep what is visited, and report how much is done."""

    def __init__(self, parameters: int, progress: Callable[[float], None] | None) -> None:
        # In units of one point of the first level; a descent's visits each stand for an iteration,
        # and what follows the descents for one more.
        iteration = 4 * parameters + 2
        self._costs = (1.0, 12.0 * iteration, 25.0 * iteration)
        points = (points_visited(parameters), *(count + 2 for count in ITERATIONS))
        self._starts = [0.0, *np.cumsum(np.multiply(self._costs, points)).tolist()]
        self._done = 0.0
        self.report = progress or (lambda _: None)
        self._visited: list[tuple[ResolutionLevel, list[tuple[Values, float]]]] = []

    def at(self, level: ResolutionLevel) -> Visit:
        points: list[tuple[Values, float]] = []
        cost = self._costs[len(self._visited)]
        self._done = self._starts[len(self._visited)]  # a descent may have ended early
        self._visited.append((level, points))

        def visit(values: Values, evidence: float) -> None:
            points.append((values, evidence))
            self._done += cost
            self.report(min(self._done / self._starts[-1], 1.0))

        return visit

    def path(self) -> tuple[Visited, ...]:
        return tuple(
            Visited(
                level.photograph_shape,
                level.hidden_shape,
                np.array([values for values, _ in points]),
                np.array([evidence for _, evidence in points]),
            )
            for level, points in self._visited
        )
