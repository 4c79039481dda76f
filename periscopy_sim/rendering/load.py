"""A Mitsuba scene as a `Scene`, what its camera sees and its hidden surfaces, or what it lacks.

The checks reject what the light transport matrix would get wrong in silence. A holds the light that
goes straight from the monitor to the wall and is then reflected to the camera, past shapes that let
nothing through. So does `render_photograph` with a single bounce, and with it any path tracer that
samples the emitters: only all bounces, or sampling by the BSDF alone, show what is missed.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError, did_you_mean
from periscopy_sim.hidden import GAUSS, Hidden, Size, Sizes, Surface
from periscopy_sim.numerics import Array, validation
from periscopy_sim.rendering.nodes import (
    CAMERAS,
    SceneLayout,
    SceneNodes,
    numbers_of,
    only_motions,
    texture_of,
)
from periscopy_sim.rendering.scene_files import SIDES
from periscopy_sim.rendering.variant import LANES, dr, mi, without_warnings
from periscopy_sim.rendering.wall import (
    camera_of,
    map_points,
    middle_shape,
    shape_of,
    surface_at,
    trace_texture,
    trace_wall,
)
from periscopy_sim.scene import CAMERA, HIDDEN, Occluder, Scene, corners
from periscopy_sim.shipped import find_scene
from periscopy_sim.view import Geometry, View, moved_points

OPAQUE = {
    "diffuse", "conductor", "roughconductor", "plastic", "roughplastic", "pplastic", "principled",
    "measured", "measured_polarized", "twosided", "blendbsdf", "bumpmap", "normalmap",
}  # fmt: skip
"""BSDF plugins that let no light through by default; of a ``twosided`` one Mitsuba
makes sure."""

GRID = 64
"""Points along each side of a hidden surface's UV square at which to look for its surface."""

ALONG = 0.9
"""Cosine of the angle between the normals of surfaces that coincide rather than cross, at least."""

UV_ERROR = 1e-3
"""Error of UV coordinates and areas in single precision, generously."""


def check_nodes(nodes: SceneNodes) -> None:
    """Reject what light passes or is changed by on its way, and boxes turned inside out."""
    check_media(nodes)
    transparent = nodes.transparent
    for props in nodes.of_type("Shape"):
        place = np.array(props.get("to_world", mi.ScalarTransform4f()).matrix)
        if props.plugin_name() == "cube" and np.linalg.det(place) < 0:
            raise nodes.error(
                f"shape '{props.id()}' is a cube turned inside out: it would stand on the other "
                "side of a face; give its sizes, and factors of them, positive numbers"
            )
        if props.id() in transparent:
            continue
        for name in _see_through(nodes, props):
            raise nodes.error(
                f"shape '{props.id()}' may let light through (bsdf '{name}'), and A would count it "
                "as opaque; remove the shape, or give it an opaque bsdf (a mask's opacity is a "
                "number, 1; a bsdf of your own goes into a twosided one)"
            )


def check_media(nodes: SceneNodes) -> None:
    """Reject participating media: no light is scattered or absorbed on its way."""
    for kind in ("Shape", "Sensor"):
        for props in nodes.of_type(kind):
            for _, medium in nodes.children(props, "Medium"):
                raise nodes.error(
                    f"{kind.lower()} '{props.id()}' holds a participating medium "
                    f"({medium.plugin_name()}), where light would scatter; remove the medium"
                )


