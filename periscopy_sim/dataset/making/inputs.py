"""What a data set's samples depend on: the files it names, found and told by their contents."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from periscopy_sim.dataset.archive.layout import BOUNCED_ERROR, KIND, Layout
from periscopy_sim.dataset.configuration.distributions import Source
from periscopy_sim.dataset.configuration.document import Configuration, SceneSource
from periscopy_sim.dataset.configuration.hidden_sources import Folder, pictures_in
from periscopy_sim.dataset.configuration.light_sources import Conditions, Pictures
from periscopy_sim.dataset.making.draws import GeometryDraw
from periscopy_sim.dataset.making.geometry import found_scene
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.storage.ambient_library import find_condition
from periscopy_sim.storage.outputs.provenance import provenance, scene_sha256

SOURCES = ("hidden_images", "ambient", "scenes")
"""Entries of a configuration that may name files."""


def resolved(configuration: Configuration) -> Configuration:
    """Make every path absolute, and check that what it names exists."""
    folder = configuration.folder

    def beside(name: str) -> str:
        return str((folder / name).resolve())

    def found(source: Source) -> Source:
        entries: dict[str, Any] = {}
        if isinstance(source, Folder):
            pictures_in.cache_clear()
            place = beside(source.folder)
            entries = {"folder": place, "version": _sha256(pictures_in(place))}
        elif isinstance(source, Conditions):
            names = [beside(name) if (folder / name).is_file() else name for name in source.names]
            for name in names:
                find_condition(name)
            entries = {"names": tuple(names)}
        elif isinstance(source, Pictures):
            entries = {"files": tuple(map(beside, source.files))}
        elif isinstance(source, SceneSource):
            path = found_scene(configuration, source.scene).resolve()
            entries = {"scene": str(path), "version": scene_sha256(path)}
        return source.model_copy(update=entries)

    sources = {name: tuple(map(found, getattr(configuration, name))) for name in SOURCES}
    return configuration.model_copy(update=sources)


def attributes_of(settings: Configuration, layout: Layout) -> dict[str, Any]:
    """Return all that the samples depend on, ready for JSON; where files lie does not matter."""
    import mitsuba as mi

    record = provenance(None, mi.variant(), settings.seed, [])
    versions = {
        name: record[name] for name in ("periscopy-sim", "numpy", "mitsuba", "drjit", "variant")
    }
    entries = settings.model_dump(mode="json", exclude={"count", "folder"})
    for name in SOURCES:
        for entry, source in zip(entries[name], getattr(settings, name), strict=True):
            entry |= _told_by_contents(source)
    return {
        "kind": KIND,
        "configuration": entries,
        "layout": {
            "block": layout.block_size,
            "photograph_shape": list(layout.photograph_shape),
            "hidden_shape": list(layout.hidden_shape),
            "photograph_type": layout.photograph_type,
            "keep_background": layout.keep_background,
            # Not said where it is not: data sets that are older go on.
            **({BOUNCED_ERROR: True} if layout.bounced_error else {}),
        },
        "versions": versions,
    }


def _told_by_contents(source: Source) -> dict[str, Any]:
    """Return the entries of a source that name files, without their places."""
    if isinstance(source, SceneSource):
        return {"scene": Path(source.scene).stem}
    if isinstance(source, Folder):
        return {"folder": Path(source.folder).name}
    if isinstance(source, Conditions):
        digests = [scene_sha256(find_condition(name)) for name in source.names]
        return {"names": [Path(name).stem for name in source.names], "sha256": digests}
    if isinstance(source, Pictures):
        files = [Path(name) for name in source.files]
        return {"files": [file.name for file in files], "sha256": _sha256(files)}
    return {}


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
        try:  # numbers, NaN where there is none
            variables[f"parameter_{name}"] = [float(text or "nan") for text in texts]
        except ValueError:
            variables[f"parameter_{name}"] = texts
    of_geometries = {name: ("geometries", values) for name, values in variables.items()}
    return {**of_geometries, "channel": ("channel", ["red", "green", "blue"])}
