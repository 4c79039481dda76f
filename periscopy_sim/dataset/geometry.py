"""Renderings that many photographs share: a geometry's transport matrix, and ambient light."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.dataset.configuration import (
    Bounced,
    Conditions,
    Configuration,
    PathTraced,
    Pictures,
)
from periscopy_sim.dataset.draws import GeometryDraw, draw_geometry
from periscopy_sim.errors import ConfigurationError, SceneError
from periscopy_sim.rendering.transport.bounced import BouncedTransport
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.storage.ambient_library import Progress, find_condition, rendered_once
from periscopy_sim.storage.outputs.provenance import scene_sha256
from periscopy_sim.storage.photographs import read_photograph

Photographer = Callable[[Array, int], Array]
"""Takes (R, C, 3) and a seed, gives (rows, columns, 3)."""

Backgrounds = Mapping[str, Mapping[int, NDArray[np.float32]]]
"""By `view_digest` and by ambient source: (K, rows, columns, 3) irradiance, in any unit."""

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
    photographer: Photographer | None = None


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


@lru_cache(maxsize=REMEMBERED)
def _rendered(configuration: str, number: int) -> Geometry:
    from periscopy_sim.rendering.photograph import Monitor, without_warnings
    from periscopy_sim.rendering.transport.bounced import add_bounces
    from periscopy_sim.rendering.transport.shadow_rays import render_transport

    settings = Configuration.model_validate_json(configuration)
    draw, light = draw_geometry(settings, number), settings.light
    scenario = scenario_of(settings, draw)
    if not isinstance(light, PathTraced):
        # The seed is the data set's own: samples of A are no random draw of a sample.
        A = render_transport(scenario, samples=light.samples, seed=settings.seed)
        if not isinstance(light, Bounced):
            return Geometry(draw, scenario, A)
        whole = add_bounces(scenario, A, light.bounces, seed=settings.seed)
        return Geometry(draw, scenario, whole)
    monitor = Monitor(
        scenario, scenario.hidden_shape, samples=light.samples, bounces=light.bounces,
        only_monitor=True,
    )  # fmt: skip

    def photograph(image: Array, seed: int) -> Array:
        with _rendering, without_warnings():
            return monitor.photograph(image, seed=seed)

    return Geometry(draw, scenario, None, photograph)


def view_digest(scenario: Scenario) -> str:
    """Return a digest of a wall's view, colour aside: ambient light falls alike on equal views."""
    digest = hashlib.sha256()
    for values in (scenario.wall_points, scenario.wall_normals, scenario.photograph_shape):
        digest.update(np.ascontiguousarray(np.round(values, 6)).tobytes())
    return digest.hexdigest()[:12]


def backgrounds_of(
    settings: Configuration,
    scenarios: Iterable[Scenario],
    given: Mapping[int, NDArray[np.float32]],
    folder: Path,
    progress: Progress,
) -> Backgrounds:
    """Return the rendered and the given ambient light of every wall that scenarios see.

    `given` holds the pictures of `given_light`; the walls' colours are the geometries'. `folder`
    keeps rendered conditions, in a folder for each view of a wall.
    """
    conditions = {n: s for n, s in enumerate(settings.ambient) if isinstance(s, Conditions)}
    backgrounds: dict[str, dict[int, NDArray[np.float32]]] = {}
    for scenario in scenarios if given or conditions else ():
        view = view_digest(scenario)
        if view not in backgrounds:
            backgrounds[view] = dict(given) | {
                number: _conditions(source, scenario, folder / view, settings.seed, progress)
                for number, source in conditions.items()
            }
    return backgrounds


def _conditions(
    source: Conditions, scenario: Scenario, folder: Path, seed: int, progress: Progress
) -> NDArray[np.float32]:
    """Return photographs of conditions on a grey wall, (K, rows, columns, 3), rendered once."""
    if scenario.wall_reflectance is not None:
        grey = scenario.wall_reflectance / scenario.channel_gain
        scenario = replace(scenario, wall_reflectance=grey)
    pictures = []
    for path in map(find_condition, source.names):
        file = folder / f"{path.stem}-{scene_sha256(path)[:8]}-{source.target:g}.exr"
        pictures.append(rendered_once(file, path, scenario, seed, source.target, progress)[0])
    return np.stack(pictures)


def given_light(settings: Configuration, scenario: Scenario) -> dict[int, NDArray[np.float32]]:
    """Return the photographs of ambient light of each source that names some, of a grey wall.

    They must show the scene's wall, with a positive mean. Each is (K, rows, columns, 3).
    """
    light = {}
    for number, source in enumerate(settings.ambient):
        if isinstance(source, Pictures):
            shape, gain = scenario.photograph_shape, scenario.channel_gain.astype(np.float32)
            pictures = [read_photograph(file, shape).values for file in source.files]
            for name, picture in zip(source.files, pictures, strict=True):
                if not picture.mean() > 0:
                    raise ConfigurationError(f"{name}: its mean is not positive")
            light[number] = np.stack(pictures).astype(np.float32) / gain
    return light
