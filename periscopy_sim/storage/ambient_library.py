"""Photographs of ambient light kept in a folder, each rendered once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC, find_scene
from periscopy_sim.storage.formats.exr import read_exr, write_exr
from periscopy_sim.storage.outputs.provenance import as_text, provenance, scene_sha256
from periscopy_sim.storage.outputs.staging import staged_file

Progress = Callable[[str], AbstractContextManager[Callable[[float], None]]]
"""Receives the name of a rendering, and gives the function that reports its fraction done."""


def silent(_: str) -> AbstractContextManager[Callable[[float], None]]:
    """Show no progress."""
    return nullcontext(lambda _: None)


def ambient_photographs(
    names: Sequence[str],
    scenario: Scenario,
    folder: Path,
    seed: int,
    *,
    target: float = 3e-4,
    progress: Progress = silent,
) -> dict[str, NDArray[np.float64]]:
    """Return photographs of a wall under ambient conditions, and render those the folder lacks.

    `names` are shipped conditions or paths of scene files. The folder keeps each photograph, (rows,
    columns, 3) radiance, as ``NAME.exr``. `target` is the relative error of a pixel, see
    `render_background`; `progress` is called with each condition that is rendered. A name that is
    unknown or given twice, or a file of other settings, is a `PeriscopyError`.
    """
    paths = {Path(name).stem: find_condition(name) for name in names}
    if len(paths) < len(names):
        raise PeriscopyError(f"an ambient condition is given twice in {', '.join(names)}")
    photographs = {}
    for name, path in paths.items():
        file, settings = folder / f"{name}.exr", _settings(path, scenario, seed, target)
        picture, metadata = rendered_once(file, path, scenario, seed, target, progress, settings)
        # The digest identifies the scene, wherever it lies.
        wanted: dict[str, object] = {
            **settings,
            "pixels": scenario.photograph_shape,
            "scene": metadata.get("scene"),
        }
        held: dict[str, object] = {**metadata, "pixels": picture.shape[:2]}
        for key in (key for key, value in wanted.items() if held.get(key) != value):
            raise PeriscopyError(
                f"{file}: was made otherwise ({key} {held.get(key)}, here {wanted[key]}); name "
                "another folder or remove it"
            )
        photographs[name] = picture.astype(np.float64)
    return photographs


def rendered_once(
    file: Path,
    path: Path,
    scenario: Scenario,
    seed: int,
    target: float,
    progress: Progress,
    settings: Mapping[str, str] | None = None,
) -> tuple[NDArray[np.float32], dict[str, str | float]]:
    """Return the photograph that a file holds, with its metadata, and render it if there is none.

    With `settings`, these and the errors of the photograph become the file's metadata.
    """
    from periscopy_sim.rendering.ambient.background import render_background

    if not file.is_file():
        with staged_file(file) as staged, progress(f"ambient light: {path.stem}") as report:
            rendered = render_background(path, scenario, target=target, seed=seed, progress=report)
            report(1.0)  # an interrupt may have stopped Mitsuba in the midst of it
            # To six digits: beyond those, results depend on the order in which BLAS adds.
            errors = {
                name: float(f"{getattr(rendered, name):.6g}")
                for name in ("relative_error", "brightness_error")
            }
            write_exr(staged, rendered.photograph, {**settings, **errors} if settings else {})
    # Also what was just rendered: as kept, so that a later run computes the same.
    return read_exr(file)


def find_condition(name: str) -> Path:
    """Return the file of a shipped condition, or the scene file named."""
    if name in (*REALISTIC, *ADVERSARIAL):
        return find_scene(f"ambient/{name}")
    if Path(name).suffix == ".xml" and Path(name).is_file():
        return Path(name)
    known = ", ".join((*REALISTIC, *ADVERSARIAL))
    raise PeriscopyError(
        f"no ambient condition '{name}'; there are {known}, or name a Mitsuba XML file"
    )


def _settings(path: Path, scenario: Scenario, seed: int, target: float) -> dict[str, str]:
    """Return what a picture depends on, which does not include the scenario's hidden size."""
    import mitsuba as mi

    made = provenance(scenario.path, mi.variant(), seed, [], scenario.parameters)
    record = as_text({**made, "parameters": dict(scenario.parameters)})
    for of_this_run in ("command", "python", "numpy", "scipy"):
        del record[of_this_run]
    ambient = {"ambient": path.stem, "ambient_sha256": scene_sha256(path)}
    return {**ambient, "target": f"{target:g}", **record}
