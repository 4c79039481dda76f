"""A scene in which a silhouette that was found takes the place of the shape that it is of."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.calibration.silhouette.cells.cell_mesh import cell_mesh
from periscopy_sim.calibration.silhouette.replaced_shape import with_mesh
from periscopy_sim.calibration.silhouette.result import Silhouette
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import CALIBRATED
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.scene.mesh_formats import TriangleMesh, write_ply
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.scenario import Array


def write_masked_scene(
    path: Path,
    found: Silhouette,
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
    to_local = local_coordinates(path, found.name, values)
    whole = cell_mesh(found.plane, found.opaque)
    vertices = whole.vertices @ to_local[:3, :3].T + to_local[:3, 3]
    write_ply(mesh, TriangleMesh(vertices, whole.faces))

    doubted = SceneCovariance((), np.empty(0), np.empty((0, 0)), False, np.empty(0))
    told = {**values, **({CALIBRATED: doubted.text()} if found.doubts else {})}

    def write(name: str) -> None:
        text = with_mesh(path, found.name, name, told, copy.parent, remark)
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
