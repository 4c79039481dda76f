"""A Mitsuba scene as a Scenario, or what it lacks for that."""

import operator
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.motion import LoadedScene
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.rendering.scene.placement import SceneLayout
from periscopy_sim.rendering.scene.refusals import check_monitor, check_nodes
from periscopy_sim.rendering.scene.wall import map_points, seen_wall, surface_at
from periscopy_sim.rendering.variant import without_warnings
from periscopy_sim.scenario import Array, Occluder, Scenario, corners
from periscopy_sim.shipped import find_scene

FARTHEST = 1e3
"""Distance from the origin over the longer side of what the camera sees of the wall: there single
precision makes an error of 1e-3 in A, as much as the noise of a 60 dB photograph."""

MOST_PIXELS = 1 << 22
"""Of a photograph: each is a row of A, and takes some 200 bytes before that."""

SIDES = 128
"""Of the polygon that stands for a circle: its width is right to 2e-4, a thin rod's A to 1e-5."""

RINGS = {"cylinder": (1.0, 1.0), "disk": (0.0, 0.0)}
"""Shapes that become triangles between the unit circle and another: its radius and its z."""


def load_scenario(
    path: str | Path,
    hidden: tuple[int, int],
    parameters: Mapping[str, str | float] | None = None,
    *,
    photograph: tuple[int, int] | None = None,
) -> Scenario:
    """Return the scenario of a scene that keeps the id contract.

    It has shapes ``wall`` and ``monitor`` and a sensor ``camera``. The wall points are where the
    camera's own rays through the pixels' centres meet the wall, so any sensor serves; the patches
    are an R x C grid in the monitor's UV square, so any shape with a UV parametrization serves.

    Every pixel is averaged over its own area: a box of one pixel takes the place of the film's
    reconstruction filter, in A and in photographs. Mitsuba's own ``mi.render`` of the file blurs by
    a Gaussian unless its film asks for ``<rfilter type="box"/>``.

    Parameters
    ----------
    path
        A Mitsuba XML file, or the name of a shipped scene.
    hidden
        (R, C), rows and columns of the hidden image.
    parameters
        Values for the file's ``<default>``s.
    photograph
        (rows, columns) into which the camera's field of view is cut; None for the film's own
        pixels. Another cut serves transport matrices and closed forms; pictures have the film's.

    Returns
    -------
    Scenario
        The scene as plain arrays.

    Raises
    ------
    SceneError
        If the contract is broken, a pixel misses the wall, the wall is partly a mirror, reflects
        nothing to the camera, or changes from place to place by more than its reflectance, the
        monitor faces away or shines outside of its UV square, a shape lets light through or holds a
        participating medium, or the hidden size is not possible.
    """
    values = {name: str(value) for name, value in (parameters or {}).items()}
    rows, columns = map(operator.index, hidden)
    return _load(SceneNodes(find_scene(path), values), (rows, columns), photograph)


def _load(
    nodes: SceneNodes, hidden: tuple[int, int], photograph: tuple[int, int] | None
) -> Scenario:
    """Return the scenario of a scene's nodes; see `load_scenario`."""
    path, layout = nodes.path, nodes.layout()
    nodes.show(None)
    nodes.average_pixels()
    check_nodes(nodes)
    # Instantiating consumes the nodes.
    emission, material = nodes.emission_profile(), nodes.wall_material()
    lights = nodes.other_lights()
    scene = nodes.instantiate()
    shapes = {shape.id(): shape for shape in scene.shapes()}
    pixels = _photograph_size(scene, photograph, hidden, path)
    where = f"scene '{path}'"
    wall, *rays = seen_wall(scene, camera_of(scene), shapes["wall"], pixels, where, material)
    patches = _patches(shapes["monitor"], hidden, path)
    boxes = {name: _box(shape, path) for name, shape in shapes.items()}
    bodies = {name: _occluder(shape, layout, boxes[name]) for name, shape in shapes.items()}
    ends, vertices = corners(boxes.pop("wall")), bodies["wall"].vertices
    ends = ends if vertices is None else vertices
    ahead = (ends - wall["wall_points"].mean(axis=0)) @ wall["wall_normals"].mean(axis=0)
    scenario = Scenario(
        document=nodes.document,
        photograph_shape=pixels,
        hidden_shape=hidden,
        **wall,
        **patches,
        emission=emission,
        occluders=tuple(body for name, body in bodies.items() if name not in ("wall", "monitor")),
        wall_relief=float(max(0.0, ahead.max())),
        lights=lights,
    )
    _check_places(scenario)
    origins, directions = (each.astype(np.float32) for each in rays)
    loaded = LoadedScene(scenario, layout, origins, directions, boxes)
    return replace(scenario, loader=partial(_at, loaded, photograph))


