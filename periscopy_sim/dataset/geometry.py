"""Renderings that many photographs share: a geometry's transport matrix, and ambient light."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.dataset.configuration import Bounced, Conditions, Configuration, Pictures
from periscopy_sim.dataset.draws import GeometryDraw, draw_geometry
from periscopy_sim.errors import ConfigurationError, SceneError
from periscopy_sim.rendering.transport.bounced import BouncedTransport
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.ambient_library import Progress, ambient_photographs
from periscopy_sim.storage.photographs import read_photograph

Backgrounds = Mapping[int, NDArray[np.float32]]
"""By ambient source: (K, rows, columns, 3) light on a grey wall, in any unit."""

_rendering = threading.RLock()
"""Held while Mitsuba is at work: Dr.Jit's arrays belong to one thread at a time."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """A scene with its parameters, ready to take photographs by A."""

    draw: GeometryDraw
    scenario: Scenario
    transport: NDArray[np.float32] | BouncedTransport  # (M, N)


def scenario_of(configuration: Configuration, draw: GeometryDraw) -> Scenario:
    """Return the scene of a geometry; the error of one that cannot be loaded has its parameters."""
    from periscopy_sim.rendering.scene.load import load_scenario

    scene = configuration.scenes[draw.source].scene
    place = f"geometry {draw.number} ({draw.parameters or 'no parameters'})"
    try:
        with _rendering:
            return load_scenario(scene, configuration.hidden, draw.parameters)
    except SceneError as error:
        raise ConfigurationError(f"{place}: {error}") from error


def geometry_of(configuration: str, number: int) -> Geometry:
    """Return a geometry, given the configuration as JSON; the last few are remembered."""
    with _rendering:  # a thread that waits for a geometry finds it remembered
        return _rendered(configuration, number)


@lru_cache(maxsize=4)  # direct light takes 66 MB each at 36 x 29 patches and 126 x 126 pixels
def _rendered(configuration: str, number: int) -> Geometry:
    from periscopy_sim.rendering.transport.bounced import add_bounces
    from periscopy_sim.rendering.transport.shadow_rays import render_transport

    settings = Configuration.model_validate_json(configuration)
    draw, light = draw_geometry(settings, number), settings.light
    scenario = scenario_of(settings, draw)
    # The seed is the data set's own: samples of A are no random draw of a sample.
    A = render_transport(scenario, samples=light.samples, seed=settings.seed)
    if isinstance(light, Bounced):
        return Geometry(draw, scenario, add_bounces(scenario, A, light.bounces, seed=settings.seed))
    return Geometry(draw, scenario, A)


def backgrounds_of(
    settings: Configuration, scenario: Scenario, folder: Path, progress: Progress
) -> Backgrounds:
    """Return the ambient light of each source of pictures or conditions, on a scene's wall in grey.

    Pictures show the scene's wall, with a positive mean; `folder` keeps rendered conditions.
    """
    gain, light = scenario.channel_gain, {}
    if scenario.wall_reflectance is not None:
        scenario = replace(scenario, wall_reflectance=scenario.wall_reflectance / gain)
    for number, source in enumerate(settings.ambient):
        if isinstance(source, Conditions):
            pictures = ambient_photographs(
                source.names, scenario, folder / f"ambient-{number}", settings.seed,
                target=source.target, progress=progress,
            )  # fmt: skip
        elif isinstance(source, Pictures):
            shape = scenario.photograph_shape
            pictures = {file: read_photograph(file, shape).values / gain for file in source.files}
        else:
            continue
        for name, picture in pictures.items():
            if not picture.mean() > 0:
                raise ConfigurationError(f"{name}: its mean is not positive")
        light[number] = np.stack([*pictures.values()]).astype(np.float32)
    return light
