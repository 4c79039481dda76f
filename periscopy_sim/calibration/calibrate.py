"""Find the parameters of a scene that explain a photograph best, coarse to fine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.consider_analysis import (
    UncertainParameters,
    require_effect,
    sensitivity,
    uncertain_parameters,
)
from periscopy_sim.calibration.constraints import InFront
from periscopy_sim.calibration.explanation.discrepancy import STRUCTURED
from periscopy_sim.calibration.explanation.resolution_level import (
    Rays,
    Resolution,
    ResolutionLevel,
    Values,
    fitted,
)
from periscopy_sim.calibration.parameters import scales_and_spreads
from periscopy_sim.calibration.prior import Free, Prior, free_parameters, start_values
from periscopy_sim.calibration.progress import Progress
from periscopy_sim.calibration.result import Calibration, Parameter
from periscopy_sim.calibration.search.fisher_information import block_scores
from periscopy_sim.calibration.search.global_search import explore
from periscopy_sim.calibration.search.image_shift import ImageShift
from periscopy_sim.calibration.search.levenberg_marquardt import Descent
from periscopy_sim.calibration.search.patch_search import ITERATIONS, search_patches
from periscopy_sim.calibration.search.ruled_starts import ends_from_ruler
from periscopy_sim.calibration.trust import bounded, doubts, is_significant, learned
from periscopy_sim.errors import PeriscopyError, PhotographError, SceneError, VariantError
from periscopy_sim.photographs.checking import check_photograph
from periscopy_sim.reconstruction.background_photographs import (
    Backgrounds,
    named,
)
from periscopy_sim.reconstruction.background_subspace import background_basis
from periscopy_sim.reconstruction.monitor_left_on import COARSE, check_monitor_off
from periscopy_sim.reconstruction.observation import observation_of
from periscopy_sim.reconstruction.residual.orientations import AS_IT_IS, FLIPPED, Orientation
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.shadow_check import LEAST, hidden_part, shadow_doubt
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from periscopy_sim.rendering.variant import install_llvm, is_vectorized
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.shipped import find_scene

LEVELS = (
    Resolution(32, 24, 1, Rays(4, 9), Rays(4, 9)),
    Resolution(63, 36, 2, Rays(9, 16), Rays(4, 9)),
)
"""Coarse and fine: looked over, and descended on. Larger photographs and hidden images are averaged
down to the last. Patches of the coarse one are nearly as small as an image's details: with 12 along
a side, wrong places explained images of 20 and 36 by 200 to 1200 in evidence more than the true one
did. With fewer rays, where areas do not serve, the last has dips that hold a descent, millimetres
from the best; slopes, of wide differences, need fewer."""

GAINS = 3
"""Times that the gain over the wall is found anew before a descent: it is linearized each time."""

MARGIN = 1.3
"""Times larger than by the linear theory that errors are told to be: valleys of the evidence are
curved, and so much was missing in simulations, see `experiments.studies.calibration_trust`."""

SHOWN = 100.0
"""Gain in evidence over a black monitor below which a photograph shows nothing of the scene."""


def calibrate(
    photograph: NDArray[np.floating[Any]],
    scene: str | Path,
    hidden: tuple[int, int],
    free: Free | None = None,
    *,
    parameters: Mapping[str, str | float] | None = None,
    uncertain: Mapping[str, float] | None = None,
    backgrounds: Backgrounds | None = None,
    mask: NDArray[np.bool_] | None = None,
    samples: int = 144,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Find the values of a scene's parameters that explain a photograph best.

    Nothing is known of the hidden image but that it is smooth rather than not, nothing of the
    ambient light but that it comes from afar, see `evidence`, nor of a smooth gain over the wall,
    see `SmoothGain`. Of the parameters is known what the ruler says, see `Prior`: descents begin
    there and at places within its errors, at a low resolution, and another goes on from the best of
    their ends. Where the ruler knows nothing of one, the best of many points of a box is looked for
    instead.

    Parameters
    ----------
    photograph
        (rows, columns, 3), linear, of any unit.
    scene
        A Mitsuba XML file, or the name of a shipped scene.
    hidden
        (R, C) of the hidden image; of finer ones than 36 patches along a side, or 0.6 patches a
        pixel of the search, a coarser one serves.
    free
        Names of the ``<default>``s to find, or a mapping of them to the ruler's errors: standard
        deviations of where they start, None for the one that the scene declares, if it does. By
        default, all whose error the scene declares as the ``<default>`` ``NAME_error``, but for
        those in `uncertain`. Those that shift the monitor in its plane are found but for whole
        patches, see `image_shift`: how well they are known stays the ruler's word.
    parameters
        Values of ``<default>``s: where free ones start, where others are held.
    uncertain
        Standard errors of ``<default>``s that are held, independent of each other. They change no
        value, but its error: see `consider_analysis`.
    backgrounds
        Photographs of the wall with the monitor off, of the photograph's size, or a mapping of
        their names to them: their light joins that from afar.
    mask
        (rows, columns) pixels to use; None for all.
    samples
        Rays from a pixel to a patch, where the matrix cannot be had by areas, see `area_transport`.
    seed
        Of the draws and the rays.
    progress
        Called with the fraction done, 1 at last; what ends early leaps.

    Returns
    -------
    Calibration
        See there; look at `Calibration.trusted` first.

    Raises
    ------
    SceneError
        If a parameter is unknown or unseen, no shadow is in view where the search starts, or where
        it starts or leads to is not physical.
    PhotographError
        If the photograph is not of the camera's size, or holds nothing.
    VariantError
        In scalar variants, which would take days.
    """
    from threadpoolctl import threadpool_limits

    path = find_scene(scene)
    given = {name: str(value) for name, value in (parameters or {}).items()}
    uncertain = dict(uncertain or {})
    errors = free_parameters(path, free, given, uncertain)
    first = load_scenario(path, hidden, given)
    names = tuple(errors)
    start = start_values(path, names, given)
    prior = Prior(start, np.array(list(errors.values())))
    held = uncertain_parameters(path, names, given, uncertain)
    if not is_vectorized():
        raise VariantError("calibration renders thousands of photographs; " + install_llvm())
    y = check_photograph(photograph, first.photograph_shape, "photograph", mask)
    if hidden_part(first) < LEAST:
        raise SceneError(
            f"scene '{path}': {shadow_doubt(first)}; calibration starts from shadows: correct it"
        )
    in_front = InFront(first)
    resolutions = [*LEVELS[:-1], finest(samples)]
    # Products this small gain less from threads than these cost by waiting for each other on a busy
    # machine; and how many cores there are does not change what is found.
    with threadpool_limits(1):
        off = []
        if backgrounds is not None and len(backgrounds):
            small = load_scenario(path, fitted(hidden, COARSE), given)
            off = _monitor_off(backgrounds, y, small, mask, seed)

        def level(resolution: Resolution, seen: Orientation = AS_IT_IS) -> ResolutionLevel:
            return ResolutionLevel(
                path,
                given,
                names,
                prior,
                y[seen],
                [light[seen] for light in off],
                None if mask is None else mask[seen],
                hidden,
                resolution,
                seed,
                in_front.check,
                by_area=True,
            )

        levels = [level(resolution) for resolution in resolutions]
        flipped = {name: level(resolutions[0], seen) for name, seen in FLIPPED.items()}
        if not all(each.has_areas(start) for each in levels):
            levels = [each.by_rays() for each in levels]
            flipped = {name: each.by_rays() for name, each in flipped.items()}
        levels[0].background(start)  # too few pixels are told of before anything is rendered
        shift = ImageShift.of(path, levels[-1].hidden_shape, given, names, prior)
        return calibrate_levels(levels, start, held, progress, shift=shift, flipped=flipped)


