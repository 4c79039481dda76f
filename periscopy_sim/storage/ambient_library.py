"""Photographs of ambient light kept in a folder, each rendered once."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC, find_scene
from periscopy_sim.storage.formats.exr import read_exr, write_exr
from periscopy_sim.storage.outputs.places import local_copy
from periscopy_sim.storage.outputs.provenance import as_text, provenance, scene_sha256
from periscopy_sim.storage.outputs.resume import check_settings
from periscopy_sim.storage.outputs.staging import staged_file

Progress = Callable[[str], AbstractContextManager[Callable[[float], None]]]
"""Receives the name of a rendering, and gives the function that reports its fraction done."""

CONDITIONS = (*REALISTIC, *ADVERSARIAL)


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
    from periscopy_sim.rendering.ambient.background import render_background

    paths = {Path(name).stem: find_condition(name) for name in names}
    if len(paths) < len(names):
        raise PeriscopyError(f"an ambient condition is given twice in {', '.join(names)}")
    photographs = {}
    origin = {**provenance(scenario.document, seed), "target": f"{target:g}"}
    for of_this_run in ("command", "python", "numpy", "scipy"):
        del origin[of_this_run]
    for name, path in paths.items():
        file = folder / f"{name}.exr"
        digest = scene_sha256(path)
        settings = as_text({**origin, "ambient": name, "ambient_sha256": digest})
        if not file.is_file():
            with staged_file(file) as staged, progress(f"ambient light: {name}") as report:
                rendered = render_background(
                    path, scenario, target=target, seed=seed, progress=report
                )
                report(1.0)  # an interrupt may have stopped Mitsuba in the midst of it
                # To six digits: beyond those, results depend on the order in which BLAS adds.
                errors = {
                    each: float(f"{getattr(rendered, each):.6g}")
                    for each in ("relative_error", "brightness_error")
                }
                write_exr(staged, rendered.photograph, {**settings, **errors})
        # Also what was just rendered: as kept, so that a later run computes the same.
        with local_copy(file) as copy:
            picture, metadata = read_exr(copy)
        del settings["scene"]  # wherever it lies: it has a digest
        check_settings({n: metadata.get(n) for n in settings}, settings, f"{file}:", "photograph")
        photographs[name] = picture.astype(np.float64)
    return photographs


def find_condition(name: str) -> Path:
    """Return the file of a shipped condition, or the scene file named."""
    if name in CONDITIONS:
        return find_scene(f"ambient/{name}")
    if Path(name).suffix == ".xml" and Path(name).is_file():
        return Path(name)
    guess = did_you_mean(name, CONDITIONS) or f"there are {', '.join(CONDITIONS)}."
    raise PeriscopyError(f"no ambient condition '{name}'; {guess} Or name a Mitsuba XML file")
