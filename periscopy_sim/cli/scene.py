"""What the commands do with a scene: load it and render its transport matrix, with progress."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.cli.arguments import (
    mendable,
    parse_definitions,
    parse_size,
    progress,
)
from periscopy_sim.errors import PhotographError

if TYPE_CHECKING:
    from periscopy_sim.scenario import Scenario


class Model(StrEnum):
    """How the transport matrix is computed."""

    rendered = "rendered"
    analytic = "analytic"


def load(name: str, hidden: str, definitions: list[str] | None) -> Scenario:
    """Load a scene from what a command was given."""
    from periscopy_sim.rendering.scene_file import load_scenario
    from periscopy_sim.shipped import find_scene

    return load_scenario(find_scene(name), parse_size(hidden), parse_definitions(definitions))


def transport(
    scenario: Scenario, samples: int, seed: int, model: Model = Model.rendered
) -> NDArray[np.float32]:
    """Compute A with a progress bar."""
    if model is Model.analytic:
        from periscopy_sim.analytic.transport import analytic_transport

        with progress("projecting shadows") as report:
            return analytic_transport(scenario, samples=samples, progress=report)
    from periscopy_sim.rendering.transport import render_transport

    with progress("rendering the transport matrix") as report:
        return render_transport(scenario, samples=samples, seed=seed, progress=report)


def read_transport(path: Path, scenario: Scenario) -> NDArray[np.float32]:
    """Read a matrix that `periscopy transport` wrote, and check that it fits the scene.

    Raises
    ------
    PhotographError
        If the file cannot be read or the shapes differ.
    """
    from periscopy_sim.storage.arrays import read_npy

    A = read_npy(path)
    if A.shape != scenario.transport_shape:
        raise PhotographError(
            f"{path}: holds a matrix of shape {A.shape}; the scene's camera and hidden size need "
            f"{scenario.transport_shape}"
        )
    if not np.isfinite(A).all():
        raise PhotographError(f"{path}: holds NaN or infinities; render the matrix again")
    return A


def photograph(
    scenario: Scenario, image: NDArray[np.float64], samples: int, seed: int
) -> NDArray[np.float64]:
    """Path trace a photograph with a progress bar."""
    from periscopy_sim.rendering.photograph import render_photograph

    with mendable("photograph"), progress("path tracing the photograph") as report:
        return render_photograph(scenario, image, samples=samples, seed=seed, progress=report)


def provenance_of(scenario: Scenario, seed: int | None) -> dict[str, Any]:
    """Record versions, scene, variant, seed and command line."""
    import mitsuba as mi

    from periscopy_sim.storage.provenance import provenance

    command = ["periscopy", *sys.argv[1:]]
    record = provenance(scenario.path, mi.variant(), seed, command)
    return {**record, "parameters": dict(scenario.parameters)}
