"""A scene file with a mesh in the place of one of its shapes: all else of its text is kept."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

from periscopy_sim.calibration.calibrated_scene import tags, with_defaults
from periscopy_sim.errors import SceneError

_OWN = ("string", "float", "integer", "boolean", "point", "vector", "rgb", "spectrum")
"""Tags that are a shape's numbers; its place and its material are others."""


def with_mesh(
    path: Path,
    name: str,
    mesh: str | None,
    values: Mapping[str, str],
    folder: Path,
    remark: str = "",
) -> str:
    """Return the text of a scene file with a mesh in the place of the shape of a name.

    The mesh, a file's name as seen from `folder`, stands in the shape's own coordinates: the
    shape's id, ``to_world`` and material are kept. None leaves the shape out. For the rest see
    `with_defaults`.

    Raises
    ------
    SceneError
        As `with_defaults`, or if the shape's tag is not in the file itself.
    """
    text = with_defaults(path, values, folder, remark)
    start, end, inner = _element(text, name) or (0, 0, [])
    if not end:
        raise SceneError(
            f"scene '{path}': the shape '{name}' is not written in this file itself; copy it there "
            "from the file that is included"
        )
    indent = re.search(r"[^\n]*\Z", text[:start])
    margin = "" if indent is None else re.match(r"\s*", indent[0])[0]  # type: ignore[index]
    if mesh is None:
        return text[:start] + text[end:]
    lines = [
        f'<shape type="ply" id={quoteattr(name)}>',
        f'    <string name="filename" value={quoteattr(mesh)}/>',
        '    <boolean name="face_normals" value="true"/>',
        *("    " + element for element in inner),
        "</shape>",
    ]
    return text[:start] + f"\n{margin}".join(lines) + text[end:]


def _element(text: str, name: str) -> tuple[int, int, list[str]] | None:
    """Return where a shape's element begins and ends, and those in it that are kept; or None."""
    start, depth, opened = -1, 0, 0
    kept: list[str] = []
    for tag, kind, attributes in tags(text):
        closes, empty = tag[0].startswith("</"), tag[0].endswith("/>")
        if start < 0:
            if kind == "shape" and not closes and attributes.get("id") == name:
                if empty:
                    return tag.start(), tag.end(), []
                start = tag.start()
            continue
        if closes:
            depth -= 1
            if depth < 0:
                return start, tag.end(), kept
        elif depth == 0:
            opened = tag.start()
        if (closes or empty) and depth == 0 and kind not in _OWN:
            kept.append(text[opened : tag.end()])
        if not closes and not empty:
            depth += 1
    return None