def _at(
    loaded: LoadedScene, photograph: tuple[int, int] | None, values: Mapping[str, str]
) -> Scenario:
    """Return a loaded scene's scenario at other values, loaded anew where that takes rays."""
    moved = loaded.at(values)
    if moved is None:
        nodes = SceneNodes(loaded.scenario.path, values)
        return _load(nodes, loaded.scenario.hidden_shape, photograph)
    _check_places(moved)
    return replace(moved, loader=partial(_at, loaded, photograph))


def build_scene(
    scenario: Scenario,
    image: NDArray[np.floating[Any]] | None = None,
    *,
    only_monitor: bool = False,
) -> Any:
    """Instantiate the Mitsuba scene of a scenario whose monitor shows an image, or white.

    The image is (R, C, 3) linear radiance along the normal, of any R and C. `only_monitor` removes
    every other emitter. Pixels are averaged over their own area (box filter).
    """
    nodes = SceneNodes(scenario.path, dict(scenario.parameters))
    nodes.show(image, scenario.mirrored)
    nodes.average_pixels()
    if only_monitor:
        nodes.darken()
    with without_warnings():  # which came when the scenario was loaded
        return nodes.instantiate()


def camera_of(scene: Any) -> Any:
    """Return the sensor ``camera`` of a Mitsuba scene."""
    return next(sensor for sensor in scene.sensors() if sensor.id() == "camera")


def shape_of(scene: Any, name: str) -> Any:
    """Return a shape of a Mitsuba scene by its id."""
    return next(shape for shape in scene.shapes() if shape.id() == name)


def patch_uv(
    row: Any, column: Any, hidden: tuple[int, int], mirrored: bool, offset: tuple[Any, Any]
) -> tuple[Any, Any]:
    """Return the monitor's coordinates u, v of a point in a patch.

    Row 0 is the top (v = 1) and column 0 a viewer's left; `mirrored` if u runs to a viewer's left.
    The offset is the position in the patch, down and across, each in [0, 1).
    """
    rows, columns = hidden
    u = (column + offset[1]) / columns
    v = 1 - (row + offset[0]) / rows
    return (1 - u if mirrored else u), v


def _photograph_size(
    scene: Any, asked: tuple[int, int] | None, hidden: tuple[int, int], path: Path
) -> tuple[int, int]:
    """Return (rows, columns) as asked, or else of the film; reject too many, or too few."""
    columns, rows = map(int, asked[::-1] if asked else camera_of(scene).film().crop_size())
    if not 1 <= rows * columns <= MOST_PIXELS:
        raise SceneError(
            f"scene '{path}': the camera's film has {rows}x{columns} pixels; give it "
            f"from 1 to {MOST_PIXELS}"
        )
    if min(hidden) < 1 or hidden[0] * hidden[1] > rows * columns:
        raise SceneError(
            f"{hidden[0]}x{hidden[1]} hidden patches: give from 1x1 to as many as the film's "
            f"{rows}x{columns} pixels, or give the scene's film more pixels"
        )
    return rows, columns


