"""A Mitsuba scene before it is instantiated: its nodes, checked against the id contract, edited.

Mitsuba parses the file; the files that its plugins read are found and checked here. The edits
(what the monitor shows, a dark room around it, box-filtered pixels) are made on the parsed nodes,
so that they work for every shape, sensor and emitter plugin.

Most parameters move, turn or stretch: they change the ``to_world`` matrices of shapes and of the
camera from M to M'. The arrays of the loaded scene then move by M' M^-1.
"""

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.rendering import lcd, scene_files
from periscopy_sim.rendering.lcd import PLUGIN as LCD
from periscopy_sim.rendering.variant import SHARED, mi, one_line
from periscopy_sim.scene import CAMERA, MONITOR, WALL, EmissionProfile, SceneDocument, is_hidden

NUMBERS = {"perspective": ("fov",), "cylinder": ("p0", "p1", "radius"), LCD: lcd.EXPONENTS}
"""Numbers of a plugin that a layout knows, beside ``to_world``."""

CAMERAS = "orthographic", "perspective"
"""Sensors whose rays through the picture's corners enclose all others."""


@dataclass(frozen=True, eq=False)
class SceneLayout:
    """Where a scene has its shapes and sensors, and everything else that it says.

    `plugins` and `places`, matrices (4, 4) from a node's coordinates to the scene's, are by id; a
    perspective camera's matrix is scaled by its field of view, and a cylinder's is that of the
    cylinder of radius 1 about the z axis from z = 0 to 1. `emission` has the profile of each hidden
    surface, `rest` what Mitsuba's nodes hold beside all this.
    """

    plugins: Mapping[str, str]
    places: Mapping[str, Array]
    emission: Mapping[str, EmissionProfile | None]
    rest: list[Any]


def only_motions(
    before: SceneLayout, after: SceneLayout, movable: Collection[str]
) -> dict[str, Array] | None:
    """Return the motion, (4, 4), of each moved part, by id; None if more than places differ.

    `movable` are ids.
    """
    if after.rest != before.rest:
        return None
    moved = {
        name: place @ np.linalg.inv(before.places[name])
        for name, place in after.places.items()
        if not np.array_equal(place, before.places[name])
    }
    if not moved.keys() <= {*movable}:
        return None
    for name, motion in moved.items():
        # Mitsuba renders in single precision. No comparison is true of NaN.
        is_finite = np.abs(after.places[name]).max() < np.finfo(np.float32).max
        if not (is_finite and np.linalg.det(motion) > 0):
            return None
    return moved


def place(plugin: str, to_world: Array, fov: Any = 90.0, **ruled: Any) -> Array:
    """Return the matrix of a shape or sensor as a `SceneLayout` has it, of its plugin's numbers.

    The matrix is NaN if a perspective camera has no view, or is stretched.
    """
    if plugin == "cylinder":
        return np.asarray(to_world @ _along(**ruled))
    if plugin != "perspective":
        return to_world
    is_turned = np.allclose(to_world[:3, :3] @ to_world[:3, :3].T, np.eye(3))
    wide = np.tan(np.radians(fov / 2)) if is_turned and 0 < fov < 180 else np.nan
    return np.asarray(to_world * [wide, wide, 1, 1])


def _along(p0: Any = (0, 0, 0), p1: Any = (0, 0, 1), radius: float = 1.0) -> Array:
    """Return the matrix (4, 4) from the unit cylinder on z = 0 to that of a plugin's points."""
    axis = np.subtract(p1, p0)
    length = float(np.linalg.norm(axis))
    # By way of a direction that no rod has, so that the turn changes smoothly with the axis.
    between = np.sqrt([1, 2, 3]) / np.sqrt(6)
    along = np.eye(4)
    for bisector in (axis / (length or 1) - between, between - [0, 0, 1]):
        along[:3, :3] @= np.eye(3) - 2 * np.outer(bisector, bisector) / (bisector @ bisector)
    along[:3, :3] *= [radius, radius, length]
    along[:3, 3] = p0
    return along


BRIGHTNESS = "radiance", "irradiance", "intensity", "power"
"""Parameters of Mitsuba's emitters that scale all of their light."""