def check_surface(shape: Any, what: str) -> None:
    """Reject a hidden surface whose parts are not the points of its UV square, each once.

    What lies outside of the square, or under the same coordinates as another part, would shine in
    the scene but not in A; Mitsuba's own textured emitters miss it as well. `what` names the
    surface in messages.
    """
    if shape.class_name() == "Cylinder":  # Mitsuba misplaces its points, in pictures of it too
        raise SceneError(f"{what} is a cylinder, which cannot show an image; use a mesh of it")
    if shape.is_mesh():
        faces = np.array(shape.faces_buffer(), np.int64).reshape(-1, 3)
        uv = np.array(shape.vertex_texcoords_buffer(), np.float64).reshape(-1, 2)
        edges = np.diff(uv[faces], axis=1)  # (F, 2, 2)
        covered = float(np.abs(np.linalg.det(edges)).sum() / 2)
        inside = np.abs(uv[faces] - 0.5).max() <= 0.5 + UV_ERROR
        # Faces of the square's whole area that leave no hole do not overlap.
        is_right = inside and abs(covered - 1) <= UV_ERROR
    else:
        covered, is_right = 1.0, True

    def found(uv: Any) -> tuple[Any]:
        si = surface_at(shape, uv)
        return (si.is_valid() & (dr.max(dr.abs(si.uv - uv)) < UV_ERROR),)

    row, column = np.divmod(np.arange(GRID**2), GRID)
    # Off the middle, where meshes have their edges.
    (valid,) = map_points(found, np.stack([column + 0.45, row + 0.4], axis=1) / GRID)
    if not (is_right and valid.all()):
        raise SceneError(
            f"{what}: its faces cover {covered:.1%} of its UV square, {valid.mean():.1%} of it "
            "once; give each of its points UV coordinates of its own, from 0 to 1, and let other "
            "surfaces be shapes of their own (of a box, its front alone)"
        )


def check_apart(hidden: Hidden, where: str) -> None:
    """Reject hidden surfaces of which one lies in another: each would be counted as seen."""
    for (name, surface), (other, base) in permutations(hidden.items(), 2):
        side = np.sqrt(np.linalg.norm(np.cross(base.across, base.up), axis=1, keepdims=True))
        edges = np.stack([base.across, base.up, side * base.normals], axis=1)
        ways = surface.centers[:, None] - base.centers
        places = np.abs(np.einsum("mni,nij->mnj", ways, np.linalg.inv(edges)))
        along = np.abs(surface.normals @ base.normals.T) > ALONG
        if shared := ((places <= [0.5, 0.5, UV_ERROR]).all(axis=2) & along).any(axis=1).mean():
            raise SceneError(
                f"{where}: hidden surface '{name}' coincides with '{other}' in {shared:.0%} of its "
                "area; move one of them, or leave it out"
            )


def _see_through(nodes: SceneNodes, props: Any) -> Iterator[str]:
    """Return the names of the BSDFs within a node that may let light through."""
    for _, inner in nodes.children(props, "BSDF"):
        name = str(inner.plugin_name())
        if name == "principled":
            # No comparison is true of a texture's NaN.
            opaque = "spec_trans" not in inner or numbers_of(inner["spec_trans"]).max() <= 0
        elif name == "mask":
            opaque = "opacity" in inner and numbers_of(inner["opacity"]).min() >= 1
        else:
            opaque = name in OPAQUE
        if not opaque:
            yield name
        elif name != "twosided":
            yield from _see_through(nodes, inner)


ASIDE = 1e-5, 2e-5
"""Distance in u and v to a point beside one that rays miss."""

FLAT = 1e-5
"""Relative difference of patches' normals and edges up to which a surface counts as flat."""

TEXTURES = 16
"""Places of a camera before a wall whose averages of a texture are kept."""

MIDDLE = np.array([0.5])
"""Offset of a patch's centre within it."""

WHOLE = 48, 48
"""Patches by which the form of a hidden surface is judged, whatever the size of its image."""

RINGS = {"cylinder": (1.0, 1.0), "disk": (0.0, 0.0)}
"""Shapes that become triangles between the unit circle and another: its radius and its z."""


COARSE = 16, 16
"""Patches of hidden surfaces at whose centres to look for another surface."""


SCENES = 64
"""Scenes at other values that a loaded one keeps: more than a file declares errors, but for the
shelf's 24 twice."""


def load_geometry(
    scene: str | Path | Scene,
    hidden: Sizes,
    parameters: Mapping[str, str | float] | None = None,
    *,
    photograph: tuple[int, int] | str | None = None,
    camera: str = CAMERA,
) -> Geometry:
    """Return the view and the hidden surfaces of a scene; see `load_scenario`."""
    if not isinstance(scene, Scene):
        scene = load_scene(scene, parameters)
    elif parameters:
        scene = scene.at(**parameters)
    view = View.of(scene, photograph, camera=camera)
    sizes = sizes_by_id(scene, hidden, view)
    if len(sizes) > 1:
        coarse = Hidden.of_scene(scene, dict.fromkeys(sizes, COARSE))
        check_apart(coarse, f"scene '{scene.path}'")
    return Geometry(view, Hidden.of_scene(scene, sizes))


