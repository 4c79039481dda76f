"""Ambient light that is not drawn but rendered or given, for each wall that a data set sees."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.dataset.configuration.document import Configuration
from periscopy_sim.dataset.configuration.light_sources import Conditions, Pictures
from periscopy_sim.dataset.making.geometry import Backgrounds, scenario_of, view_digest
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.scenario import Scenario

Rendering = Callable[[str], AbstractContextManager[Callable[[float], None]]]
"""Takes the condition that is rendered, gives what takes the fraction done."""


def backgrounds_of(
    settings: Configuration,
    geometries: Iterable[int],
    first: Scenario,
    folder: Path,
    rendering: Rendering | None = None,
) -> Backgrounds:
    """Return the ambient light of every wall that the geometries of these numbers see.

    `first` is the scenario of geometry 0. Rendered conditions are kept in `folder`, in one for
    each view of a wall; `rendering` is called with each that is not there yet.
    """
    needed = {
        number: source
        for number, source in enumerate(settings.ambient)
        if isinstance(source, Conditions | Pictures)
    }
    show = rendering or (lambda _: nullcontext(lambda _: None))
    found: dict[str, dict[int, NDArray[np.float32]]] = {}
    for geometry in geometries if needed else ():
        scenario = scenario_of(settings, geometry) if geometry else first
        view = view_digest(scenario)
        if view in found:
            continue
        found[view] = {}
        for number, source in needed.items():
            if isinstance(source, Conditions):
                kept = folder / f"ambient-{view}"
                pictures = [
                    _rendered(name, source.target, scenario, kept, settings.seed, show)
                    for name in source.names
                ]
            else:
                pictures = [given_picture(name, scenario) for name in source.files]
            # The wall's colour is the geometry's.
            gain = scenario.channel_gain.astype(np.float32)
            found[view][number] = np.stack(pictures) / gain
    return found


def _rendered(
    name: str, target: float, scenario: Scenario, folder: Path, seed: int, show: Rendering
) -> NDArray[np.float32]:
    """Return a condition's photograph, rendered once."""
    from periscopy_sim.rendering.ambient.background import render_background
    from periscopy_sim.storage.ambient_library import find_condition
    from periscopy_sim.storage.formats.exr import read_exr, write_exr
    from periscopy_sim.storage.outputs.provenance import scene_sha256
    from periscopy_sim.storage.outputs.staging import staged_file

    path = find_condition(name)
    file = folder / f"{path.stem}-{scene_sha256(path)[:8]}-{target:g}.exr"
    if not file.is_file():
        with staged_file(file) as staged, show(f"ambient light: {Path(name).stem}") as report:
            background = render_background(
                path, scenario, target=target, seed=seed, progress=report
            )
            report(1.0)  # who interrupts may have stopped Mitsuba in the midst of it
            write_exr(staged, background.photograph, {})
    # Also what was just rendered: as kept, so that a later run computes the same.
    return read_exr(file)[0]


def given_picture(name: str, scenario: Scenario) -> NDArray[np.float32]:
    """Read a photograph of ambient light, (rows, columns, 3), of the scene's size.

    Its mean must be positive.
    """
    from periscopy_sim.storage.photographs import read_photograph

    picture = read_photograph(name, scenario.photograph_shape).values
    if not picture.mean() > 0:
        raise ConfigurationError(f"{name}: its mean is not positive; give ambient light")
    return picture.astype(np.float32)
