"""Make the scene of a measured laboratory: its XML file and the meshes beside it."""

from contextlib import ExitStack
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

import numpy as np

from periscopy_sim.errors import ConfigurationError, SceneError
from periscopy_sim.laboratory import document
from periscopy_sim.laboratory.scene_text import CYLINDER, scene_text
from periscopy_sim.rendering.load import SIDES, load_geometry, load_scene
from periscopy_sim.rendering.scene_files import REMEDY, TriangleMesh, read_mesh, write_ply
from periscopy_sim.storage.outputs import spare_inputs, staged_file

FOOT = 0.01
"""Height of a mesh's lowest face, over the mesh's: that of a scan is flat to some 3 mm of 30 cm."""

FACET = 1.0
"""Degrees that a facet of an angular surface spans at most. At 2.5 the facets of the doorway's room
change the light of patches of about their size by 0.14 %, more than its photographs' noise."""


def lab(measurements: str | Path, out: str | Path) -> tuple[Path, ...]:
    """Write the scene of a measured laboratory, and beside it a PLY file for each of its meshes.

    Parameters
    ----------
    measurements
        A YAML file, see `document.load_laboratory`.
    out
        The scene's XML file. Meshes are called after it: ``lab_lamp.ply`` beside ``lab.xml``.

    Returns
    -------
    tuple of Path
        The scene and its meshes.

    Raises
    ------
    ConfigurationError
        If the measurements are no YAML, a number is missing, has no unit or no error, or is out of
        range, or a mesh cannot be read.
    SceneError
        If no photograph can be taken there: the camera sees past the wall, the monitor faces away,
        something stands before the wall.
    """
    measurements, out = Path(measurements), Path(out)
    laboratory = document.load_laboratory(measurements)
    bodies = [body for body in laboratory.occluders if isinstance(body, document.MeshBody)]
    names = [body.name for body in bodies]
    if any(isinstance(body, document.UprightCylinder) for body in laboratory.occluders):
        names.append(CYLINDER)
    caps = [each for each in laboratory.hidden if isinstance(each, document.AngularSurface)]
    names += [cap.id for cap in caps]
    files = {name: out.with_name(f"{out.stem}_{name}.ply") for name in names}
    meshes = {cap.id: unit_cap(cap) for cap in caps}
    if CYLINDER in names:
        meshes[CYLINDER] = _unit_cylinder()
    try:
        if names.count(CYLINDER) > 1:
            raise ConfigurationError(f"a mesh is called '{CYLINDER}'; name it otherwise")
        for body in bodies:
            meshes[body.name] = _own_mesh(body, laboratory.folder / body.file)
        text = scene_text(
            laboratory,
            {name: file.name for name, file in files.items()},
            f"A laboratory as measured, made by periscopy lab from {measurements.name}.",
        )
    except ConfigurationError as error:
        raise ConfigurationError(f"{measurements}: {error}") from None
    given = [measurements, *(laboratory.folder / body.file for body in bodies)]
    spare_inputs((out, *files.values()), given)
    with TemporaryDirectory() as folder:  # the scene is tried before it is written
        trial = Path(folder) / out.name
        trial.write_text(text, encoding="utf-8")
        for name, file in files.items():
            write_ply(trial.with_name(file.name), meshes[name])
        rows, columns = (min(pixels, 64) for pixels in laboratory.camera.film)
        try:
            scene = load_scene(trial)
            load_geometry(scene, dict.fromkeys(scene.emission, (1, 1)), photograph=(rows, columns))
        except SceneError as error:
            raise SceneError(str(error).replace(folder, str(out.parent))) from None
        with ExitStack() as stack:  # the scene is in its place last
            for file in (out, *files.values()):
                copy = stack.enter_context(staged_file(file))
                copyfile(trial.with_name(file.name), copy)
    return out, *files.values()


build_laboratory = lab  # its former name


def _own_mesh(body: document.MeshBody, path: Path) -> TriangleMesh:
    """Return a mesh in metres, z up, its anchor at the origin."""
    if not path.is_file():
        raise ConfigurationError(f"occluder '{body.name}': there is no file '{path}'")
    try:
        mesh = read_mesh(path)
    except ValueError as error:
        raise ConfigurationError(
            f"occluder '{body.name}': the file '{path}' {error}; {REMEDY}"
        ) from None
    unit = body.unit or ("m" if body.is_gltf else "")
    x, y, z = mesh.vertices.T * float(document.LENGTHS[unit])
    up = body.up or ("y" if body.is_gltf else "z")
    turned = {"x": (y, z, x), "y": (x, -z, y), "z": (x, y, z)}[up]
    vertices = np.stack(turned, axis=1)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    if body.anchor == "base":
        foot = vertices[vertices[:, 2] <= low[2] + FOOT * (high - low)[2]]
        low, high = foot.min(axis=0), foot.max(axis=0)
        high[2] = low[2]
    if body.anchor != "origin":
        vertices -= (low + high) / 2
    return TriangleMesh(vertices, mesh.faces, mesh.texture_coordinates)


def _unit_cylinder() -> TriangleMesh:
    """Return a prism about the z axis, from z = 0 to 1, of diameter 1 and closed at both ends."""
    import trimesh

    # The mean over all directions of a convex outline's width is its length over pi.
    radius = 0.5 * (np.pi / SIDES) / np.sin(np.pi / SIDES)
    axis = [[0, 0, 0], [0, 0, 1]]
    prism = trimesh.creation.cylinder(radius, segment=axis, sections=SIDES)
    return TriangleMesh(np.asarray(prism.vertices), np.asarray(prism.faces))


def unit_cap(surface: document.AngularSurface) -> TriangleMesh:
    """Return an angular surface on the unit sphere; UV runs by its angles, as seen from within."""
    (right, left), (low, high) = np.radians(surface.degrees)
    columns, rows = np.ceil(np.ptp(surface.degrees, axis=1) / FACET).astype(int)
    row, column = np.indices((rows + 1, columns + 1)).reshape(2, -1)
    u, v = column / columns, row / rows
    azimuth, elevation = left + u * (right - left), low + v * (high - low)
    if surface.projected:
        directions = np.stack([np.ones(len(u)), np.tan(azimuth), np.tan(elevation)], axis=1)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    else:
        level = np.stack([np.cos(azimuth), np.sin(azimuth)]) * np.cos(elevation)
        directions = np.stack([*level, np.sin(elevation)], axis=1)
    first = np.arange(len(u)).reshape(rows + 1, -1)[:-1, :-1].ravel()
    above = first + columns + 1
    halves = [first, first + 1, above + 1], [first, above + 1, above]
    return TriangleMesh(directions, np.hstack(halves).T, np.stack([u, v], axis=1))