def sizes_by_id(scene: Scene, hidden: Sizes, view: View) -> dict[str, Size]:
    """Return the size of each hidden surface in file order, at most a patch for each pixel."""
    given = hidden if isinstance(hidden, Mapping) else dict.fromkeys(scene.emission, hidden)
    names = ", ".join(f"'{name}'" for name in scene.emission)
    where = f"scene '{scene.path}' has hidden surfaces {names}"
    if unknown := [name for name in given if name not in scene.emission]:
        meant = f"; {did_you_mean(unknown[0], scene.emission)}".rstrip("; ")
        if unknown[0] in {each.name for each in scene.occluders}:
            meant = f"; rename the shape {HIDDEN}_{unknown[0]}"
        raise SceneError(f"{where}, no '{unknown[0]}'{meant}")
    if not isinstance(hidden, Mapping) and len(scene.emission) > 1:
        raise SceneError(
            f"{where}; give a size to each: ID=ROWSxCOLUMNS, in Python hidden={{ID: (R, C), ...}}"
        )
    if missing := [name for name in scene.emission if name not in given]:
        raise SceneError(f"{where}; give a size to '{missing[0]}', too")
    sizes = {name: validation.size_of(given[name]) for name in scene.emission}
    if sum(rows * columns for rows, columns in sizes.values()) > len(view.points):
        written = ", ".join("{}x{}".format(*size) for size in sizes.values())
        pixels = "{}x{}".format(*view.shape)
        raise SceneError(
            f"{written} hidden patches: give from 1x1 to as many as the film's {pixels} "
            "pixels, or give the scene's film more pixels"
        )
    return sizes


def load_scene(path: str | Path, parameters: Mapping[str, str | float] | None = None) -> Scene:
    """Return the scene of a file that keeps the id contract; see `load_scenario`."""
    values = {name: str(value) for name, value in (parameters or {}).items()}
    return SceneLoader(SceneNodes(find_scene(path), values)).scene


