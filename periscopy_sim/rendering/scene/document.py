"""The XML of a scene file, read before Mitsuba reads it: its defaults, and what would never end."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

from periscopy_sim.errors import SceneError

MOST_FILES = 100
"""Files that a scene may include, each counted as often as it is included."""

DEEPEST = 100
"""Nodes within nodes. Mitsuba descends by recursion, and a stack ends."""


def declared_defaults(path: Path) -> dict[str, str]:
    """List the ``<default>``s of a scene file and of the files it includes.

    Parameters
    ----------
    path
        The scene file.

    Returns
    -------
    dict
        Name to default value.

    Raises
    ------
    SceneError
        If a file does not exist, is not XML, is nested too deeply, or includes too many files.
    """
    defaults: dict[str, str] = {}
    for count, document in enumerate(_documents(path, path, ())):
        if count > MOST_FILES:
            raise SceneError(f"scene '{path}' includes more than {MOST_FILES} files; merge some")
        for element in document.iter("default"):
            # The first one counts: so it is with Mitsuba.
            defaults.setdefault(element.get("name", ""), element.get("value", ""))
    return defaults


def parsed(path: Path) -> ET.Element:
    """Parse an XML file.

    Raises
    ------
    SceneError
        If it does not exist, is not XML, or is nested too deeply.
    """
    if not path.is_file():
        raise SceneError(f"no scene file at '{path}'")
    root: ET.Element | None = None
    depth = 0
    try:
        for event, element in ET.iterparse(path, ("start", "end")):
            root = element if root is None else root
            depth += 1 if event == "start" else -1
            if depth > DEEPEST:
                raise SceneError(f"scene '{path}' nests more than {DEEPEST} nodes; flatten it")
    except SceneError:
        raise
    except (ET.ParseError, LookupError, ValueError) as error:
        raise SceneError(f"scene '{path}' is not well-formed XML: {error}") from None
    assert root is not None
    return root


def _documents(path: Path, scene: Path, including: tuple[Path, ...]) -> Iterator[ET.Element]:
    """Yield a document and those that it includes, once for each inclusion."""
    document = parsed(path)
    yield document
    for element in document.iter("include"):
        included = path.parent / element.get("filename", "")
        if exists(included):
            if included.resolve() in (*including, path.resolve()):
                raise SceneError(f"scene '{scene}': '{included.name}' includes itself; mend that")
            yield from _documents(included, scene, (*including, path.resolve()))


def exists(path: Path) -> bool:
    """Tell whether a name in a scene is that of a file; no file system has some names."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False
