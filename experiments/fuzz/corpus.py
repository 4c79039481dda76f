"""Read what other packages ship: `python -m experiments.fuzz.corpus FOLDER ... --most 50`.

Each picture and each mesh under the folders is read by the package and by an independent reader
(OpenCV; trimesh for PLY and OBJ, meshio for STL). The table counts those alike, those that the
package rejects, each with its line, and those that differ without a word, which are defects.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.rendering.scene.mesh_formats import read_mesh
from periscopy_sim.storage.formats.srgb import srgb_decode
from periscopy_sim.storage.pictures import read_hidden_image

PICTURES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr")
MESHES = (".ply", ".obj", ".stl")

SHAPE = (7, 9)
"""Rows and columns to which pictures are averaged."""

TOLERANCE = {".jpg": 0.02, ".jpeg": 0.02}
"""Relative difference of decoders; 1e-3 by default."""


def picture_by_opencv(path: Path) -> np.ndarray[Any, Any] | None:
    """Return a picture's light, averaged by rows and columns of whole pixels; None if unread."""
    import cv2

    is_jpeg = path.suffix.lower() in TOLERANCE
    values: Any = cv2.imread(str(path), cv2.IMREAD_COLOR if is_jpeg else cv2.IMREAD_UNCHANGED)
    if values is None:
        return None
    if values.dtype == np.uint8 and path.suffix.lower().startswith(".tif"):
        import tifffile  # OpenCV multiplies colours by alpha; the package reads 8 bits by Pillow

        values = tifffile.imread(path)
        values = values if values.ndim == 2 else values[..., [2, 1, 0, *range(3, values.shape[2])]]
    values = values if values.ndim == 3 else values[..., None]
    white = 1.0 if values.dtype.kind == "f" else np.iinfo(values.dtype).max
    light = values[..., : 3 if values.shape[2] >= 3 else 1][..., ::-1] / white
    light = light if values.dtype.kind == "f" else srgb_decode(light)
    if values.shape[2] in (2, 4):
        light = light * (values[..., -1:] / white)
    return light * np.ones(3)


def averaged(light: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return the exact means over `SHAPE` cells, by repetition to a common multiple."""
    for axis, cells in enumerate(SHAPE):
        light = np.repeat(light, cells, axis=axis)
        shape = [*light.shape]
        shape[axis : axis + 1] = [cells, shape[axis] // cells]
        light = light.reshape(shape).mean(axis=axis + 1)
    return light


def area_and_box(vertices: Any, faces: Any) -> np.ndarray[Any, Any]:
    """Return a mesh's area and the box about its triangles, (7,)."""
    corners = np.asarray(vertices, float)[np.asarray(faces)]
    sides = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2
    ends = corners.reshape(-1, 3).min(axis=0), corners.reshape(-1, 3).max(axis=0)
    return np.concatenate([[np.sqrt(area)], *ends])


def mesh_by_others(path: Path) -> np.ndarray[Any, Any] | None:
    """Return `area_and_box` of an independent reader's triangles; None if it reads none."""
    try:
        if path.suffix == ".stl":
            import meshio

            mesh = meshio.read(path)
            return area_and_box(mesh.points, mesh.cells_dict["triangle"])
        import trimesh

        mesh = trimesh.load(path, process=False, force="mesh")
        return area_and_box(mesh.vertices, mesh.faces)
    except (Exception, SystemExit):  # whatever these raise
        return None


def compare(path: Path) -> tuple[str, str]:
    """Return the verdict of a file, and what there is to say."""
    try:
        if path.suffix.lower() in MESHES:
            mesh = read_mesh(path)
            found: Any = area_and_box(mesh.vertices, mesh.faces)
            expected = mesh_by_others(path)
        else:
            found = read_hidden_image(path, SHAPE)
            light = picture_by_opencv(path)
            expected = None if light is None else averaged(light)
    except (PeriscopyError, ValueError) as error:
        return "rejected", " ".join(str(error).split())[-150:]
    if expected is None:
        return "read by the package alone", ""
    error = np.linalg.norm(found - expected) / max(np.linalg.norm(expected), 1e-9)
    return (
        "alike" if error <= TOLERANCE.get(path.suffix.lower(), 1e-3) else "DIFFER"
    ), f"{error:.2g}"


def files(folders: list[Path], most: int) -> Iterator[Path]:
    """Return up to so many files of each kind, as many of each suffix as there are."""
    for kinds in (PICTURES, MESHES):
        every = sorted(p for f in folders for p in f.rglob("*") if p.suffix.lower() in kinds)
        rank: Counter[str] = Counter()
        ranked = []
        for path in np.random.default_rng(0).permutation(np.array(every, object)):
            rank[path.suffix.lower()] += 1
            ranked.append((rank[path.suffix.lower()], str(path)))
        yield from (Path(name) for _, name in sorted(ranked)[:most])


def main(
    folders: Annotated[list[Path], typer.Argument(help="Folders to search.")],
    most: Annotated[int, typer.Option(help="Pictures, and meshes.")] = 50,
) -> None:
    """Compare the package with independent readers."""
    tally: Counter[tuple[str, str]] = Counter()
    for path in files(folders, most):
        verdict, detail = compare(path)
        tally[path.suffix.lower(), verdict] += 1
        if verdict != "alike":
            print(f"{verdict}: {path.name} {detail}")
    for (kind, verdict), number in sorted(tally.items()):
        print(f"{kind:6} {verdict:26} {number}")
    sys.exit(any(verdict == "DIFFER" for _, verdict in tally))


if __name__ == "__main__":
    typer.run(main)