class SceneLoader:
    """A scene file that was loaded, once: what Mitsuba knows of it.

    Views and hidden surfaces of a scene at other values are those of the loaded one, moved.
    """

    def __init__(self, nodes: SceneNodes) -> None:
        layout, self._path = nodes.layout(), nodes.path
        self._layout: SceneLayout | None = layout
        reflecting = nodes.reflecting()  # before all shine
        nodes.show(None)
        self._cameras = nodes.cameras
        for name in self._cameras:
            nodes.average_pixels(sensor=name)
        check_nodes(nodes)
        # Instantiating consumes the nodes.
        emission = layout.emission
        lights, transparent = nodes.other_lights(), tuple(nodes.transparent)
        self._materials = {name: nodes.material(name) for name in nodes.walls}
        self._textured = [name for name in nodes.walls if nodes.has_texture(name)]
        self._built = mi.variant(), nodes.instantiate()
        shapes = {shape.id(): shape for shape in self._built[1].shapes()}
        boxes = {name: _box(shape, nodes.path) for name, shape in shapes.items()}
        bodies = {n: _occluder(shape, layout, boxes[n]) for n, shape in shapes.items()}
        walls = tuple(bodies.pop(name) for name in self._materials)
        self._views: dict[tuple[Size | None, int, str], View] = {}
        # A calibration asks for scenes that differ by little; most share a view.
        self._last_views: dict[tuple[Size | None, int, str], View] = {}
        self._textures: dict[tuple[Size, int, str, bytes], dict[str, Any]] = {}
        self._last_hidden: dict[tuple[tuple[str, Size], ...], tuple[Hidden, Scene]] = {}
        self._scenes: dict[tuple[Any, ...], Scene] = {}
        self._surfaces: dict[tuple[str, Size], Surface] = {}
        self._wholes: dict[str, Surface] = {}
        self.scene = Scene(
            document=nodes.document,
            places=layout.places,
            plugins=layout.plugins,
            boxes={name: corners(box) for name, box in boxes.items()},
            occluders=tuple(body for name, body in bodies.items() if name not in emission),
            surfaces=tuple(body for name, body in bodies.items() if name in emission),
            emission=emission,
            lights=lights,
            reflecting=reflecting,
            transparent=transparent,
            walls=walls,
            source=self,
        )

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is Mitsuba's, which cannot be pickled, and what a copy computes anew."""
        of_mitsuba = {"_built": (None, None), "_layout": None}
        computed: dict[str, Any] = {
            "_last_views": {},
            "_last_hidden": {},
            "_textures": {},
            "_scenes": {},
        }
        return self.__dict__ | of_mitsuba | computed

    def at(self, scene: Scene, values: Mapping[str, str]) -> Scene:
        """Return a scene at other values, moved where that suffices, else loaded anew.

        The latest `SCENES` are kept: derivatives by a scene's numbers ask for each again and again.
        """
        bodies = (*scene.occluders, *scene.walls)
        movable = tuple(each.name for each in bodies if each.vertices is not None)
        key = movable, *sorted(values.items())
        if key in self._scenes:
            return self._scenes[key]
        nodes = SceneNodes(self._path, values)
        layout = nodes.layout()
        if self._layout is None:  # of a pickled copy
            self._layout = SceneNodes(self._path, self.scene.parameters).layout()
        emission = self.scene.emission
        moved = only_motions(self._layout, layout, [*movable, *emission, *self._cameras])
        if moved is None:  # it is not kept: it holds a Mitsuba scene of its own
            return SceneLoader(nodes).scene
        while len(self._scenes) >= SCENES:
            del self._scenes[next(iter(self._scenes))]
        self._scenes[key] = replace(
            self.scene,
            document=nodes.document,
            places=layout.places,
            motions=moved,
            boxes={
                name: moved_points(box, moved[name]) if name in moved else box
                for name, box in self.scene.boxes.items()
            },
            occluders=tuple(_moved_occluder(each, moved) for each in self.scene.occluders),
            surfaces=tuple(_moved_occluder(each, moved) for each in self.scene.surfaces),
            walls=tuple(_moved_occluder(each, moved) for each in self.scene.walls),
            emission=layout.emission,
        )
        return self._scenes[key]

    def view(self, scene: Scene, shape: Size | None, across: int, camera: str) -> View:
        """Return what a scene's camera sees of its wall; see `View.of`."""
        view = self._averaged(scene, shape, across, camera)
        if view.texture is None or across == 1:
            return view
        # Whatever the points in a pixel, its mean colour is the same.
        whole = self.view(scene, shape, 1, camera)
        return replace(view, reflectance=whole.reflectance, channel_gain=whole.channel_gain)

    def _averaged(self, scene: Scene, shape: Size | None, across: int, camera: str) -> View:
        """Return a view whose texture's mean colours may err a little."""
        key = shape, across, camera
        if key not in self._views:
            self._views[key] = self._trace_view(*key)
        loaded = self._views[key]
        if not scene.motions:
            return replace(loaded, scene=scene)
        if self.scene.plugins[camera] in CAMERAS:
            last = self._last_views.get(key, loaded)
            if scene.has_same_places((camera, loaded.wall), last.scene):
                view = last.moved(scene, {})
            else:
                view = loaded.moved(scene, scene.motions)
                if view is not None and view.wall in self._textured:
                    view = replace(view, **self._texture(view))
            if view is not None:
                self._last_views[key] = view
                return view
        scene = load_scene(self._path, scene.parameters)
        return View.of(scene, shape, across=across, camera=camera)

    def hidden(self, scene: Scene, sizes: Mapping[str, Size]) -> Hidden:
        """Return a scene's hidden surfaces in patches; see `Hidden.of_scene`."""
        asked = tuple(sizes.items())
        if asked in self._last_hidden:
            last, its_scene = self._last_hidden[asked]
            if scene.has_same_places(sizes, its_scene):
                return last
        for key in asked:
            if key not in self._surfaces:
                self._surfaces[key] = self._surface(*key)
        hidden = Hidden({key[0]: self._surfaces[key] for key in asked})
        hidden = hidden.moved(scene.motions)
        self._last_hidden[asked] = hidden, scene
        return hidden

    def _surface(self, name: str, size: Size) -> Surface:
        shape = shape_of(self.built(self.scene), name)
        what = f"scene '{self._path}': hidden surface '{name}'"
        if name not in self._wholes:
            _check_unwrapped(shape, what)
            self._wholes[name] = _surface(shape, WHOLE, what)
        whole, surface = self._wholes[name], _surface(shape, size, what)
        if all(
            np.ptp(each, axis=0).max() <= FLAT * np.abs(each).max()
            for each in (whole.normals, whole.across, whole.up)
        ):
            return surface
        curved = _surface(shape, size, what, 0.5 + np.array([-GAUSS, GAUSS]))
        return replace(surface, curved=curved, whole=whole)

    def built(self, scene: Scene) -> Any:
        """Return the Mitsuba scene, its hidden surfaces white and its pixels averaged."""
        variant, built = self._built
        is_moved = scene.motions or scene.emission != self.scene.emission
        return build_scene(scene) if is_moved or variant != mi.variant() else built

    def opaque(self, scene: Scene) -> Any:
        """Return the Mitsuba scene without hidden surfaces that light passes, for rays in A."""
        return build_scene(scene, only_opaque=True) if scene.transparent else self.built(scene)

    def _texture(self, view: View) -> dict[str, Any]:
        """Return what a moved camera sees of a moved wall's texture, by fields of the view.

        Derivatives and searches ask again and again for the same few places.
        """
        built, names = self.built(self.scene), (view.camera, view.wall)
        camera, wall = (view.scene.motions.get(name, np.eye(4)) for name in names)
        motion = np.linalg.inv(wall) @ camera
        key = view.shape, view.across, view.camera, motion.tobytes()
        if key not in self._textures:
            parts = built, camera_of(built, view.camera), shape_of(built, view.wall)
            what = f"scene '{self._path}': the wall ({self._materials[view.wall]})"
            while len(self._textures) >= TEXTURES:
                del self._textures[next(iter(self._textures))]
            self._textures[key] = trace_texture(*parts, view.shape, view.across, what, motion)
        return self._textures[key]

    def _trace_view(self, shape: Size | None, across: int, name: str) -> View:
        built, where = self.built(self.scene), f"scene '{self._path}'"
        if name not in self._cameras:
            others = ", ".join(f"'{each}'" for each in self._cameras) or "none"
            raise SceneError(f"{where}: no sensor outside of groups has the id '{name}' ({others})")
        camera = camera_of(built, name)
        columns, rows = map(int, shape[::-1] if shape else camera.film().crop_size())
        if not 1 <= rows * columns <= LANES:  # whose rays are traced at once
            raise SceneError(
                f"{where}: the camera's film has {rows}x{columns} pixels; give it from 1 to {LANES}"
            )
        walls = {each.name: each for each in self.scene.walls}
        middle = middle_shape(built, camera, where) if len(walls) > 1 else next(iter(walls))
        if middle not in walls:
            raise SceneError(
                f"{where}: the middle of '{name}' shows {middle or 'nothing'}, none of the walls "
                f"{', '.join(walls)}; turn the camera"
            )
        wall = walls[middle]
        what = f"{where}: the wall ({self._materials[wall.name]})"
        body = shape_of(built, wall.name)
        seen = trace_wall(built, camera, body, (rows, columns), across, where, what)
        # How far the wall's shape reaches ahead of the plane that is seen.
        points, normals = (seen[each].reshape(-1, 3) for each in ("points", "normals"))
        ends = self.scene.boxes[wall.name] if wall.vertices is None else wall.vertices
        relief = float(max(0.0, ((ends - points.mean(axis=0)) @ normals.mean(axis=0)).max()))
        seen |= {"relief": relief, "is_cut": shape is not None}
        return View(self.scene, (rows, columns), **seen, camera=name, wall=middle)


