"""A Mitsuba scene as a Scenario, or what it lacks for that."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.rendering.scene.parsing import one_line
from periscopy_sim.rendering.scene.pointwise import map_points, surface_at
from periscopy_sim.rendering.scene.refusals import check_monitor, check_nodes, check_wall
from periscopy_sim.rendering.variant import is_vectorized, use_variant
from periscopy_sim.scenario import Array, Occluder, Scenario
from periscopy_sim.shipped import find_scene

MOST_PIXELS = 1 << 22
"""Of a photograph: each is a row of A, and takes some 200 bytes before that."""


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
        If the contract is broken, a pixel misses the wall, the wall is textured, partly a mirror or
        reflects nothing to the camera, the monitor faces away or shines outside of its UV square,
        a shape lets light through or holds a participating medium, or the hidden size is not
        possible.
    """
    use_variant()
    path = find_scene(path)
    try:
        rows, columns = (operator.index(number) for number in hidden)
    except (TypeError, ValueError):
        raise SceneError(
            f"the hidden size must be two whole numbers, (rows, columns), not {hidden!r}"
        ) from None
    if rows < 1 or columns < 1:
        raise SceneError(f"a hidden image of {rows}x{columns} patches has none; give at least 1x1")
    values = {name: str(value) for name, value in (parameters or {}).items()}
    nodes = SceneNodes(path, values)
    nodes.show(None)
    nodes.average_pixels()
    check_nodes(nodes)
    # Instantiating consumes the nodes.
    emission, material = nodes.emission_profile(), nodes.wall_material()
    scene = nodes.instantiate()
    shapes = {shape.id(): shape for shape in scene.shapes()}
    film_columns, film_rows = (int(n) for n in camera_of(scene).film().crop_size())
    film_rows, film_columns = photograph or (film_rows, film_columns)
    if not 1 <= film_rows * film_columns <= MOST_PIXELS:
        raise SceneError(
            f"scene '{path}': the camera's film has {film_rows}x{film_columns} pixels; give it "
            f"from 1 to {MOST_PIXELS}"
        )
    if rows * columns > film_rows * film_columns:
        raise SceneError(
            f"{rows}x{columns} hidden patches are more than the {film_rows}x{film_columns} "
            "pixels of the photograph; no photograph could tell them apart"
        )
    check_wall(shapes["wall"], material, nodes.path)
    points, normals, albedo, diffuse, blur = _shoot_camera_rays(
        scene, shapes["wall"], (film_rows, film_columns), nodes.path, material
    )
    patches, mirrored = _patches(shapes["monitor"], hidden, nodes.path)
    centers, patch_normals, across, up = patches
    _check_facing(points, normals, centers, patch_normals, nodes.path)
    return Scenario(
        path=nodes.path,
        parameters=values,
        photograph_shape=(film_rows, film_columns),
        hidden_shape=(rows, columns),
        wall_points=points,
        wall_normals=normals,
        wall_reflectance=np.pi * albedo if diffuse else None,
        channel_gain=albedo / albedo.mean(),
        patch_centers=centers,
        patch_normals=patch_normals,
        patch_across=across,
        patch_up=up,
        mirrored=mirrored,
        emission=emission,
        occluders=tuple(
            _occluder(shape) for name, shape in shapes.items() if name not in ("wall", "monitor")
        ),
        blur=blur,
    )


def build_scene(
    scenario: Scenario,
    image: NDArray[np.floating[Any]] | None = None,
    *,
    only_monitor: bool = False,
    plain_emitter: bool = False,
) -> Any:
    """Instantiate the Mitsuba scene of a scenario whose monitor shows an image, or white.

    The image is (R, C, 3) linear radiance along the normal, of any R and C. `only_monitor` removes
    every other emitter, `plain_emitter` the LCD's angular profile. Pixels are averaged over their
    own area (box filter).
    """
    nodes = SceneNodes(scenario.path, dict(scenario.parameters))
    nodes.show(image, scenario.mirrored)
    nodes.average_pixels()
    if only_monitor:
        nodes.darken()
    if plain_emitter:
        nodes.drop_angular_profile()
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


