"""A scene file parsed by Mitsuba: its parameters known, its files found, its meshes sound."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import RLock
from typing import Any

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import SceneDocument, read_document, undeclared
from periscopy_sim.rendering.scene.mesh_formats import FOREIGN, FORMATS, as_ply
from periscopy_sim.rendering.scene.meshes import check_mesh

OTHER_MESHES = ("gltf", "dae", "fbx", "3ds", "3mf", "step", "stp")
"""Mesh formats that are not read: most of them scatter a mesh over several files."""

RESERVED = ("config", "filename")
"""Names of arguments of Mitsuba's parser, which takes the parameters' values beside them."""

_SEARCH = RLock()
"""Held while Mitsuba's search folders, which the process shares, are a scene's own."""


def parse(path: Path, parameters: Mapping[str, str]) -> tuple[Any, Any]:
    """Return Mitsuba's configuration and state of a scene file, with files by absolute names.

    `mitsuba.parser.instantiate` takes both. A file that is missing or malformed, or a parameter
    that the scene does not declare, is a `SceneError`.
    """
    import mitsuba as mi

    document = read_document(path, parameters)
    for name in parameters:
        if name not in document.defaults:
            raise undeclared(path, name, document.defaults)
        if name in RESERVED:
            raise SceneError(
                f"scene '{path}': Mitsuba takes no value for a parameter named '{name}'; rename "
                "its <default>"
            )
    config = mi.parser.ParserConfig(mi.variant())
    # Merging meshes would lose their ids.
    config.merge_meshes = False
    config.merge_equivalent = False
    if document.errors.keys() & set(parameters):  # no plugin reads what a ruler's errors are
        config.unused_parameters = mi.LogLevel.Debug
    values = {name: str(value) for name, value in parameters.items()}
    try:
        with searching(path.parent):
            state = mi.parser.parse_file(config, str(path), **values)
        mi.parser.transform_all(config, state)
    except (RuntimeError, ValueError) as error:
        reason = one_line(error)
        _, quotes, text = reason.rpartition(' value "')
        given = [f"{name}={value}" for name, value in values.items() if quotes and value in text]
        named = f", given as {' and '.join(given)}" if given else ""
        raise SceneError(f"scene '{path}': {reason}{named}") from None
    if document.missing:  # Mitsuba looks where the process started, too
        raise SceneError(f"scene '{path}' names a missing file '{document.missing[0]}'")
    for node in state.nodes:
        if isinstance(node.props.get("filename"), str):
            # Absolute, since Mitsuba would search other folders, too.
            plugin, file = _file_of(node.props, document, path)
            node.props["filename"] = str(file.resolve())
            node.props.set_plugin_name(plugin)
    return config, state


def _file_of(props: Any, document: SceneDocument, path: Path) -> tuple[str, Path]:
    """Return a plugin and the file that it reads: of a mesh that Mitsuba does not read, a copy."""
    name, plugin = props["filename"], props.plugin_name()
    where = f"scene '{path}': {plugin} '{props.id()}'"
    if plugin in OTHER_MESHES:
        raise SceneError(
            f"{where}: {plugin.upper()} files are not read; save '{name}' as "
            f"{', '.join(map(str.upper, FORMATS))} and name that"
        )
    file = document.find(name)
    if file is None:
        raise SceneError(f"{where} names a missing file '{path.parent / name}'")
    if file.stat().st_size == 0:
        raise SceneError(f"{where} names an empty file '{file}'")
    kind = file.suffix[1:].lower()
    try:
        if plugin in FOREIGN or (plugin in ("ply", "obj") and kind in FOREIGN):
            return "ply", as_ply(file, kind if kind in FORMATS else plugin)
        check_mesh(file, plugin)
    except ValueError as error:
        raise SceneError(f"{where}: the file '{file}' {error}; export it again") from None
    except RuntimeError as error:
        reason = one_line(error).rpartition(f'of type "{plugin}": ')[2].rpartition("Mesh] ")[2]
        raise SceneError(
            f"{where}: the file '{file}' cannot be read ({reason}); export it again"
        ) from None
    return plugin, file


@contextmanager
def searching(*folders: Path) -> Iterator[None]:
    """Let Mitsuba search these folders and its own alone, not the one the process started in.

    Its parser also leaves a scene's ``<path>`` folders behind for every scene that follows.
    """
    import mitsuba as mi

    resolver = mi.file_resolver()
    with _SEARCH:
        before = [str(folder) for folder in resolver]
        _search(resolver, [*map(str, folders), *mi.__path__])
        try:
            yield
        finally:
            _search(resolver, before)


def _search(resolver: Any, folders: list[str]) -> None:
    resolver.clear()
    for folder in folders:
        resolver.append(folder)


def one_line(error: BaseException) -> str:
    """Return Mitsuba's reason without the source file that complains."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    text = " ".join(lines)
    return text.split("] ", 1)[1] if text.startswith("[") and "] " in text else text