def _moved_occluder(occluder: Occluder, moved: Mapping[str, Array]) -> Occluder:
    """Return an occluder, moved if there is a motion, (4, 4), of its name."""
    if occluder.name not in moved or occluder.vertices is None:
        return occluder
    vertices = moved_points(occluder.vertices, moved[occluder.name])
    return replace(occluder, vertices=vertices, bounds=np.stack([vertices.min(0), vertices.max(0)]))


def build_scene(
    scene: Scene,
    hidden: Hidden | None = None,
    images: Mapping[str, NDArray[np.floating[Any]]] | None = None,
    *,
    only_hidden: bool = False,
    only_opaque: bool = False,
) -> Any:
    """Instantiate the Mitsuba scene of a scene whose hidden surfaces show images, or white.

    Each image is (R, C, 3) linear radiance along the normal, of any R and C, of the surface of
    `hidden` that has its id. `only_hidden` removes every other emitter, `only_opaque` every hidden
    surface that light passes. Pixels are averaged over their own area (box filter).
    """
    nodes = SceneNodes(scene.path, dict(scene.parameters))
    textures = None
    if hidden is not None and images is not None:
        textures = {name: np.zeros((2, 2, 3), np.float32) for name in scene.emission}
        for name in hidden:
            textures[name] = texture_of(images[name], hidden[name].mirrored)
    nodes.show(textures)
    for name in nodes.cameras:
        nodes.average_pixels(sensor=name)
    if only_hidden:
        nodes.darken()
    if only_opaque:
        nodes.remove(nodes.transparent)
    with without_warnings():  # which came when the scene was loaded
        return nodes.instantiate()


