"""How errors of a scene's parameters change the light of a hidden image, in closed form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from periscopy_sim.analytic.area_transport import require_areas
from periscopy_sim.calibration.moving_scene import MovingScene, fitted
from periscopy_sim.calibration.prior import check_error, start_values
from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.model.uncertain_transport import UncertainTransport
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.scenario import Array, Scenario

LONGEST = 126
"""Most rows and columns for which derivatives are computed; larger photographs interpolate."""

BAND = 1000
"""Pixels whose derivatives are in memory at a time, about."""


def uncertain_transport(
    scenario: Scenario, errors: Mapping[str, float] | SceneCovariance
) -> UncertainTransport:
    """Return how errors of a scene's parameters change the light of images, for `NoiseAware`.

    Parameters
    ----------
    scenario
        The scene at its measured values.
    errors
        Standard errors of ``<default>``s, independent of each other, by name; or the covariance
        that a calibration wrote.

    Returns
    -------
    UncertainTransport
        For ``NoiseAware.for_scene(scenario, A, B, uncertain=...)``.

    Raises
    ------
    ClosedFormError
        If the scene has no closed form, see `area_transport`.
    SceneError
        If a parameter is unknown or no number, or an error not positive.
    """
    if isinstance(errors, SceneCovariance):
        names, values, directions = errors.names, errors.values, errors.directions
    else:
        names = tuple(errors)
        values = start_values(scenario.document, names)
        for name, error in errors.items():
            check_error(name, error)
        directions = np.diag(list(errors.values()))
    require_areas(scenario)
    shape = scenario.photograph_shape
    coarse = fitted(shape, max(LONGEST, *scenario.hidden_shape))
    movable = load_scenario(
        scenario.path, scenario.hidden_shape, scenario.parameters, photograph=coarse
    )
    deviations = np.sqrt(np.sum(directions**2, axis=1))
    scene = MovingScene(movable, names, deviations, np.ones(coarse, bool), 1)
    bands = np.array_split(np.arange(coarse[0]), min(coarse[0], -(-coarse[0] * coarse[1] // BAND)))

    def slopes(image: Array) -> NDArray[np.float32]:
        f, parts = image.reshape(-1, 3).astype(np.float32), []
        for band in bands:
            pixels = np.zeros(coarse, bool)
            pixels[band] = True
            parts.append(replace(scene, pixels=pixels).linearized(values)[1] @ f)
        light = np.concatenate(parts, axis=1).reshape(-1, *coarse, 3)
        finer = 1, *np.divide(shape, coarse), 1
        smooth = ndimage.zoom(light, finer, order=1, mode="nearest", grid_mode=True)
        return np.asarray(smooth.reshape(len(names), -1, 3))

    return UncertainTransport(names, directions, slopes)