def finest(samples: int) -> Resolution:
    """Return the last level with so many rays from a pixel to a patch, a few of them for slopes."""
    last = LEVELS[-1]
    of_patch = -(-samples // last.rays.pixel_samples)
    slope_rays = replace(last.slope_rays, samples=min(last.slope_rays.samples, of_patch))
    return replace(last, rays=replace(last.rays, samples=of_patch), slope_rays=slope_rays)


def _monitor_off(
    backgrounds: Backgrounds,
    photograph: Array,
    scenario: Scenario,
    mask: NDArray[np.bool_] | None,
    seed: int,
) -> list[Array]:
    """Return photographs with the monitor off; a PhotographError names one that is none.

    The scenario's hidden image is as coarse as one that tells whether they show the monitor.
    """
    shape, hidden = scenario.photograph_shape, scenario.hidden_shape
    A = render_transport(scenario, seed=seed)
    try:
        given = named(backgrounds)
        off = {name: check_photograph(image, shape, name, mask) for name, image in given.items()}
        observation = observation_of(A, hidden, scenario.channel_gain, mask, shape, off)
        observation.vectorized(photograph)  # which is none of them
        smooth = background_basis(observation.used(point_light_backgrounds(scenario)))
        check_monitor_off(A, smooth, observation)
    except ValueError as error:
        raise PhotographError(str(error)) from None
    return list(off.values())


def calibrate_levels(
    levels: Sequence[ResolutionLevel],
    start: Values,
    held: UncertainParameters,
    progress: Callable[[float], None] | None = None,
    *,
    shift: ImageShift | None = None,
    flipped: Mapping[str, ResolutionLevel] = MappingProxyType({}),
) -> Calibration:
    """Find the values of some levels' parameters, from a start, (P,); else see `calibrate`.

    The two levels, coarse and fine, are of the same photograph, parameters and prior. Those
    `flipped`, by name, are the coarse one of it mirrored or rotated.
    """
    coarse, fine = levels
    names, prior = fine.names, fine.prior
    shift = shift or ImageShift.none(len(names))
    require_effect(coarse, start, held)
    scales, spreads = scales_and_spreads(coarse.differing(), start)
    steps = np.minimum(scales, prior.errors)
    ruled = bool(np.isfinite(prior.errors).all())
    log = Progress(len(start), ruled, ITERATIONS, progress)
    if ruled:
        evened = _evened(coarse, start).comparable(start)
        ends = ends_from_ruler(evened, start, steps, log.at(coarse))
        evened = _evened(fine, start).comparable(start)
        values = min([start, *ends], key=evened.judgement)
    else:
        values = explore(coarse, start, spreads, coarse.seed, log.at(coarse))
    _require_shadows(coarse, values)
    visit = log.at(fine)
    fine = _evened(fine, values)
    best = search_patches(fine, values, steps, shift, visit, log.looked)
    values, after, fine, end = best.values, best.seen, best.level, best.end
    if end.unphysical is not None:
        place = ", ".join(f"{name} = {v:.4g}" for name, v in zip(names, end.values, strict=True))
        raise SceneError(
            f"the search left the physical, past {place}: {end.unphysical}; free less, or fix "
            "the one that went too far by -D"
        )
    # A ruler's error bounds how far another's may drag a parameter; the linear theory has no bound.
    moves = sensitivity(fine, end, held)
    moves = np.clip(moves, -prior.errors[:, None], prior.errors[:, None])
    before = fine.judged(start)
    known = learned(end.curvature)
    gained = is_significant(before.evidence - after.evidence, known)
    set_back = ruled and not gained
    if set_back:
        values, after = start, before
    visit(values, after.evidence)
    plain = fine.as_it_comes()
    left_before, left = plain.explain(start), plain.explain(values)
    structured = fine.discrepancy > STRUCTURED
    misfit = left.left if structured else 0.0
    negative = after.darker_than_black if structured else 0.0
    why = (
        *doubts(names, values, spreads, prior, gained, known, misfit, negative),
        *_doubted_orientation(coarse, values, flipped, start),
    )
    # A shift of the image that no ruler knows, nobody knows: it is anywhere that was searched.
    unknown = shift.alone & np.isinf(prior.errors)
    ruler = np.hypot(np.where(unknown, spreads, prior.errors), values - start)
    alone, covariance = _covariances(fine, end, best.alike, moves, ruler, shift.alone, set_back)
    deviations = np.sqrt(np.diag(covariance))
    log.report(1.0)
    columns = start, values, np.sqrt(np.diag(alone)), deviations, scales, spreads, prior.errors
    return Calibration(
        parameters=tuple(
            Parameter(name, *(float(number) for number in numbers), trusted=not why)
            for name, *numbers in zip(names, *columns, strict=True)
        ),
        uncertain=held,
        moves=moves,
        correlation=covariance / np.outer(deviations, deviations),
        path=log.path(),
        noise_before=left_before.noise / fine.scale,
        noise=left.noise / fine.scale,
        residual_before=fine.picture(left_before.residuals),
        residual=fine.picture(left.residuals),
        gain=fine.gain_of(after),
        discrepancy=fine.discrepancy,
        overdispersion=fine.overdispersion,
        moved=gained,
        doubts=why,
    )


def _evened(level: ResolutionLevel, values: Values) -> ResolutionLevel:
    """Return a level whose wall's unevenness, as it shows at some values, is divided out.

    It begins with the gain that is found there. Images that may shine negatively would follow a
    strong gain, and lead to one that is upside down.
    """
    level.background(values)  # once for this level and all that are made of it
    found = level.of_nonnegative_images().explain(values)
    level = level.evened(found)
    for _ in range(GAINS):
        level = level.gained(found)
        found = level.of_nonnegative_images().explain(values)
    return level.gained(found)


def _require_shadows(level: ResolutionLevel, values: Values) -> None:
    """Check that something of the scene is seen at some values; else raise a PhotographError."""
    seen = level.explain(values)
    if not seen.darkness - seen.evidence >= SHOWN:  # nor where nothing is a number
        raise PhotographError(
            "the photograph shows no shadows of this scene, wherever its parameters are; nothing "
            "can be learned from it"
        )


def _doubted_orientation(
    level: ResolutionLevel,
    values: Values,
    flipped: Mapping[str, ResolutionLevel],
    start: Values,
) -> tuple[str, ...]:
    """Return a doubt if a flipped photograph is explained better than the one as it is.

    The values were found for the level's photograph as it is; one that is flipped may be explained
    at the start, too.
    """
    if not flipped:
        return ()

    def evidence(seen: ResolutionLevel, *places: Values) -> float:
        plain = seen.as_it_comes().of_nonnegative_images()
        try:
            return min(plain.explain(place).evidence for place in places)
        except PeriscopyError:  # a mask that leaves too little of it
            return np.inf

    found = {name: evidence(each, start, values) for name, each in flipped.items()}
    name = min(found, key=lambda each: found[each])
    if not found[name] < evidence(level, values) - SHOWN:
        return ()
    return (f"the photograph may be {name}: so it is explained better than as it is",)


def _covariances(
    level: ResolutionLevel,
    end: Descent,
    alike: Array,
    moves: Array,
    ruler: Values,
    shifting: NDArray[np.bool_],
    set_back: bool,
) -> tuple[Array, Array]:
    """Return the parameters' covariances, (P, P): alone, and with what uncertain ones do to them.

    Both are `bounded`; `alike`, (P, K), lead to dips that are, see `walk`; `moves`, (P, U), are of
    `sensitivity`. Parameters that are `shifting`, (P,), the image alone are known by the ruler, and
    so the others, which move as they do, no better: a room that is moved as a whole looks the same.
    If `set_back`, all are the ruler's.
    """
    if set_back:
        as_ruler = np.diag(ruler**2)
        return as_ruler, bounded(as_ruler + moves @ moves.T, ruler)
    others, about = ~shifting, end.curvature
    found = np.zeros((len(ruler), len(ruler)))
    scores = block_scores(level, end.explanation, about.jacobian)
    told = about.of(others)
    found[np.ix_(others, others)] = MARGIN**2 * told.covariance([s[:, others] for s in scores])
    crossed = about.invertible()[np.ix_(others, shifting)]
    following = np.zeros((len(ruler), int(shifting.sum())))
    following[others] = -np.linalg.solve(told.invertible(), crossed)
    following[shifting] = np.eye(int(shifting.sum()))
    found += (following * ruler[shifting] ** 2) @ following.T + alike @ alike.T
    return bounded(found, ruler), bounded(found + moves @ moves.T, ruler)
