"""What is rendered once for many photographs: the transport matrix of a geometry, ambient light."""

from __future__ import annotations

import hashlib
import threading
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.dataset.configuration.document import (
    Bounced,
    Configuration,
    PathTraced,
)
from periscopy_sim.dataset.making.draws import GeometryDraw, draw_geometry
from periscopy_sim.errors import ConfigurationError, SceneError
from periscopy_sim.rendering.transport.bounced import BouncedTransport
from periscopy_sim.scenario import Array, Scenario

Photographer = Callable[[Array, int], Array]
"""Takes (R, C, 3) and a seed, gives (rows, columns, 3)."""

REMEMBERED = 4
"""Geometries kept ready: of direct light 66 MB each at 36 x 29 patches and 126 x 126 pixels."""

_rendering = threading.RLock()
"""Held while Mitsuba is at work: Dr.Jit's arrays belong to one thread at a time."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """A scene with its parameters, ready to take photographs: by A, or path traced."""

    draw: GeometryDraw
    scenario: Scenario
    transport: NDArray[np.float32] | BouncedTransport | None  # (M, N)
    photographer: Photographer | None
    doubts: tuple[str, ...] = ()  # what its rendering warned of


def scenario_of(configuration: Configuration, number: int) -> Scenario:
    """Return the scene of a geometry; if it cannot be loaded, the error tells its parameters."""
    from periscopy_sim.rendering.scene.load import load_scenario

    draw = draw_geometry(configuration, number)
    scene = configuration.scenes[draw.source].scene
    try:
        with _rendering:
            scenario = load_scenario(
                found_scene(configuration, scene), configuration.hidden, draw.parameters
            )
    except SceneError as error:
        given = ", ".join(f"{name}={value}" for name, value in draw.parameters.items())
        raise ConfigurationError(
            f"geometry {number} ({given or 'no parameters'}): {error}"
        ) from error
    if scenario.wall_texture is not None:
        raise ConfigurationError(
            f"geometry {number}: the wall of {scene} is textured; data sets need one reflectance"
        )
    return scenario


def found_scene(configuration: Configuration, name: str) -> Path:
    """Return a scene file, as seen from the configuration's folder, or a shipped one."""
    from periscopy_sim.shipped import find_scene

    beside = configuration.folder / name
    return beside if beside.is_file() else find_scene(name)


def geometry_of(configuration: str, number: int) -> Geometry:
    """Return what all photographs of a geometry share; the last few are remembered.

    The configuration is JSON, see `as_json`.
    """
    with _rendering:  # who waits for it finds it remembered
        return _rendered(configuration, number)


@lru_cache(maxsize=REMEMBERED)
def _rendered(configuration: str, number: int) -> Geometry:
    settings = Configuration.model_validate_json(configuration)
    scenario = scenario_of(settings, number)
    draw = draw_geometry(settings, number)
    light = settings.light
    if isinstance(light, PathTraced):
        return Geometry(draw, scenario, None, _photographer(scenario, light))
    from periscopy_sim.rendering.transport.shadow_rays import render_transport

    # The seed is the data set's own: samples of A are no random draw of a sample.
    bounces = light.bounces if isinstance(light, Bounced) else 1
    with warnings.catch_warnings(record=True) as caught:  # told by who started the making
        warnings.simplefilter("always", RuntimeWarning)
        A = render_transport(scenario, samples=light.samples, bounces=bounces, seed=settings.seed)
    doubts = []
    for each in caught:
        if "light that bounces" in str(each.message):
            doubts.append(f"geometry {number}: {each.message}")
        else:  # perhaps of another thread
            warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
    return Geometry(draw, scenario, A, None, tuple(doubts))


def _photographer(scenario: Scenario, light: PathTraced) -> Photographer:
    from periscopy_sim.rendering.photograph import Monitor, without_warnings

    monitor = Monitor(
        scenario, scenario.hidden_shape, samples=light.samples, bounces=light.bounces,
        only_monitor=True,
    )  # fmt: skip

    def photograph(image: Array, seed: int) -> Array:
        with _rendering, without_warnings():
            return monitor.photograph(image, seed=seed)

    return photograph


def as_json(configuration: Configuration) -> str:
    """Write a configuration without its `count`, of which no sample depends."""
    return configuration.model_copy(update={"count": 1}).model_dump_json()


def view_digest(scenario: Scenario) -> str:
    """Return what tells walls apart that ambient light falls on differently, colour aside."""
    digest = hashlib.sha256()
    for values in (scenario.wall_points, scenario.wall_normals, scenario.photograph_shape):
        digest.update(np.ascontiguousarray(np.round(values, 6)).tobytes())
    return digest.hexdigest()[:12]


Backgrounds = Mapping[str, Mapping[int, NDArray[np.float32]]]
"""By `view_digest` and by ambient source: (K, rows, columns, 3) irradiance, in any unit."""
