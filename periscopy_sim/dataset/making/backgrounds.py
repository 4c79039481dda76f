"""Ambient light that is not drawn but rendered or given, for each wall that a data set sees."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.dataset.configuration.document import Configuration
from periscopy_sim.dataset.configuration.light_sources import Conditions, Pictures
from periscopy_sim.dataset.making.geometry import Backgrounds, scenario_of, view_digest
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.ambient_library import Progress, find_condition, rendered_once
from periscopy_sim.storage.outputs.provenance import scene_sha256
from periscopy_sim.storage.photographs import read_photograph


def backgrounds_of(
    settings: Configuration,
    geometries: Iterable[int],
    first: Scenario,
    folder: Path,
    progress: Progress,
) -> Backgrounds:
    """Return the ambient light of every wall that the geometries of these numbers see.

    `first` is the scenario of geometry 0, whose wall the given pictures show. Rendered conditions
    are kept in `folder`, in one for each view of a wall.
    """
    sources = dict(enumerate(settings.ambient))
    # The walls' colours are the geometries'.
    gain = first.channel_gain.astype(np.float32)
    given = {
        number: np.stack([given_picture(name, first) for name in source.files]) / gain
        for number, source in sources.items()
        if isinstance(source, Pictures)
    }
    rendered = {n: source for n, source in sources.items() if isinstance(source, Conditions)}
    found: dict[str, dict[int, NDArray[np.float32]]] = {}
    for geometry in geometries if given or rendered else ():
        scenario = scenario_of(settings, geometry) if geometry else first
        view = view_digest(scenario)
        if view not in found:
            found[view] = given | {
                number: _rendered(source, scenario, folder / view, settings.seed, progress)
                for number, source in rendered.items()
            }
    return found


def _rendered(
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


def given_picture(name: str, scenario: Scenario) -> NDArray[np.float32]:
    """Read a photograph of ambient light, (rows, columns, 3), of the scene's size.

    Its mean must be positive.
    """
    picture = read_photograph(name, scenario.photograph_shape).values
    if not picture.mean() > 0:
        raise ConfigurationError(f"{name}: its mean is not positive; give ambient light")
    return picture.astype(np.float32)
