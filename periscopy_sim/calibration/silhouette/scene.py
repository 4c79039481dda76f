"""A scene file with the mesh of a silhouette in the place of a shape."""

from pathlib import Path

import numpy as np

from periscopy_sim.calibration.calibrated_scene import (
    element,
    prepend,
    with_defaults,
    write_document,
)
from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.calibration.silhouette.plane import Cells, MaskPlane
from periscopy_sim.calibration.silhouette.result import Silhouette
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import literal
from periscopy_sim.rendering.scene.mesh_formats import TriangleMesh, write_ply
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.scene import CALIBRATED, SceneDocument

_OWN = ("string", "float", "integer", "boolean", "point", "vector", "rgb", "spectrum")
"""Tags that are a shape's numbers; its place and its material are others."""


def write_masked_scene(
    scene: SceneDocument,
    solution: Silhouette,
    copy: Path,
    mesh: Path,
    mesh_name: str,
    remark: str = "",
) -> None:
    """Write a scene with the values given and a flat mesh in the place of a shape.

    The mesh is written in the shape's own coordinates, so that the parameters that move the shape
    move it, and has the shape's id and material. In the scene its file is called `mesh_name`, which
    it has once both are in their place. If the silhouette is not trusted, the scene carries
    that, see `SceneCovariance`. For the rest see `with_defaults`.

    Raises
    ------
    SceneError
        As `with_defaults`, or if the shape's tag is not in the file itself.
    """
    name = solution.name
    to_world = SceneNodes(scene.path, scene.given).layout().places[name]
    whole = cell_mesh(solution.plane, solution.opaque)
    vertices = (whole.vertices - to_world[:3, 3]) @ np.linalg.pinv(to_world[:3, :3]).T
    write_ply(mesh, TriangleMesh(vertices, whole.faces))
    doubted = SceneCovariance((), np.empty(0), np.empty((0, 0)), False, np.empty(0))
    values = {CALIBRATED: doubted.text()} if solution.doubts else {}
    document = with_defaults(scene, values, copy.parent, remark)
    shapes = document.getElementsByTagName("shape")
    shape = next((each for each in shapes if each.getAttribute("id") == name), None)
    if shape is None:
        raise SceneError(
            f"scene '{scene.path}': the shape '{name}' is not written in this file itself; copy it "
            "there from the file that is included"
        )
    shape.setAttribute("type", "ply")
    for child in list(shape.childNodes):
        if child.nodeName in _OWN:
            shape.removeChild(child)
    file = element(document, "string", name="filename", value=literal(mesh_name))
    normals = element(document, "boolean", name="face_normals", value="true")
    prepend(document, shape, [file, normals])
    write_document(document, copy)


def cell_mesh(plane: MaskPlane, opaque: Cells) -> TriangleMesh:
    """Return a mesh, in the scene's coordinates, of a rectangle's opaque cells, (rows, columns).

    Each row's runs of opaque cells are rectangles that share no vertex: each is convex, as closed
    forms ask for.
    """
    steps = np.diff(opaque.astype(int), axis=1, prepend=0, append=0)
    row, left = np.nonzero(steps > 0)
    _, right = np.nonzero(steps < 0)
    ends = np.stack([left, row, right, row, right, row + 1, left, row + 1], axis=-1)
    vertices = plane.points(ends.reshape(-1, 2) / opaque.shape[::-1])
    faces = 4 * np.arange(len(row))[:, None, None] + np.array([[0, 2, 1], [0, 3, 2]])
    return TriangleMesh(vertices, faces.reshape(-1, 3))
