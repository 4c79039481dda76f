"""A scene file with other defaults: its text is kept, comments and all."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr, unescape

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import read_document

_TAG = re.compile(r"<!--.*?-->|<(?:\"[^\"]*\"|'[^']*'|[^>\"'])*>", re.DOTALL)
_ATTRIBUTE = re.compile(r"([\w:.-]+)\s*=\s*(\"[^\"]*\"|'[^']*')")


def write_copy(path: Path, values: Mapping[str, str], copy: Path, remark: str = "") -> None:
    """Write a scene with other defaults, see `with_defaults`, to where it names the same files.

    A remark becomes the first comment in it.

    Raises
    ------
    SceneError
        As `with_defaults`, or if a file beside the copy would be taken for one of the scene's.
    """
    copy.write_text(with_defaults(path, values, copy.parent, remark), encoding="utf-8")
    ours = [file.resolve() for file in read_document(copy).files[1:]]
    theirs = [file.resolve() for file in read_document(path, values).files[1:]]
    if ours != theirs:
        other = next((file for file in ours if file not in theirs), None)
        raise SceneError(f"scene '{copy}' would take '{other}' for a file of '{path}'")


def with_defaults(path: Path, values: Mapping[str, str], folder: Path, remark: str = "") -> str:
    """Return the text of a scene file, UTF-8, with other values of its ``<default>``s, by name.

    One that only an included file declares is declared before it. `folder` is where the text will
    lie: if the scene names files and lies elsewhere, a ``<path>`` to its folder is added, relative
    where that lies below, else absolute. A remark is added as a comment. A SceneError says that
    the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise SceneError(f"scene '{path}' is not UTF-8; save it as that") from None
    missing = dict(values)

    def rewritten(match: re.Match[str]) -> str:
        tag = match[0]
        name = _attribute(tag, "name") or ""
        if not tag.startswith("<default") or name not in values:
            return tag
        missing.pop(name, None)
        value = next(found for found in _ATTRIBUTE.finditer(tag) if found[1] == "value")
        return tag[: value.start(2)] + quoteattr(values[name]) + tag[value.end(2) :]

    copied = _TAG.sub(rewritten, text)
    added = [
        f"<default name={quoteattr(name)} value={quoteattr(value)}/>"
        for name, value in missing.items()
    ]
    home, folder = path.parent.resolve(), folder.resolve()
    if home != folder and len(read_document(path, values).files) > 1:
        # Forward slashes, which all systems take: a scene may travel.
        place = (home.relative_to(folder) if home.is_relative_to(folder) else home).as_posix()
        dollars_escaped = place.replace("$", "\\$")
        added.insert(0, f"<path value={quoteattr(dollars_escaped)}/>")
    if remark:
        added.insert(0, f"<!-- {re.sub('-(?=-)', '- ', remark)} -->")
    root = next((m for m in _TAG.finditer(copied) if m[0].startswith("<scene")), None)
    end = len(copied) if root is None else root.end()
    return copied[:end] + "".join(f"\n    {tag}" for tag in added) + copied[end:]


def tags(text: str) -> Iterator[tuple[re.Match[str], str, dict[str, str]]]:
    """Yield the tags of an XML text, comments left out: each match, its name and its attributes."""
    for match in _TAG.finditer(text):
        name = re.match(r"</?([\w:.-]+)", match[0])
        if name is not None:
            found = {attribute[1] for attribute in _ATTRIBUTE.finditer(match[0])}
            yield match, name[1], {each: _attribute(match[0], each) or "" for each in found}


def _attribute(tag: str, name: str) -> str | None:
    found = next((m for m in _ATTRIBUTE.finditer(tag) if m[1] == name), None)
    return None if found is None else unescape(found[2][1:-1], {"&quot;": '"', "&apos;": "'"})