def _patches(monitor: Any, hidden: tuple[int, int], path: Path) -> dict[str, Any]:
    """Return what a `Scenario` has of its patches, by the names of its fields."""
    rows, columns = hidden

    def locate(uv: Any) -> tuple[Any, ...]:
        si = surface_at(monitor, uv)
        return si.p, si.n, si.dp_du, si.dp_dv, si.is_valid()

    try:
        _, normal, du, dv, _ = map_points(locate, np.array([[0.5, 0.5]]))
    except RuntimeError:
        raise SceneError(
            f"scene '{path}': the monitor has no UV parametrization; give its mesh UV coordinates "
            "(in GLB, and a material), or use a rectangle"
        ) from None
    area = np.linalg.norm(np.cross(du[0], dv[0]))
    if not (np.isfinite(area) and area > 0):
        raise SceneError(f"scene '{path}': the monitor has no area; check its to_world and its UV")
    check_monitor(monitor, path)
    mirrored = bool(np.cross(du[0], dv[0]) @ normal[0] < 0)
    row, column = np.divmod(np.arange(rows * columns), columns)
    u, v = patch_uv(row, column, hidden, mirrored, (0.5, 0.5))
    centers, normals, du, dv, valid = map_points(locate, np.stack([u, v], axis=1))
    if not valid.all():
        raise SceneError(
            f"scene '{path}': the monitor's UV coordinates do not cover the unit square"
        )
    return {
        "patch_centers": centers,
        "patch_normals": normals,
        "patch_across": (-du if mirrored else du) / columns,
        "patch_up": dv / rows,
        "mirrored": mirrored,
    }


def _check_places(scenario: Scenario) -> None:
    """Check that single precision resolves the scene, and that some patch and some pixel face."""
    points, normals = scenario.wall_points, scenario.wall_normals
    grid = points.reshape(*scenario.photograph_shape, 3)
    sides = [np.ptp(grid, axis=axis).max() for axis in (0, 1) if grid.shape[axis] > 1]
    far = np.abs(np.concatenate([points, scenario.patch_centers])).max()
    if sides and (far > FARTHEST * max(sides) or 0 in sides):
        raise SceneError(
            f"scene '{scenario.path}': wall or monitor are {far:.3g} from the origin, and the "
            f"camera sees {max(sides):.3g} of the wall, which single precision does not resolve; "
            "move all to the origin, or widen the camera's view"
        )
    for center, normal in zip(scenario.patch_centers, scenario.patch_normals, strict=True):
        way = center - points
        if ((way @ normal < 0) & (np.sum(normals * way, axis=1) > 0)).any():
            return
    raise SceneError(
        f"scene '{scenario.path}': the monitor faces away from the wall, or is behind it; turn it "
        "round, flip its normals (flip_normals), or move it"
    )


def _box(shape: Any, path: Path) -> Array:
    box = shape.bbox()
    bounds = np.array([box.min, box.max], dtype=np.float64).reshape(2, 3)
    if not np.isfinite(bounds).all():
        raise SceneError(f"scene '{path}': shape '{shape.id()}' has no finite size; correct it")
    return bounds


def _occluder(shape: Any, layout: SceneLayout, bounds: Array) -> Occluder:
    name = shape.id()
    if shape.is_mesh():
        vertices = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
        faces = np.array(shape.faces_buffer(), dtype=np.int64).reshape(-1, 3)
        return Occluder(name, vertices, faces, bounds)
    plugin = layout.plugins.get(name)
    if plugin not in RINGS:
        return Occluder(name, None, None, bounds)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(SIDES), np.ones(SIDES)], axis=1)
    scale, height = RINGS[plugin]
    other = circle * [scale, scale, 0, 1] + [0, 0, height, 0]
    vertices = (np.concatenate([circle, other]) @ layout.places[name].T)[:, :3]
    here, after = np.arange(SIDES), np.roll(np.arange(SIDES), -1)
    halves = (here, after, after + SIDES), (here, after + SIDES, here + SIDES)
    return Occluder(name, vertices, np.concatenate([np.stack(f, axis=1) for f in halves]), bounds)
