"""Find the parameters of a scene that explain a photograph best, coarse to fine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.calibrate_levels import calibrate_levels
from periscopy_sim.calibration.consider_analysis import (
    uncertain_parameters,
)
from periscopy_sim.calibration.constraints import InFront
from periscopy_sim.calibration.explanation.resolution_level import (
    Rays,
    Resolution,
    ResolutionLevel,
    fitted,
)
from periscopy_sim.calibration.prior import Free, Prior, free_parameters
from periscopy_sim.calibration.result import Calibration
from periscopy_sim.calibration.scene_covariance import ruled_values
from periscopy_sim.calibration.search.image_shift import ImageShift
from periscopy_sim.errors import PhotographError, SceneError, VariantError
from periscopy_sim.model.observation import (
    Backgrounds,
    named,
    observation_of,
)
from periscopy_sim.photograph import Photograph
from periscopy_sim.rendering.checks import LEAST, hidden_fraction, shadow_doubt
from periscopy_sim.rendering.scene.load import load_scenario
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
    names = tuple(errors)
    start = ruled_values(path, names, given)
    ruled = given | {name: f"{value:.17g}" for name, value in zip(names, start, strict=True)}
    first = load_scenario(path, hidden, ruled)
    prior = Prior(start, np.array(list(errors.values())))
    held = uncertain_parameters(path, names, given, uncertain)
    if not is_vectorized():
        raise VariantError("calibration renders thousands of photographs; " + install_llvm())
    y = Photograph.of(photograph, first.photograph_shape, mask=mask).values
    if hidden_fraction(first) < LEAST:
        raise SceneError(
            f"scene '{path}': {shadow_doubt(first)}; calibration starts from shadows: add an "
            "occluder, or move those there are"
        )
    in_front = InFront(first)
    resolutions = [*LEVELS[:-1], finest(samples)]
    # Products this small gain less from threads than these cost by waiting for each other on a busy
    # machine; and how many cores there are does not change what is found.
    with threadpool_limits(1):
        off = []
        if backgrounds is not None and len(backgrounds):
            small = load_scenario(path, fitted(hidden, 12), ruled)
            off = _monitor_off(backgrounds, y, small, mask, seed)

        def level(resolution: Resolution) -> ResolutionLevel:
            return ResolutionLevel(
                path,
                given,
                names,
                prior,
                y,
                off,
                mask,
                hidden,
                resolution,
                seed,
                in_front.check,
                by_area=True,
            )

        levels = [level(resolution) for resolution in resolutions]
        if not all(each.has_areas(start) for each in levels):
            levels = [each.by_rays() for each in levels]
        levels[0].background(start)  # too few pixels are told of before anything is rendered
        shift = ImageShift.of(path, levels[-1].hidden_shape, ruled, names, prior)
        return calibrate_levels(levels, start, held, progress, shift=shift)


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
        off = Photograph.of(photograph, shape, mask=mask, monitor_off=given).monitor_off
        observation = observation_of(A, hidden, scenario.channel_gain, mask, shape, off)
        observation.vectorized(photograph)  # which is none of them
    except ValueError as error:
        raise PhotographError(str(error)) from None
    return list(off.values())