class SceneNodes:
    """The parsed nodes of one scene file.

    `required` are ids, each with its kind of node, that the scene itself must have, outside of
    groups; one that is missing is a `SceneError`.
    """

    def __init__(
        self,
        path: Path,
        parameters: Mapping[str, str] | None = None,
        required: Mapping[str, str] | None = None,
    ) -> None:
        self.document = scene_files.read_document(path, parameters)
        self._config, self._state = parse(self.document)
        if required is None:
            surfaces = dict.fromkeys(self.hidden or [MONITOR], "Shape")
            required = {**({} if self.walls else {WALL: "Shape"}), **surfaces}
        for name, kind in required.items():
            if name not in (plain := self.plain(kind)):
                others = ", ".join(f"'{each}'" for each in plain) or "none"
                what = f"no {kind.lower()} outside of groups has the id '{name}' ({others})"
                raise self.error(what)

    @property
    def path(self) -> Path:
        """The scene file."""
        return self.document.path

    @property
    def hidden(self) -> list[str]:
        """The ids of the hidden surfaces, in file order."""
        return [name for each in self.of_type("Shape") if is_hidden(name := str(each.id()))]

    @property
    def walls(self) -> list[str]:
        """The ids of the relay walls, in file order."""
        return [name for name in self.plain("Shape") if name.startswith(WALL)]

    @property
    def cameras(self) -> list[str]:
        """The ids of the sensors, in file order."""
        return self.plain("Sensor")

    def error(self, reason: str) -> SceneError:
        """Return the error of this scene for a reason."""
        return SceneError(f"scene '{self.path}': {reason}")

    def of_type(self, *kinds: str) -> Iterator[Any]:
        """Return the properties of all nodes of some kinds, such as ``Shape``, in file order."""
        return (node.props for node in self._state.nodes if str(node.type).endswith(kinds))

    def children(self, props: Any, kind: str) -> list[tuple[str, Any]]:
        """Return the children of a kind, each by the name under which the node holds it."""
        nodes = {
            key: self._state.nodes[props[key].index()]
            for key in props.keys()  # noqa: SIM118 (Properties do not iterate)
            if props.type(key) == mi.Properties.Type.ResolvedReference
        }
        return [(key, node.props) for key, node in nodes.items() if str(node.type).endswith(kind)]

    @property
    def transparent(self) -> list[str]:
        """The ids of the hidden surfaces that light passes, those of a ``null`` BSDF."""
        materials = {name: self.children(self._by_id(name), "BSDF") for name in self.hidden}
        return [n for n, each in materials.items() if each and each[0][1].plugin_name() == "null"]

    def emission_profile(self, name: str) -> EmissionProfile | None:
        """Return a hidden surface's angular profile if it is known in closed form.

        A surface without an emitter is Lambertian: what it sends is the light that it reflects.
        """
        emitter = self._emitter(name)
        if emitter is None:
            return EmissionProfile()
        if emitter.plugin_name() == LCD:
            exponents = [float(emitter.get(name, 0.0)) for name in lcd.EXPONENTS]
            if not all(0 <= exponent < np.inf for exponent in exponents):
                raise self.error(f"the exponents {exponents} of '{name}' are not both 0 or more")
            return EmissionProfile(*exponents)
        return EmissionProfile() if emitter.plugin_name() == "area" else None

    def reflecting(self) -> dict[str, str]:
        """Return the materials of the hidden surfaces that have no emitter, in file order."""
        return {n: self.material(n) for n in self.hidden if self._emitter(n) is None}

    def other_lights(self) -> tuple[str, ...]:
        """Return the names of the emitters that shine beside hidden surfaces, in file order.

        An emitter has the name of its shape, else its own id or its plugin's name.
        """
        owners = {
            shape[key].index(): shape.id()
            for shape in self.of_type("Shape")
            for key, _ in self.children(shape, "Emitter")
        }
        lights = {
            str(owners.get(index) or node.props.id() or node.props.plugin_name()): node.props
            for index, node in enumerate(self._state.nodes)
            if str(node.type).endswith("Emitter") and not is_hidden(str(owners.get(index)))
        }
        return tuple(
            name
            for name, props in lights.items()
            if all(numbers_of(props[amount]).any() for amount in BRIGHTNESS if amount in props)
        )

    def layout(self) -> SceneLayout:
        """Return where the scene has its shapes and sensors, and everything else that it says."""
        plugins: dict[str, str] = {}
        places: dict[str, Array] = {}
        rest = []
        for node in self._state.nodes:
            props = mi.Properties(node.props)
            name, plugin = str(props.id()), str(props.plugin_name())
            known = [each for each in NUMBERS.get(plugin, ()) if each in props]
            if str(node.type).endswith(("Shape", "Sensor")):
                to_world = props.get("to_world", mi.ScalarTransform4f()).matrix
                numbers = {each: np.array(props[each], np.float64) for each in known}
                plugins[name] = plugin
                places[name] = place(plugin, np.array(to_world, np.float64), **numbers)
                known += ["to_world"] if "to_world" in props else []
            for each in known:
                del props[each]
            rest.append(props)
        emission = {name: self.emission_profile(name) for name in self.hidden}
        return SceneLayout(plugins, places, emission, rest)

    def material(self, name: str) -> str:
        """Return the name of a shape's BSDF plugin, of a ``twosided`` one that of its front."""
        inner, plugin = self.children(self._by_id(name), "BSDF"), "diffuse"  # Mitsuba's default
        while inner and plugin in ("diffuse", "twosided"):
            plugin = str(inner[0][1].plugin_name())
            inner = self.children(inner[0][1], "BSDF")
        return plugin

    def has_texture(self, name: str) -> bool:
        """Return whether a shape's material holds a texture."""
        nodes = [self._by_id(name)]
        for props in nodes:
            if self.children(props, "Texture"):
                return True
            nodes += (inner for _, inner in self.children(props, "BSDF"))
        return False

    def show(self, textures: Mapping[str, NDArray[np.float32]] | None) -> None:
        """Make each hidden surface show a `texture_of` an image by its id; None for all white."""
        for name in self.hidden:
            radiance: dict[str, Any] = {"type": "rgb", "value": 1.0}
            if textures is not None:
                radiance = {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(textures[name])}
                radiance |= {"filter_type": "nearest", "wrap_mode": "clamp"}
            emitter = self._emitter(name)
            if emitter is None:
                light = {"type": "area", "radiance": radiance}
                self._by_id(name)["emitter"] = mi.load_dict(light)
            elif "radiance" in emitter:
                emitter["radiance"] = mi.load_dict(radiance)
            else:
                raise self.error(
                    f"the emitter '{emitter.plugin_name()}' of '{name}' has no 'radiance' to show "
                    "an image by; give it one of type area or lcd"
                )

    def remove(self, names: Collection[str]) -> None:
        """Remove shapes."""
        for key, props in self.children(self._state.root.props, "Shape"):
            if props.id() in names:
                del self._state.root.props[key]

    def darken(self) -> None:
        """Remove every emitter but those of the hidden surfaces."""
        for node in self._state.nodes:
            lights = self.children(node.props, "Emitter")
            for key, _ in lights[1:] if is_hidden(str(node.props.id())) else lights:
                del node.props[key]

    def average_pixels(
        self, film_size: tuple[int, int] | None = None, *, sensor: str = CAMERA
    ) -> None:
        """Make a sensor average each pixel over its own area, in linear float32 RGB.

        Its samples become stratified ones: on penumbrae their error falls about as n^-0.75. A film
        size of None leaves its (rows, columns).
        """
        films = [props for _, props in self.children(self._by_id(sensor), "Film")]
        if not films or films[0].plugin_name() != "hdrfilm":
            raise self.error(f"sensor '{sensor}' has no film of type hdrfilm")
        film = films[0]
        for key, _ in self.children(film, "ReconstructionFilter"):
            del film[key]
        film["rfilter"] = mi.load_dict({"type": "box"})
        film["pixel_format"] = "rgb"
        film["component_format"] = "float32"
        if film_size is not None:
            film["height"], film["width"] = film_size
        camera = self._by_id(sensor)
        for key, _ in self.children(camera, "Sampler"):
            del camera[key]
        # Not ldsampler: its dimensions are correlated; its error on bounced light stalls at 1 %.
        camera["sampler"] = mi.load_dict({"type": "multijitter"})

    def instantiate(self) -> Any:
        """Build the Mitsuba scene, once: it consumes the nodes."""
        for name in self.hidden:
            self._straighten(self._by_id(name))
        state, self._state = self._state, None
        fault = ""
        try:
            with searching():
                built = mi.parser.instantiate(self._config, state)
        except (RuntimeError, ValueError) as error:
            fault = one_line(error)
        # What was built of a rejected scene must go at once: Dr.Jit would trace an emitter that
        # outlives its shape at the next virtual call, and crash.
        del state
        if fault:
            raise self.error(fault)
        return built[0] if isinstance(built, list | tuple) else built

    def _by_id(self, name: str) -> Any:
        return self._state.nodes[self._state.id_to_index[name]].props

    def _emitter(self, name: str) -> Any:
        """Return the emitter of a shape, None if it has none."""
        return next((props for _, props in self.children(self._by_id(name), "Emitter")), None)

    def _straighten(self, surface: Any) -> None:
        """Rewrite a flipped or mirrored rectangle as a plain one with the same emitting side.

        Mitsuba's rays, position samples and UV lookups report different normals of such a
        rectangle, so its light would depend on which of them samples it.
        """
        if surface.plugin_name() != "rectangle":
            return
        to_world = surface.get("to_world", mi.ScalarTransform4f())
        if surface.get("flip_normals", False):
            to_world = to_world @ type(to_world)().scale([1, 1, -1])
            del surface["flip_normals"]
        if np.linalg.det(np.array(to_world.matrix)) < 0:
            to_world = to_world @ type(to_world)().scale([-1, 1, 1])
        surface["to_world"] = to_world

    def plain(self, kind: str) -> list[str]:
        """Return the ids of the scene's own nodes of a kind, outside of groups, in file order."""
        return [
            str(each.id())
            for _, each in self.children(self._state.root.props, kind)
            if each.plugin_name() not in ("instance", "shapegroup", "merge")
        ]


