"""Photographs of ambient light, each rendered once for a wall and kept in the user's cache."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.geometry import Geometry
from periscopy_sim.measurement import TARGET
from periscopy_sim.numerics.validation import is_name
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC, find_scene
from periscopy_sim.storage.formats.exr import read_exr, write_exr
from periscopy_sim.storage.outputs.places import local_copy, user_cache
from periscopy_sim.storage.outputs.provenance import (
    array_sha256,
    as_text,
    provenance,
    scene_sha256,
    sha256_of,
)
from periscopy_sim.storage.outputs.resume import check_settings
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    from periscopy_sim.rendering.ambient.background import Background

Progress = Callable[[str], AbstractContextManager[Callable[[float], None]]]
"""Receives the name of a rendering, and gives the function that reports its fraction done."""

CONDITIONS = (*REALISTIC, *ADVERSARIAL)

CACHE_BYTES = 1 << 28
"""Bytes of light that the user's cache keeps: some 1,500 photographs of 126 x 126 pixels."""


ERRORS = "relative_error", "brightness_error"
"""Errors of a photograph, see `periscopy_sim.rendering.ambient.background.Background`."""


def silent(_: str) -> AbstractContextManager[Callable[[float], None]]:
    """Show no progress."""
    return nullcontext(lambda _: None)


def ambient_photographs(
    names: Sequence[str],
    scenario: Geometry,
    folder: Path,
    seed: int,
    *,
    target: float = TARGET,
    progress: Progress = silent,
) -> "dict[str, Background]":
    """Return photographs of a wall under ambient conditions, of a folder that keeps them.

    `names` are shipped conditions or paths of scene files. The folder gets each photograph that it
    lacks, (rows, columns, 3) radiance, from `ambient_light`, as ``NAME.exr``. A name that is
    unknown or given twice, or a file of other settings, is a `PeriscopyError`.
    """
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
            light = ambient_light(path, scenario, seed, target=target, progress=progress)
            errors = {name: getattr(light, name) for name in ERRORS}
            with staged_file(file) as staged:
                write_exr(staged, light.photograph, {**settings, **errors})
        # Also what was just rendered: as kept, so that a later run computes the same.
        with local_copy(file) as copy:
            picture, metadata = read_exr(copy)
        del settings["scene"]  # wherever it lies: it has a digest
        check_settings({n: metadata.get(n) for n in settings}, settings, f"{file}:", "photograph")
        photographs[name] = _background(picture, metadata)
    return photographs


def missing_photographs(
    names: Sequence[str], scenario: Geometry, folder: Path, seed: int, target: float = TARGET
) -> dict[Path, str]:
    """Return the conditions that `ambient_photographs` renders, by their files of the cache."""
    missing = (name for name in names if not (folder / f"{Path(name).stem}.exr").is_file())
    files = {cached_light(find_condition(n), scenario, seed, target): n for n in missing}
    return {file: name for file, name in files.items() if not file.is_file()}


def _background(picture: NDArray[np.float32], metadata: Mapping[str, str | float]) -> "Background":
    """Return a photograph with its errors, as a file has them."""
    from periscopy_sim.rendering.ambient.background import Background

    errors = (float(metadata[name]) for name in ERRORS)
    return Background(picture.astype(np.float64), *errors)


def ambient_light(
    path: Path,
    scenario: Geometry,
    seed: int,
    *,
    target: float = TARGET,
    progress: Progress = silent,
) -> "Background":
    """Return a wall under the light of a condition: of the user's cache, or rendered.

    Scenes whose cameras see the same wall share the cache. `target` is the relative error of a
    pixel, see `render_background`; `progress` is called with what is rendered. Where the cache
    cannot be written, all is rendered.
    """
    from periscopy_sim.rendering.ambient.background import render_background

    file = cached_light(path, scenario, seed, target)
    if file.is_file():
        with suppress(PeriscopyError, OSError):  # damaged, or removed by another process
            picture, metadata = read_exr(file)
            file.touch()  # the latest is removed last
            return _background(picture, metadata)
    with progress(f"ambient light: {path.stem}") as report:
        rendered = render_background(path, scenario, target=target, seed=seed, progress=report)
        report(1.0)  # an interrupt may have stopped Mitsuba in the midst of it
    # To six digits: beyond those, results depend on the order in which BLAS adds.
    errors = {each: float(f"{getattr(rendered, each):.6g}") for each in ERRORS}
    with suppress(PeriscopyError, OSError):
        write_exr(file, rendered.photograph, errors)
        _remove_oldest(file.parent.glob("*.exr"))
    return _background(rendered.photograph.astype(np.float32), errors)


def cached_light(path: Path, scenario: Geometry, seed: int, target: float = TARGET) -> Path:
    """Return the cache's file of a condition; its name is the digest of all that it depends on."""
    view, versions = scenario.view, provenance(None, seed)
    seen = (getattr(view, each.name) for each in fields(view))
    record = {
        "wall": [array_sha256(each) for each in seen if isinstance(each, np.ndarray)],
        "shape": view.shape,
        "ambient": scene_sha256(path),
        "target": target,
        "renderer": _renderer_sha256(),
        **{name: versions[name] for name in ("mitsuba", "drjit", "variant", "seed")},
    }
    digest = hashlib.sha256(json.dumps(record).encode()).hexdigest()
    return user_cache() / "ambient" / f"{digest}.exr"


@cache
def _renderer_sha256() -> str:
    """Return the digest of the code that renders; it changes more often than its version."""
    from periscopy_sim import rendering

    return sha256_of(sorted(Path(rendering.__file__).parent.rglob("*.py")))


def _remove_oldest(files: Iterable[Path]) -> None:
    """Remove the files that were not used for the longest time, beyond `CACHE_BYTES`."""
    left = CACHE_BYTES
    states = [(file.stat(), file) for file in files]
    for state, file in sorted(states, key=lambda each: each[0].st_mtime_ns, reverse=True):
        left -= state.st_size
        if left < 0:
            file.unlink(missing_ok=True)


def is_photograph(light: Any) -> bool:
    """Return whether light is a photograph, or its file, rather than a condition's name."""
    return not is_name(light) or (Path(light).suffix != ".xml" and Path(light).is_file())


def find_condition(name: str) -> Path:
    """Return the file of a shipped condition, or the scene file named."""
    if name in CONDITIONS:
        return find_scene(f"ambient/{name}")
    if Path(name).suffix == ".xml" and Path(name).is_file():
        return Path(name)
    guess = did_you_mean(name, CONDITIONS) or f"there are {', '.join(CONDITIONS)}."
    raise PeriscopyError(f"no ambient condition '{name}'; {guess} Or name a Mitsuba XML file")
