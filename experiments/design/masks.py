"""What the chair could have been: occluders of equal area in the plate's place, as scenes.

The stage is the shipped plate's: its monitor, wall and camera. The plate is a square of 75 mm, and
its stick is left out, as are all feet. Chair and plant are scaled until their silhouettes, seen
from the middle of the monitor to that of the field of view, have the plate's area; random masks
have half of their square's cells opaque, so that the square has twice the plate's area. All are
black, and the middles of all are at the plate's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.calibration.silhouette.scene import with_mesh
from periscopy_sim.rendering.scene.mesh_formats import TriangleMesh, write_ply
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]
Cells = NDArray[np.bool_]

SIDE = 0.075
"""Of the plate, metres."""

CENTRE = np.array([0.5125, 0.570, 0.2515])
"""The plate's middle."""

CELLS = (3, 5, 8, 12)
"""Along each side of a random mask."""

MASKS_EACH = 4
"""Random masks of each number of cells."""

FINE = 400
"""Points along each side of the square in which silhouettes are measured."""


@dataclass(frozen=True)
class Candidate:
    """An occluder: its kind, its name, and its mesh in metres, the wall's y towards the wall."""

    kind: str
    name: str
    mesh: TriangleMesh


def candidates() -> list[Candidate]:
    """Return the plate, the chair, the plant, and random masks."""
    stage = ps.load_scenario("plate", (2, 2), {"resolution": 8})
    found = [
        Candidate("plate", "plate", flat_mesh(np.ones((1, 1), bool))),
        Candidate("chair", "chair", scaled(shape_of("chair", "chair_"), stage)),
        Candidate("plant", "plant", scaled(shape_of("plant", "plant"), stage)),
    ]
    for cells in CELLS:
        for number in range(MASKS_EACH):
            mask = random_mask(cells, number)
            found.append(
                Candidate(f"random {cells} x {cells}", f"{cells}_{number}", flat_mesh(mask))
            )
    return found


def random_mask(cells: int, seed: int) -> Cells:
    """Return cells of which half are opaque; of an odd number one more."""
    count = cells * cells
    opaque = np.random.default_rng([cells, seed]).permutation(count) < -(-count // 2)
    return np.asarray(opaque.reshape(cells, cells))


def flat_mesh(opaque: Cells) -> TriangleMesh:
    """Return opaque cells as squares about `CENTRE`, of the plate's area all together."""
    rows, columns = opaque.shape
    cell = SIDE / np.sqrt(opaque.sum())
    top, left = np.argwhere(opaque).T
    corners = np.array([(0, 0), (0, 1), (1, 1), (1, 0)])
    x = cell * (left[:, None] + corners[:, 0] - columns / 2)
    z = -cell * (top[:, None] + corners[:, 1] - rows / 2)
    vertices = np.stack([x, 0 * x, z], axis=-1).reshape(-1, 3) + CENTRE
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return TriangleMesh(vertices, (4 * np.arange(len(x))[:, None, None] + triangles).reshape(-1, 3))


def shape_of(scene: str, begins: str) -> TriangleMesh:
    """Return the shapes of a shipped scene whose names begin so, as one mesh."""
    shapes = ps.load_scenario(scene, (2, 2)).occluders
    parts = [each for each in shapes if each.name.startswith(begins)]
    vertices, faces, count = [], [], 0
    for part in parts:
        assert part.vertices is not None and part.faces is not None
        vertices.append(part.vertices)
        faces.append(part.faces + count)
        count += len(part.vertices)
    return TriangleMesh(np.concatenate(vertices), np.concatenate(faces))


def scaled(mesh: TriangleMesh, stage: Scenario) -> TriangleMesh:
    """Return a mesh of the plate's area as a silhouette, whose box's middle is at `CENTRE`."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    factor = 1.0
    for _ in range(4):  # nearly exact at once: the view is nearly parallel
        placed = TriangleMesh(CENTRE + factor * (mesh.vertices - middle), mesh.faces)
        factor *= SIDE / float(np.sqrt(silhouette(placed, stage)[1]))
    return TriangleMesh(CENTRE + factor * (mesh.vertices - middle), mesh.faces)


def silhouette(mesh: TriangleMesh, stage: Scenario) -> tuple[Cells, float]:
    """Return where a mesh hides the wall's middle's view of the monitor's, and its area in m².

    It is projected to the plate's plane along the line from the monitor's middle to the wall's.
    """
    way = stage.wall_points.mean(axis=0) - stage.patch_centers.mean(axis=0)
    offset = mesh.vertices - CENTRE
    flat = (offset - offset[:, 1:2] / way[1] * way)[:, [0, 2]]
    half = 1.02 * float(np.abs(flat).max())
    # In points of the grid, rows down.
    points = (flat * (1, -1) / half + 1) * FINE / 2 - 0.5
    inside = np.zeros((FINE, FINE), bool)
    for corners in points[mesh.faces]:
        low = np.maximum(np.ceil(corners.min(axis=0)), 0).astype(int)
        high = np.minimum(np.floor(corners.max(axis=0)), FINE - 1).astype(int) + 1
        if (high <= low).any():
            continue
        x, y = np.arange(low[0], high[0]), np.arange(low[1], high[1])[:, None]
        sides = [
            (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        ]
        within = np.all([s >= 0 for s in sides], axis=0) | np.all([s <= 0 for s in sides], axis=0)
        inside[low[1] : high[1], low[0] : high[0]] |= within
    return inside, float(inside.mean()) * (2 * half) ** 2


def write_scene(candidate: Candidate, folder: Path) -> Path:
    """Write the stage with an occluder in the plate's place; return the scene's file."""
    bare, scene = folder / "bare.xml", folder / f"{candidate.name}.xml"
    _write(bare, with_mesh(ps.find_scene("plate"), "stick", None, {}, folder))
    with staged_file(scene.with_suffix(".ply")) as file:
        write_ply(file, _in_shape(candidate.mesh))
    _write(scene, with_mesh(bare, "plate", f"{candidate.name}.ply", _unit(), folder))
    return scene


def _unit() -> Mapping[str, str]:
    """Values of the plate's sizes for which its own coordinates are metres, but along y."""
    return {"plate_width": "2", "plate_height": "2"}


def _in_shape(mesh: TriangleMesh) -> TriangleMesh:
    """Return a mesh in the coordinates of the plate's cube: x and z in metres about its foot."""
    foot = np.array([0.5125, 0.570, 0.214])
    # The cube is lifted by 1, halved and stretched to 2 m x 1 mm x 2 m.
    scale = np.array([1.0, 0.0005, 1.0])
    return TriangleMesh((mesh.vertices - foot) / scale - np.array([0, 0, 1]), mesh.faces)


def _write(path: Path, text: str) -> None:
    with staged_file(path) as file:
        file.write_text(text, encoding="utf-8")