def texture_of(image: NDArray[np.floating[Any]], mirrored: bool) -> NDArray[np.float32]:
    """Lay an image out as the texture that shows it, (max(R, 2), max(C, 2), 3) float32.

    The image is (R, C, 3) linear radiance along the normal, as a viewer facing the surface sees it,
    `mirrored` if its u runs to a viewer's left. Row 0 of a texture lies at v = 0, the surface's
    lower edge. Mitsuba's textures have 2 x 2 pixels at least: a single row or column is doubled.
    The array is contiguous.
    """
    texture = np.asarray(image, np.float32)[::-1, :: -1 if mirrored else 1]
    for axis in (0, 1):
        if texture.shape[axis] == 1:
            texture = np.repeat(texture, 2, axis)
    return np.ascontiguousarray(texture)


def parse(document: SceneDocument) -> tuple[Any, Any]:
    """Return Mitsuba's configuration and state of a scene file, with files by absolute names.

    `mitsuba.parser.instantiate` takes both. A file that is missing or malformed, or a parameter
    that the scene does not declare, is a `SceneError`.
    """
    path, parameters = document.path, document.given
    scene_files.check_values(document)
    config = mi.parser.ParserConfig(mi.variant())
    # Merging meshes would lose their ids.
    config.merge_meshes = False
    config.merge_equivalent = False
    config.unused_parameters = mi.LogLevel.Debug  # no plugin reads the priors' standard errors
    try:
        with searching(path.parent):
            state = mi.parser.parse_file(config, str(path), **parameters)
        mi.parser.transform_all(config, state)
    except (RuntimeError, ValueError) as error:
        if wrong := [n for n, text in parameters.items() if f'value "{text}"' in str(error)]:
            kind = "whole number" if "integer" in str(error) else "number"
            texts = " or ".join(f"{name}={parameters[name]}" for name in wrong)
            raise SceneError(f"{texts}: scene '{path}' needs a {kind} there") from None
        raise SceneError(f"scene '{path}': {one_line(error)}") from None
    for index, node in enumerate(state.nodes):
        if not node.props.id() and str(node.type).endswith("Shape"):
            node.props.set_id(f"{node.props.plugin_name()}_{index}")
        transform = node.props.get("to_world", None)
        if transform is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                # In single precision, as Mitsuba renders. No comparison is true of NaN.
                volume = abs(np.linalg.det(np.array(transform.matrix).astype(np.float32)))
            if not 0 < volume < np.inf:
                problem = "is not finite, or leaves it no size"
                raise SceneError(f"scene '{path}': to_world of '{node.props.id()}' {problem}")
        if isinstance(node.props.get("filename"), str):
            # Absolute, since Mitsuba would search other folders, too.
            plugin, file = scene_files.file_of(node.props, document)
            node.props["filename"] = str(file.resolve())
            node.props.set_plugin_name(plugin)
    return config, state


def numbers_of(value: Any) -> NDArray[np.float64]:
    """Return the values of a number, a colour or a spectrum; NaN of a texture."""
    try:
        return np.array(getattr(value, "values", value), dtype=np.float64)
    except (TypeError, ValueError, RuntimeError):
        return np.array(np.nan)


@contextmanager
def searching(*folders: Path) -> Iterator[None]:
    """Let Mitsuba search these folders and its own alone, not the one the process started in.

    Its parser also leaves a scene's ``<path>`` folders behind for every scene that follows.
    """
    with SHARED:
        before, resolver = mi.file_resolver(), mi.FileResolver()
        resolver.clear()  # of the folder that the process is in
        for folder in (*map(str, folders), *mi.__path__):
            resolver.append(folder)
        mi.set_file_resolver(resolver)
        try:
            yield
        finally:
            mi.set_file_resolver(before)
