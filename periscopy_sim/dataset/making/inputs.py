"""What a data set's samples depend on: the files it names, found and told by their contents."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from periscopy_sim.dataset.archive.layout import KIND, Layout
from periscopy_sim.dataset.configuration.document import Configuration
from periscopy_sim.dataset.configuration.hidden_sources import Folder, pictures_in
from periscopy_sim.dataset.configuration.light_sources import Conditions, Pictures
from periscopy_sim.dataset.making.draws import GeometryDraw
from periscopy_sim.dataset.making.geometry import found_scene
from periscopy_sim.errors import ConfigurationError


def resolved(configuration: Configuration) -> Configuration:
    """Make every path absolute, and check that what it names exists."""
    from periscopy_sim.storage.ambient_library import find_condition
    from periscopy_sim.storage.outputs.provenance import scene_sha256

    folder = configuration.folder

    def beside(name: str) -> str:
        return str((folder / name).resolve())

    def condition(name: str) -> str:
        return beside(name) if (folder / name).is_file() else name

    hidden = []
    for source in configuration.hidden_images:
        if isinstance(source, Folder):
            pictures_in.cache_clear()
            place = beside(source.folder)
            version = _sha256(pictures_in(place))
            source = source.model_copy(update={"folder": place, "version": version})
        hidden.append(source)
    ambient = []
    for light in configuration.ambient:
        if isinstance(light, Conditions):
            light = light.model_copy(update={"names": tuple(map(condition, light.names))})
            for name in light.names:
                find_condition(name)
        elif isinstance(light, Pictures):
            light = light.model_copy(update={"files": tuple(map(beside, light.files))})
        ambient.append(light)
    scenes = []
    for scene in configuration.scenes:
        path = found_scene(configuration, scene.scene).resolve()
        version = scene_sha256(path)
        scenes.append(scene.model_copy(update={"scene": str(path), "version": version}))
    return configuration.model_copy(
        update={
            "scenes": tuple(scenes), "hidden_images": tuple(hidden), "ambient": tuple(ambient)
        }
    )  # fmt: skip


def attributes_of(settings: Configuration, layout: Layout) -> dict[str, Any]:
    """Return all that the samples depend on, ready for JSON; where files lie does not matter."""
    import mitsuba as mi

    from periscopy_sim.storage.ambient_library import find_condition
    from periscopy_sim.storage.outputs.provenance import provenance, scene_sha256

    record = provenance(None, mi.variant(), settings.seed, [])
    versions = {
        name: record[name] for name in ("periscopy-sim", "numpy", "mitsuba", "drjit", "variant")
    }
    entries = settings.model_dump(mode="json", exclude={"count", "folder"})
    for entry, scene in zip(entries["scenes"], settings.scenes, strict=True):
        entry["scene"] = Path(scene.scene).stem
    for entry, source in zip(entries["hidden_images"], settings.hidden_images, strict=True):
        if isinstance(source, Folder):
            entry["folder"] = Path(source.folder).name
    for entry, light in zip(entries["ambient"], settings.ambient, strict=True):
        if isinstance(light, Conditions):
            entry["names"] = [Path(name).stem for name in light.names]
            entry["sha256"] = [scene_sha256(find_condition(name)) for name in light.names]
        elif isinstance(light, Pictures):
            entry["files"] = [Path(name).name for name in light.files]
            entry["sha256"] = _sha256(map(Path, light.files))
    return {
        "kind": KIND,
        "configuration": entries,
        "layout": {
            "block": layout.block_size,
            "photograph_shape": list(layout.photograph_shape),
            "hidden_shape": list(layout.hidden_shape),
            "photograph_type": layout.photograph_type,
            "keep_background": layout.keep_background,
        },
        "versions": versions,
    }


def _sha256(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        try:
            with file.open("rb") as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
        except OSError as error:
            raise ConfigurationError(f"{file}: {error.strerror}; check the path") from error
    return digest.hexdigest()


def labels_of(
    settings: Configuration, draws: Sequence[GeometryDraw]
) -> dict[str, tuple[str, list[Any]]]:
    """Return dimension and values of what is known before any sample is made.

    That is each geometry's scene, split and parameters, and the channels' names.
    """
    variables: dict[str, list[Any]] = {
        "geometry_scene": [Path(settings.scenes[draw.source].scene).stem for draw in draws],
        "geometry_split": [draw.split for draw in draws],
    }
    for name in sorted({name for scene in settings.scenes for name in scene.parameters}):
        texts = [draw.parameters.get(name, "") for draw in draws]
        variables[f"parameter_{name}"] = _numbers(texts) or texts
    of_geometries = {name: ("geometries", values) for name, values in variables.items()}
    return {**of_geometries, "channel": ("channel", ["red", "green", "blue"])}


def _numbers(texts: list[str]) -> list[float] | None:
    """Read numbers, NaN where there is none; None if a text is something else."""
    try:
        return [float(text or "nan") for text in texts]
    except ValueError:
        return None
