"""Find the parameters of a scene that explain a photograph best, coarse to fine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.coarse_to_fine import search
from periscopy_sim.calibration.level import Averaged, ResolutionLevel
from periscopy_sim.calibration.prior import (
    Free,
    InFront,
    Prior,
    free_parameters,
    shifts_image,
    uncertain_parameters,
)
from periscopy_sim.calibration.result import Calibration
from periscopy_sim.calibration.scene_covariance import ruled_values
from periscopy_sim.calibration.scene_matrices import SceneMatrices
from periscopy_sim.errors import PhotographError, SceneError, VariantError
from periscopy_sim.model.observation import Backgrounds, named, observation_of
from periscopy_sim.photograph import Photograph
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.shadow_check import LEAST, hidden_part, shadow_doubt
from periscopy_sim.rendering.variant import install_llvm, is_vectorized
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.shipped import find_scene

COARSE, FINE = (32, 24), (63, 36)
"""Pixels of the photograph and patches of the hidden image along their longer sides. The image of
the coarse level is made of hats, in which the evidence has few minima. That of the fine one is made
of square patches, as a monitor shows it: of a rendered one hats explained a chair 1.4 mm off by 300
more than the true place."""

UNRULED = 0.01
"""Of a unit: how far a parameter is moved that no ruler knows, to see what it does."""


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

    The hidden image is only known to be smooth, the ambient light to come from afar, see
    `evidence`, and a gain over the wall to be smooth, see `ResolutionLevel`. The parameters have a
    prior from the ruler, see `Prior`. Descents begin at its centre and at the best of some draws
    from it, at a low resolution; another goes on from the best of their ends.

    Parameters
    ----------
    photograph
        (rows, columns, 3), linear, of any unit.
    scene
        A Mitsuba XML file, or the name of a shipped scene.
    hidden
        (R, C) of the hidden image; the search uses at most 36 patches along a side, and 0.6 for
        each pixel.
    free
        Names of the ``<default>``s to find, or a mapping of them to the ruler's errors: standard
        deviations of where they start, None for the one that the scene declares, if it does. By
        default, all whose error the scene declares as the ``<default>`` ``NAME_error``, but for
        those in `uncertain`. Parameters that shift the monitor in its plane are as well known as by
        the ruler: an image shifted the other way gives the same photograph.
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
    samples
        Rays from a pixel to a patch, where the matrix has no closed form, see `area_transport`.
    seed
        Of the draws and the rays.
    progress
        Called with the fraction done, 1 at last.

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
        If the photograph is not of the camera's size, or shows nothing.
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
    given_off = named(backgrounds)
    read = Photograph.of(photograph, first.photograph_shape, mask=mask, monitor_off=given_off)
    y, off = read.values, list(read.monitor_off.values())
    _check_distinct(read, first)
    if hidden_part(first) < LEAST:
        raise SceneError(
            f"scene '{path}': {shadow_doubt(first)}; calibration starts from shadows: add an "
            "occluder, or move those there are"
        )
    shifting = np.zeros(len(names), bool)
    steps = np.where(prior.is_known, prior.errors, UNRULED)
    for k, name in enumerate(names):
        for value in (start[k] + steps[k], start[k] - steps[k]):
            try:
                moved = load_scenario(path, hidden, {**ruled, name: f"{value:.17g}"})
            except SceneError:
                continue
            shifting[k] = shifts_image(first, moved)
            break

    def level(size: tuple[int, int], light: Array, photographs: Sequence[Array]) -> ResolutionLevel:
        averaged = Averaged.of(light, photographs, mask, size[0])
        shape = averaged.hidden_shape(hidden, size[1])
        matrices = SceneMatrices(
            path,
            given,
            names,
            steps,
            averaged.used.shape,
            shape,
            InFront(first),
            None,
            seed,
            hats=size is COARSE,
        )
        if not matrices.has_areas(start):
            matrices = replace(matrices, samples=max(1, -(-samples // 16)))
        return ResolutionLevel.of(averaged, matrices, prior, start, seed)

    # Products this small gain less from threads than these cost by waiting for each other on a busy
    # machine; and how many cores there are does not change what is found.
    with threadpool_limits(1):
        levels = [level(size, y, off) for size in (COARSE, FINE)]
        return search(levels[0], levels[1], shifting, held, progress)


def _check_distinct(photograph: Photograph, scenario: Scenario) -> None:
    """Raise a PhotographError if a background photograph is the photograph itself."""
    A = np.broadcast_to(0.0, scenario.transport_shape)
    shape, gain = scenario.photograph_shape, scenario.channel_gain
    try:
        observation = observation_of(
            A, scenario.hidden_shape, gain, photograph.mask, shape, photograph.monitor_off
        )
        observation.vectorized(photograph.values)
    except ValueError as error:
        raise PhotographError(str(error)) from None