def patch_uv(
    row: Any, column: Any, hidden: tuple[int, int], mirrored: bool, offset: tuple[Any, Any]
) -> tuple[Any, Any]:
    """Return a hidden surface's coordinates u, v of a point in a patch.

    Row 0 is the top (v = 1) and column 0 a viewer's left; `mirrored` if u runs to a viewer's left.
    The offset is the position in the patch, down and across, each in [0, 1).
    """
    rows, columns = hidden
    u = (column + offset[1]) / columns
    v = 1 - (row + offset[0]) / rows
    return (1 - u if mirrored else u), v


def _located(shape: Any, uv: Array) -> list[Array]:
    """Return points, normals, derivatives by u and v, and whether valid, at (n, 2) coordinates."""

    def locate(uv: Any) -> tuple[Any, ...]:
        si = surface_at(shape, uv)
        return si.p, si.n, si.dp_du, si.dp_dv, si.is_valid()

    return map_points(locate, uv)


def _check_unwrapped(shape: Any, what: str) -> None:
    """Reject a hidden surface without UV coordinates, or whose parts these do not name once."""
    try:
        _located(shape, np.array([[0.5, 0.5]]))
    except RuntimeError:
        raise SceneError(
            f"{what} has no UV parametrization; unwrap its mesh (in Blender: Edit Mode, UV, Smart "
            "UV Project) and export it with a material, or use a rectangle"
        ) from None
    check_surface(shape, what)


def _surface(shape: Any, size: Size, what: str, offsets: Array = MIDDLE) -> Surface:
    """Return a hidden surface, (R, C), in parts of patches, one at each of the offsets in one."""
    (rows, columns), parts = size, len(offsets)
    _, normal, du, dv, _ = _located(shape, np.array([[0.5, 0.5]]))
    mirrored = bool(np.cross(du[0], dv[0]) @ normal[0] < 0)
    row, column = np.divmod(np.arange(parts**2 * rows * columns), parts * columns)
    offset = offsets[row % parts], offsets[column % parts]
    u, v = patch_uv(row // parts, column // parts, size, mirrored, offset)
    uv = np.stack([u, v], axis=1)
    found = centers, normals, du, dv, valid = _located(shape, uv)
    if (missed := ~valid[:, 0].astype(bool)).any():  # between two faces, by rounding
        for each, mended in zip(found, _located(shape, uv[missed] + ASIDE), strict=True):
            each[missed] = mended
    if not valid.all():
        raise SceneError(f"{what}: its UV coordinates do not cover the unit square")
    across, up = (-du if mirrored else du) / (parts * columns), dv / (parts * rows)
    return Surface((parts * rows, parts * columns), centers, normals, across, up, mirrored)


def _box(shape: Any, path: Path) -> Array:
    box = shape.bbox()
    bounds = np.array([box.min, box.max], dtype=np.float64).reshape(2, 3)
    # A flat shape has a size along two axes.
    if not np.isfinite(bounds).all() or np.count_nonzero(np.ptp(bounds, axis=0)) < 2:
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
