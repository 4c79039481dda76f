"""Find the parameters of a scene that explain photographs best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.averaged import LARGEST, Averaged, fitted
from periscopy_sim.calibration.evidence import Images
from periscopy_sim.calibration.level import Group, Level, Look
from periscopy_sim.calibration.moving_scene import MovingScene
from periscopy_sim.calibration.prior import (
    Free,
    UncertainParameters,
    free_parameters,
    uncertain_parameters,
)
from periscopy_sim.calibration.result import Calibration, Parameter, Visited
from periscopy_sim.calibration.scene_covariance import ruled_values
from periscopy_sim.calibration.search import COOLING, DRAWS, STEPS, Search
from periscopy_sim.calibration.trust import doubts, is_significant, learned
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.model.ambient import background_basis, joined_basis
from periscopy_sim.model.observation import Backgrounds, named
from periscopy_sim.photograph import Photograph
from periscopy_sim.rendering.checks import LEAST, hidden_fraction, shadow_doubt
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.shipped import find_scene
from periscopy_sim.storage.pictures import area_average

MOST_PATCHES = 36
"""Along a side of the hidden image: of more, a coarser image serves."""

COARSE_PIXELS, COARSE_HATS = 1000, 24
"""Pixels of the coarse level, about, and hat functions along the longer side of its images."""

PIXELS_A_PATCH = 1.7
"""Of the fine level, at least."""

MARGIN = 1.3
"""Of standard errors over those of the linear theory: valleys of the evidence are curved."""


def calibrate(
    photograph: NDArray[np.floating[Any]] | Sequence[NDArray[np.floating[Any]]],
    scene: str | Path,
    hidden: tuple[int, int],
    free: Free | None = None,
    *,
    shown: Sequence[NDArray[np.floating[Any]]] = (),
    parameters: Mapping[str, str | float] | None = None,
    uncertain: Mapping[str, float] | None = None,
    backgrounds: Backgrounds | None = None,
    mask: NDArray[np.bool_] | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Find the values of a scene's parameters that explain photographs best.

    The ambient light comes from afar, a gain over the wall is smooth (`Level`), and the parameters
    have a normal prior about the measured values. A hidden image that is not known is smooth
    (`evidence`).

    Parameters
    ----------
    photograph
        (rows, columns, 3), linear, of any unit; or several such photographs of one laboratory.
    scene
        A Mitsuba XML file, or the name of a shipped scene.
    hidden
        (R, C) of the hidden image; the search uses at most 36 patches along a side.
    free
        Names of the ``<default>``s to find, or a mapping of them to the standard deviations of
        their measured values, None for the one that the scene declares. By default, all whose error
        the scene declares as the ``<default>`` ``NAME_error``, but for those in `uncertain`.
    shown
        (R, C, 3) pictures that the monitor showed, linear, one for each of the first photographs.
        With a picture known the scene is found in place, and with it a `colour_matrix`.
    parameters
        Values of ``<default>``s: where free ones start, where others are held.
    uncertain
        Standard errors of ``<default>``s that are held, independent of each other. They change no
        value, only its error ("consider" analysis: Bierman, Factorization Methods for Discrete
        Sequential Estimation, 1977, chapter 8).
    backgrounds
        Photographs of the wall with the monitor off, of the photograph's size, or a mapping of
        their names to them: their light is projected out.
    mask
        (rows, columns) pixels to use; None for all.
    seed
        Of the draws.
    progress
        Called with the fraction done, 1 at last.

    Returns
    -------
    Calibration
        See there; look at `Calibration.trusted` first.

    Raises
    ------
    SceneError
        If a parameter is unknown or its error is, no shadow is in view where the search starts, the
        scene has no closed form (`analytic_transport`), or the start makes no scene.
    PhotographError
        If photographs are not of the camera's size, show nothing, or a shown picture is black.
    """
    from threadpoolctl import threadpool_limits

    path = find_scene(scene)
    given = {name: str(value) for name, value in (parameters or {}).items()}
    uncertain = dict(uncertain or {})
    errors = free_parameters(path, free, given, uncertain)
    names = tuple(errors)
    start = ruled_values(path, names, given)
    given |= {name: f"{value:.17g}" for name, value in zip(names, start, strict=True)}
    first = load_scenario(path, hidden, given)
    held = uncertain_parameters(path, names, given, uncertain)
    _check(first)
    light = [np.asarray(each) for each in ([photograph] if np.ndim(photograph) == 3 else photograph)]
    if not 0 < len(light) >= len(shown):
        raise PhotographError(
            f"{len(light)} photographs of {len(shown)} shown pictures: give a photograph of each"
        )
    off = named(backgrounds)
    read = [Photograph.of(each, first.photograph_shape, mask=mask, monitor_off=off) for each in light]
    problem = _Problem(first, names, start, np.array(list(errors.values())), read, list(shown))
    # Products this small gain less from threads than these cost by waiting for each other on a busy
    # machine; and how many cores there are does not change what is found.
    with threadpool_limits(1):
        return _calibration(problem, held, seed, progress or (lambda _: None))