def _shoot_camera_rays(
    scene: Any, wall: Any, photograph_shape: tuple[int, int], path: Path, material: str
) -> tuple[Array, Array, Array, bool, float]:
    """Meet the wall at every pixel's centre; find its colour, whether it is diffuse, the blur."""
    import drjit as dr
    import mitsuba as mi

    rows, columns = photograph_shape
    camera, bsdf, context = camera_of(scene), wall.bsdf(), mi.BSDFContext()
    straight, slopes = (0, 0, 1), ((0.8, 0, 0.6), (0, 0.8, 0.6))
    rim = ((0, 0.5), (1, 0.5), (0.5, 0), (0.5, 1)) if camera.needs_aperture_sample() else ()

    def met(position: Any, aperture: tuple[float, float]) -> tuple[Any, Any, Any]:
        ray, _ = camera.sample_ray(0.0, 0.0, position, mi.Point2f(*aperture))
        si = scene.ray_intersect(ray)
        hit = si.is_valid() & (si.shape == (mi.ShapePtr(wall) if is_vectorized() else wall))
        return si, ray.d, hit

    def meet(position: Any) -> tuple[Any, ...]:
        si, direction, hit = met(position, (0.5, 0.5))
        blur = mi.Float(0)
        for aperture in rim:
            off_axis, _, also_hit = met(position, aperture)
            hit &= also_hit
            blur = dr.maximum(blur, dr.norm(off_axis.p - si.p))
        toward_camera = mi.Vector3f(0, 0, dr.sign(si.wi.z))
        facing = bsdf.eval(context, si, toward_camera)
        si.wi = mi.Vector3f(*straight)
        colors = [bsdf.eval(context, si, mi.Vector3f(*to)) for to in (straight, *slopes)]
        return si.p, si.n, si.sh_frame.n, -direction, hit, blur, facing, *colors

    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    film = np.stack([column.ravel() / columns, row.ravel() / rows], axis=1)
    where = f"scene '{path}'"
    try:
        points, normals, shading, views, hit, blur, facing, color, *tilted = map_points(meet, film)
    except RuntimeError as error:  # of shapes that Mitsuba builds but cannot trace
        raise SceneError(f"{where}: Mitsuba cannot trace it: {one_line(error)}") from None
    if not hit.all():
        first = divmod(int(np.flatnonzero(~hit[:, 0].astype(bool))[0]), columns)
        raise SceneError(
            f"{where}: {int((hit == 0).sum())} of {hit.size} camera pixels miss the wall, the first"
            f" at row {first[0]}, column {first[1]}; move the camera, its film or what stands "
            "between it and the wall"
        )
    if not (np.isfinite(facing).all() and np.isfinite(color).all()):
        raise SceneError(f"{where}: the wall's reflectance is not finite ({material}); fix it")
    if not facing.any():
        raise SceneError(
            f"{where}: the wall ({material}) reflects nothing to the camera; turn its "
            "front to the camera or make it two-sided"
        )
    albedo = color.mean(axis=0)
    if np.ptp(color, axis=0).max() > 1e-4 * albedo.max():
        raise SceneError(
            f"{where}: the wall is textured ({material}); only a wall of one uniform "
            "material can be treated"
        )
    # Where a mesh has normals of its own, these count, as they do for the wall's BSDF.
    own = np.abs(shading - normals).max(axis=1, keepdims=True) > 1e-6
    normals = np.where(own, shading, normals)
    normals *= np.sign(np.sum(normals * views, axis=1, keepdims=True))
    slanted = np.array([values.mean(axis=0) for values in tilted])
    mean = slanted.mean(axis=1, keepdims=True) * albedo.mean()
    if (np.abs(slanted * albedo.mean() - mean / albedo.mean() * albedo) > 1e-4 * mean).any():
        raise SceneError(
            f"{where}: the colour of the wall's reflection ({material}) changes with direction; "
            "use a wall of one colour"
        )
    # Not so of a diffuse wall beneath a normal map.
    falls_as_cosine = np.abs(slanted / 0.6 - albedo).max() <= 1e-4 * albedo.max()
    return (
        points, normals, albedo, bool(_is_diffuse(wall) and falls_as_cosine),
        float(blur.max()),
    )  # fmt: skip


def _patches(
    monitor: Any, hidden: tuple[int, int], path: Path
) -> tuple[tuple[Array, Array, Array, Array], bool]:
    """Centres, normals and edge vectors of the patches, and whether u is mirrored."""
    rows, columns = hidden

    def locate(uv: Any) -> tuple[Any, ...]:
        si = surface_at(monitor, uv)
        return si.p, si.n, si.dp_du, si.dp_dv, si.is_valid()

    try:
        _, normal, du, dv, _ = map_points(locate, np.array([[0.5, 0.5]]))
    except RuntimeError:
        raise SceneError(
            f"scene '{path}': the monitor has no UV parametrization; give its mesh UV coordinates, "
            "or use a rectangle"
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
        first = divmod(int(np.flatnonzero(valid[:, 0] == 0)[0]), columns)
        raise SceneError(
            f"scene '{path}': the monitor's UV parametrization has no point at patch row {first[0]}"
            f", column {first[1]}; its UV coordinates must cover the unit square"
        )
    across = (-du if mirrored else du) / columns
    return (centers, normals, across, dv / rows), mirrored


def _check_facing(
    points: Array, normals: Array, centers: Array, patch_normals: Array, path: Path
) -> None:
    faces = False
    for center, patch_normal in zip(centers, patch_normals, strict=True):
        ahead = (points - center) @ patch_normal > 0
        lit = np.sum(normals * (center - points), axis=1) > 0
        if (ahead & lit).any():
            return
        faces |= bool(ahead.any())
    if not faces:
        raise SceneError(
            f"scene '{path}': the monitor faces away from the wall; turn it round or flip its "
            "normals (flip_normals)"
        )
    raise SceneError(
        f"scene '{path}': the monitor is behind the wall; move it to the camera's side"
    )


def _is_diffuse(wall: Any) -> bool:
    import mitsuba as mi

    flags = int(wall.bsdf().flags())
    other = int(mi.BSDFFlags.Glossy) | int(mi.BSDFFlags.Delta) | int(mi.BSDFFlags.Delta1D)
    return bool(flags & int(mi.BSDFFlags.DiffuseReflection)) and not flags & other


def _occluder(shape: Any) -> Occluder:
    if not shape.is_mesh():
        return Occluder(shape.id(), None, None)
    vertices = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
    faces = np.array(shape.faces_buffer(), dtype=np.int64).reshape(-1, 3)
    return Occluder(shape.id(), vertices, faces)
