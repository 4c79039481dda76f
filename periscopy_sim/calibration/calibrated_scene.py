"""A scene file with other defaults: its text is kept, comments and all."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr, unescape

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import declared_defaults, exists

_TAG = re.compile(r"<!--.*?-->|<(?:\"[^\"]*\"|'[^']*'|[^>\"'])*>", re.DOTALL)
_ATTRIBUTE = re.compile(r"([\w:.-]+)\s*=\s*(\"[^\"]*\"|'[^']*')")


def with_defaults(path: Path, values: Mapping[str, str], folder: Path) -> str:
    """Write a scene's text anew with other values of its ``<default>``s.

    Parameters
    ----------
    path
        The scene file, UTF-8.
    values
        New values, by name; one that only an included file declares is declared before it.
    folder
        Where the text will lie: files that the scene names beside itself are named from there,
        below it by a relative path, elsewhere by an absolute one; so are those that are the value
        of a parameter.

    Returns
    -------
    str
        The text.

    Raises
    ------
    SceneError
        If the file is not UTF-8, or its defaults cannot be read, see `declared_defaults`.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise SceneError(f"scene '{path}' is not UTF-8; save it as that") from None
    values = {**values, **_files_moved(text, path, values, folder)}
    missing = dict(values)

    def rewritten(match: re.Match[str]) -> str:
        tag = match[0]
        name = _attribute(tag, "name")
        if tag.startswith("<default") and name is not None and name in values:
            missing.pop(name, None)
            return _with_attribute(tag, "value", values[name])
        for attribute, target in _file_names(match[0]):
            beside = path.parent / target
            # A name that begins by a parameter may be a whole path.
            varies = name == "filename" and "$" in target and not target.startswith("$")
            if (exists(beside) or varies) and not Path(target).is_absolute():
                tag = _with_attribute(tag, attribute, _named_from(folder, beside))
        return tag

    copied = _TAG.sub(rewritten, text)
    declared = "".join(
        f"\n    <default name={quoteattr(name)} value={quoteattr(value)}/>"
        for name, value in missing.items()
    )
    root = next((m for m in _TAG.finditer(copied) if m[0].startswith("<scene")), None)
    return copied if root is None else copied[: root.end()] + declared + copied[root.end() :]


def _files_moved(text: str, path: Path, values: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Name from a folder what parameters name beside the scene, where they are a file's name."""
    known = {**declared_defaults(path), **values}
    targets = {target for match in _TAG.finditer(text) for _, target in _file_names(match[0])}
    moved = {
        name: _named_from(folder, path.parent / value)
        for name, value in known.items()
        if f"${name}" in targets and exists(path.parent / value) and not Path(value).is_absolute()
    }
    return {name: value for name, value in moved.items() if value != known[name]}


def _file_names(tag: str) -> Iterator[tuple[str, str]]:
    """Find the attributes of a tag that may name a file."""
    for attribute in ("filename", "value"):
        target = _attribute(tag, attribute)
        if target and (attribute == "filename" or tag.startswith(("<string", "<path"))):
            yield attribute, target


def _attribute(tag: str, name: str) -> str | None:
    found = next((m for m in _ATTRIBUTE.finditer(tag) if m[1] == name), None)
    return None if found is None else unescape(found[2][1:-1], {"&quot;": '"', "&apos;": "'"})


def _with_attribute(tag: str, name: str, value: str) -> str:
    found = next(m for m in _ATTRIBUTE.finditer(tag) if m[1] == name)
    return tag[: found.start(2)] + quoteattr(value) + tag[found.end(2) :]


def _named_from(folder: Path, file: Path) -> str:
    file, folder = file.resolve(), folder.resolve()
    if file.is_relative_to(folder):
        return os.fspath(file.relative_to(folder))
    return os.fspath(file)