def _check(scenario: Scenario) -> None:
    """Raise a SceneError unless the scene is one that can be calibrated."""
    if scenario.wall_texture is not None:  # it moves in the photograph as the camera does
        raise SceneError(
            f"scene '{scenario.path}': calibrate does not support a textured wall; mask what is "
            "drawn there, and give the wall one reflectance"
        )
    if hidden_fraction(scenario) < LEAST:
        raise SceneError(
            f"scene '{scenario.path}': {shadow_doubt(scenario)}; calibration starts from shadows: "
            "add an occluder, or move those there are"
        )


@dataclass(frozen=True, eq=False)
class _Problem:
    """Photographs of a scene, its P free parameters and their prior."""

    scenario: Scenario
    names: tuple[str, ...]
    centers: Array
    errors: Array
    photographs: Sequence[Photograph]
    shown: Sequence[NDArray[np.floating[Any]]]

    def level(self, pixels: float, hats: int | None = None) -> Level:
        """Return the level of at least so many pixels, if there are, or a little less.

        Unknown images are sums of so many hats along the longer side, or of patches.
        """
        averaged = Averaged.of(self.photographs)
        used, light, off = averaged.used, averaged.light, averaged.monitor_off
        hidden = fitted(self.scenario.hidden_shape, MOST_PATCHES)
        stride = max(1, round(np.sqrt(used.sum() / pixels)))
        every = np.zeros_like(used)
        every[stride // 2 :: stride, stride // 2 :: stride] = True
        some = used & every
        finer = -(-LARGEST // max(used.shape))
        scenario = load_scenario(
            self.scenario.path,
            hidden,
            self.scenario.parameters,
            photograph=(finer * used.shape[0], finer * used.shape[1]),
        )
        scene = MovingScene(scenario, self.names, self.errors, some, finer)
        Q = background_basis(scene.point_lights(self.centers))
        Q = joined_basis(Q, np.hstack([Q[:, :0], *(each[some] for each in off)]))
        known = len(self.shown)
        groups = [
            Group(y[some], Images.shown(area_average(picture, hidden)))
            for y, picture in zip(light, self.shown, strict=False)
        ]
        if light[known:]:
            coarse = hidden if hats is None else fitted(hidden, hats)
            images = Images.patches(hidden) if hats is None else Images.hats(hidden, coarse)
            groups.append(Group(np.hstack([y[some] for y in light[known:]]), images))
        if len(Q) <= 2 * Q.shape[1]:
            raise PhotographError(
                f"{len(Q)} pixels are used, too few beside {Q.shape[1]} kinds of ambient light; "
                "give a larger photograph, or mask less of it"
            )
        return Level(scene, self.centers, self.errors, Q, tuple(groups))


def _calibration(
    problem: _Problem, held: UncertainParameters, seed: int, progress: Callable[[float], None]
) -> Calibration:
    patches = np.prod(fitted(problem.scenario.hidden_shape, MOST_PATCHES))
    fine = problem.level(max(COARSE_PIXELS, PIXELS_A_PATCH * patches))
    coarse = problem.level(COARSE_PIXELS, COARSE_HATS)
    whole = problem.level(LARGEST**2)
    known = len(problem.shown) == len(problem.photographs)
    middle = problem.level(COARSE_PIXELS)
    visits: tuple[list[Look], ...] = ([], [], [])
    # A fine look takes three times as long as others.
    expected = 25 if known else 50 + STEPS * len(COOLING) * (DRAWS + 1) + 40

    def visit(level: int, look: Look) -> None:
        none = look.beyond[:, :0]
        visits[level].append(replace(look, beyond=none, motions=none, explanations=()))
        progress(min(0.99, sum(w * len(v) for w, v in zip((1, 1, 3), visits, strict=True)) / expected))

    search = Search(coarse, middle, fine, whole, seed, visit)
    end = search.followed(fine.center) if known else search.best()
    count, κ = len(problem.names), end.temperature
    without = fine.look(np.append(problem.centers, end.point[count:]), κ)
    # Errors count that an unknown image may follow by a fraction of a patch.
    errors_at = replace(
        problem.level(max(COARSE_PIXELS, PIXELS_A_PATCH * patches), COARSE_HATS)
        if not known
        else fine,
        scene=replace(
            fine.scene,
            names=(*problem.names, *held.names),
            errors=np.append(problem.errors, held.standard_errors),
        ),
        centers=np.append(problem.centers, held.values),
        errors=np.append(problem.errors, held.standard_errors),
    )
    values = fine.values(end.point)
    joint = errors_at.look(np.concatenate([values, held.values, end.point[count:]]), κ)
    gained = is_significant(
        without.objective - end.objective, learned(joint, count)
    )
    point = end.point if gained else without.point
    seen = end if gained else without
    alone, moves = _errors(joint, count, len(held.names), held.standard_errors)
    moves = np.clip(moves, -problem.errors[:, None], problem.errors[:, None])
    covariance = alone + moves @ moves.T
    shrink = np.minimum(1, problem.errors / np.sqrt(np.diag(covariance)))
    covariance *= np.outer(shrink, shrink)
    deviations = np.sqrt(np.diag(covariance))
    values = fine.values(point)
    why = doubts(problem.names, (values - problem.centers) / problem.errors, learned(joint, count), end)
    progress(1.0)
    columns = (
        problem.centers, values, np.minimum(np.sqrt(np.diag(alone)), problem.errors), deviations, problem.errors,
    )  # fmt: skip
    scale = float(np.sqrt(np.mean([np.mean(g.light**2) for g in fine.groups])))
    return Calibration(
        parameters=tuple(
            Parameter(name, *(float(n) for n in numbers), trusted=not why)
            for name, *numbers in zip(problem.names, *columns, strict=True)
        ),
        uncertain=held,
        moves=moves,
        correlation=covariance / np.outer(deviations, deviations),
        path=tuple(
            Visited(
                _shape(level.scene.pixels),
                level.scene.scenario.hidden_shape,
                np.array([look.point[:count] for look in looks]).reshape(-1, count),
                np.array([look.evidence for look in looks]),
            )
            for level, looks in zip((coarse, middle, fine), visits, strict=True)
            if looks
        ),
        noise_before=np.concatenate([e.noise for e in without.explanations]) / scale,
        noise=np.concatenate([e.noise for e in seen.explanations]) / scale,
        residual_before=_picture(fine, without.explanations[0].residual[:, :3] / scale),
        residual=_picture(fine, seen.explanations[0].residual[:, :3] / scale),
        gain=_picture(fine, fine.gain(point) - 1) + 1,
        overdispersion=κ,
        moved=gained,
        colour_matrix=_colours(end) if problem.shown else None,
        doubts=why,
    )


def _errors(joint: Look, count: int, held: int, errors: Array) -> tuple[Array, Array]:
    """Return the free parameters' covariance, (P, P), and how far uncertain ones move them, (P, U).

    Were such a parameter wrong by δ, the photographs would be explained best elsewhere, by
    −(I_θθ + Λ)⁻¹ I_θp δ.
    """
    free = np.ones(len(joint.point), bool)
    free[count : count + held] = False
    inverse = np.linalg.inv(joint.curvature()[np.ix_(free, free)])
    shared = joint.information[np.ix_(free, ~free)] / joint.temperature
    moves = -inverse @ shared * errors
    return MARGIN**2 * inverse[:count, :count], moves[:count]


def _colours(look: Look) -> Array:
    """Return the colour matrix, (3, 3), of the first picture that is known."""
    M = look.explanations[0].coefficients.T
    return np.asarray(M / M.sum(axis=1).mean())


def _shape(pixels: NDArray[np.bool_]) -> tuple[int, int]:
    """Return how many rows and columns have a pixel in use."""
    return int(pixels.any(axis=1).sum()), int(pixels.any(axis=0).sum())


def _picture(level: Level, values: Array) -> Array:
    """Return what used pixels have, (M, ...), as (rows, columns, ...) of those in use."""
    pixels = level.scene.pixels
    laid = np.zeros((*pixels.shape, *values.shape[1:]))
    laid[pixels] = values
    return laid[pixels.any(axis=1)][:, pixels.any(axis=0)]
