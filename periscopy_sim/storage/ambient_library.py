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
"""Takes what is being rendered, gives what the fraction done is reported to."""


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
    """Return photographs of a wall under ambient conditions; what the folder lacks is rendered.

    `names` are shipped conditions or paths of scene files. Each photograph, (rows, columns, 3)
    radiance, lies in the folder, or will, as ``NAME.exr``. `target` is the relative error of a
    pixel, see `render_background`; `progress` is called with each condition that is rendered. A
    name that is unknown or given twice, or a file made otherwise, is a `PeriscopyError`.
    """
    paths = {Path(name).stem: find_condition(name) for name in names}
    if len(paths) < len(names):
        raise PeriscopyError(f"an ambient condition is given twice in {', '.join(names)}")
    photographs = {}
    for name, path in paths.items():
        file, settings = folder / f"{name}.exr", _settings(path, scenario, seed, target)
        picture, held = rendered_once(file, path, scenario, seed, target, progress, settings)
        _check(file, picture, held, scenario, settings)
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
    """Return the photograph that a file holds, with its metadata; without a file it is rendered.

    With `settings`, these and the errors of the photograph become the file's metadata.
    """
    from periscopy_sim.rendering.ambient.background import render_background

    if not file.is_file():
        with staged_file(file) as staged, progress(f"ambient light: {path.stem}") as report:
            found = render_background(path, scenario, target=target, seed=seed, progress=report)
            report(1.0)  # who interrupts may have stopped Mitsuba in the midst of it
            # To six digits: beyond those lies in which order BLAS has added this time.
            errors = {
                name: float(f"{getattr(found, name):.6g}")
                for name in ("relative_error", "brightness_error")
            }
            write_exr(staged, found.photograph, {**settings, **errors} if settings else {})
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
    """Return what a picture depends on; the scenario's hidden size is not of it."""
    import mitsuba as mi

    made = provenance(scenario.path, mi.variant(), seed, [], scenario.parameters)
    record = as_text({**made, "parameters": dict(scenario.parameters)})
    for of_this_run in ("command", "python", "numpy", "scipy"):
        del record[of_this_run]
    ambient = {"ambient": path.stem, "ambient_sha256": scene_sha256(path)}
    return {**ambient, "target": f"{target:g}", **record}


def _check(
    file: Path,
    picture: NDArray[np.float32],
    held: Mapping[str, str | float],
    scenario: Scenario,
    settings: Mapping[str, str],
) -> None:
    """Refuse a picture that was made otherwise."""
    rows, columns = scenario.photograph_shape
    if picture.shape[:2] != (rows, columns):
        raise PeriscopyError(
            f"{file}: has {picture.shape[0]}x{picture.shape[1]} pixels, the scene's camera "
            f"{rows}x{columns}; name another folder or remove it"
        )
    for key, value in settings.items():
        # The digest tells the scene, wherever it lies.
        if key != "scene" and held.get(key) != value:
            raise PeriscopyError(
                f"{file}: was made otherwise ({key} {held.get(key)}, here {value}); name another "
                "folder or remove it"
            )
