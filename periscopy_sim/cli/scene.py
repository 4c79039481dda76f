"""What the commands do with a scene: load it and render its transport matrix, with progress."""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

from periscopy_sim.cli.arguments import (
    mendable,
    parse_definitions,
    parse_size,
    progress,
    warn,
)
from periscopy_sim.errors import PhotographError

if TYPE_CHECKING:
    from periscopy_sim.photographs.checking import Photograph
    from periscopy_sim.scenario import Scenario


class Model(StrEnum):
    """How the transport matrix is computed."""

    rendered = "rendered"
    analytic = "analytic"


ModelOption = Annotated[
    Model, typer.Option(help="A by shadow rays, or in closed form (planar scenes, convex parts).")
]


def load(name: str, hidden: str, definitions: list[str] | None) -> Scenario:
    """Load a scene from what a command was given."""
    from periscopy_sim.rendering.scene.load import load_scenario
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
    from periscopy_sim.rendering.transport.shadow_rays import render_transport

    with progress("rendering the transport matrix") as report:
        return render_transport(scenario, samples=samples, seed=seed, progress=report)


def read_transport(path: Path, scenario: Scenario) -> NDArray[np.float32]:
    """Read a matrix that `periscopy transport` wrote, and check that it fits the scene.

    Without the JSON file that was written beside it, only the shapes can be compared.

    Raises
    ------
    PhotographError
        If the file cannot be read, the shapes differ, or it was made from another scene or other
        parameters.
    """
    from periscopy_sim.photographs.checking import check_real
    from periscopy_sim.storage.formats.decoding import decoding
    from periscopy_sim.storage.formats.table import format_of

    if format_of(path).name != "NPY":
        raise PhotographError(f"{path}: is no NPY file; make one by `periscopy transport`")
    with decoding(path, "NPY"):
        # Mapped, not read: it may be large, and its shape is told by the header.
        A: NDArray[np.float32] = np.load(path, mmap_mode="r", allow_pickle=False)
    check_real(A.dtype, str(path))
    if A.shape != scenario.transport_shape:
        raise PhotographError(
            f"{path}: holds a matrix of shape {A.shape}; the scene's camera and hidden size need "
            f"{scenario.transport_shape}"
        )
    if not np.isfinite(A).all():
        raise PhotographError(f"{path}: holds NaN or infinities; render the matrix again")
    _check_record(path, scenario)
    return A


def _check_record(path: Path, scenario: Scenario) -> None:
    """Compare the JSON beside a matrix with the scene it shall serve."""
    record_file = path.with_suffix(".json")
    if not record_file.is_file():
        return
    try:
        record = json.loads(record_file.read_text())
        held = {name: record[name] for name in ("scene_sha256", "parameters", "hidden_shape")}
    except (ValueError, KeyError, TypeError, OSError):
        raise PhotographError(f"{record_file}: is damaged; render the matrix again") from None
    from periscopy_sim.storage.outputs.provenance import scene_sha256

    wanted = {
        "scene_sha256": scene_sha256(scenario.path, scenario.parameters),
        "parameters": dict(scenario.parameters),
        "hidden_shape": list(scenario.hidden_shape),
    }
    for name, value in wanted.items():
        if held[name] != value:
            raise PhotographError(
                f"{path}: was made from another scene ({name.replace('_', ' ')} {held[name]}, here "
                f"{value}); render it again"
            )


def read_photograph(
    path: Path, scenario: Scenario, mask: NDArray[np.bool_] | None = None
) -> Photograph:
    """Read a photograph of the size that the scene's camera sees, and print its warnings."""
    from periscopy_sim.storage import photographs

    given = photographs.read_photograph(path, scenario.photograph_shape, mask)
    for warning in given.warnings:
        warn(warning)
    return given


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

    from periscopy_sim.storage.outputs.provenance import provenance

    command = ["periscopy", *sys.argv[1:]]
    record = provenance(scenario.path, mi.variant(), seed, command, scenario.parameters)
    return {**record, "parameters": dict(scenario.parameters)}
