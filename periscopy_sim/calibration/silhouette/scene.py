"""A scene file with the mesh of a silhouette in the place of a shape."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from periscopy_sim.calibration.calibrated_scene import tags, with_defaults
from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.calibration.silhouette.plane import Cells, MaskPlane
from periscopy_sim.calibration.silhouette.result import Silhouette
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import CALIBRATED
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.scene.mesh_formats import TriangleMesh, write_ply
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.scenario import Array

_OWN = ("string", "float", "integer", "boolean", "point", "vector", "rgb", "spectrum")
"""Tags that are a shape's numbers; its place and its material are others."""


def write_masked_scene(
    path: Path,
    solution: Silhouette,
    values: Mapping[str, str],
    copy: Path,
    mesh: Path,
    mesh_name: str,
    remark: str = "",
) -> None:
    """Write a scene with values of its defaults and a flat mesh in the place of a shape.

    The mesh is written in the shape's own coordinates, so that the parameters that move the shape
    move it. In the scene its file is called `mesh_name`, which it has once both are in their place.
    If the silhouette is not to be trusted, the scene carries that, see `SceneCovariance`.

    Raises
    ------
    SceneError
        As `with_mesh`, or if the scene does not load from where it is written.
    """
    to_local = local_coordinates(path, solution.name, values)
    whole = cell_mesh(solution.plane, solution.opaque)
    vertices = whole.vertices @ to_local[:3, :3].T + to_local[:3, 3]
    write_ply(mesh, TriangleMesh(vertices, whole.faces))

    doubted = SceneCovariance((), np.empty(0), np.empty((0, 0)), False, np.empty(0))
    defaults = {**values, **({CALIBRATED: doubted.text()} if solution.doubts else {})}

    def write(name: str) -> None:
        text = with_mesh(path, solution.name, name, defaults, copy.parent, remark)
        copy.write_text(text, encoding="utf-8")

    write(mesh.name)
    load_scenario(copy, (1, 1))
    write(mesh_name)


def local_coordinates(path: Path, name: str, values: Mapping[str, str]) -> Array:
    """Return the matrix, (4, 4), from a scene's coordinates to a shape's own.

    A SceneError says that the shape is flattened, so that no other can take its place.
    """
    _, to_world = SceneNodes(path, values).plugin_and_place(name)
    try:
        return np.asarray(np.linalg.inv(to_world))
    except np.linalg.LinAlgError:
        raise SceneError(
            f"scene '{path}': the to_world of '{name}' scales it to nothing along an axis; make it "
            "a rectangle"
        ) from None


def with_mesh(
    path: Path,
    name: str,
    mesh: str,
    values: Mapping[str, str],
    folder: Path,
    remark: str = "",
) -> str:
    """Return the text of a scene file with a mesh in the place of the shape of a name.

    The mesh, a file's name as seen from `folder`, stands in the shape's own coordinates: the
    shape's id, ``to_world`` and material are kept. For the rest see `with_defaults`.

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


def cell_mesh(plane: MaskPlane, opaque: Cells) -> TriangleMesh:
    """Return a mesh, in the scene's coordinates, of a rectangle's opaque cells, (rows, columns).

    No two of its rectangles share a vertex: each is convex, as closed forms ask for.
    """
    rows, columns = opaque.shape
    quads = [
        plane.points(
            np.array([[left, top], [right, top], [right, bottom], [left, bottom]]) / [columns, rows]
        )
        for top, bottom, left, right in rectangles(opaque)
    ]
    faces = [np.array([[0, 2, 1], [0, 3, 2]]) + 4 * k for k in range(len(quads))]
    return TriangleMesh(np.concatenate(quads), np.concatenate(faces))


def rectangles(opaque: Cells) -> list[tuple[int, int, int, int]]:
    """Return rectangles that cover the opaque cells, each once: top, bottom, left, right.

    Each begins at the first cell that none covers yet, and grows to the right, then down.
    """
    uncovered = opaque.copy()
    covering = []
    while uncovered.any():
        top, left = (int(n) for n in np.argwhere(uncovered)[0])
        right = left + _run(uncovered[top, left:])
        bottom = top + _run(uncovered[top:, left:right].all(axis=1))
        uncovered[top:bottom, left:right] = False
        covering.append((top, bottom, left, right))
    return covering


def _run(opaque: Any) -> int:
    """Return how many cells, (n,), there are before the first that is open."""
    return len(opaque) if opaque.all() else int(np.argmin(opaque))
