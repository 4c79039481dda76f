"""The occluders of a laboratory: one class a kind, and their table, `AnyBody`.

A class states its entries, whose types have units and ranges, and its shapes. What a document
accepts, its errors and the scene follow from the table; drawings and checks read the scene.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory import entries
from periscopy_sim.laboratory.scene_text import SceneText, paint, tag, transform
from periscopy_sim.rendering.scene_files import REMEDY, TriangleMesh, read_mesh, revolved
from periscopy_sim.storage.yaml_document import Strict

Anchor = Literal["base", "center", "corner"]

ANCHORS = {"base": (0, 0, 1), "corner": (1, 1, 1), "center": (0, 0, 0), "end": (1, 0, 1)}
"""Middle of a cube of side 2 whose anchor is the origin."""

FOOT = 0.01
"""Height of a mesh's lowest face, over the mesh's: that of a scan is flat to some 3 mm of 30 cm."""


class Shape(NamedTuple):
    """One of Mitsuba's: its plugin, what shapes it, its other tags, the last word of its id."""

    plugin: str
    shaping: Iterable[str] = ()
    tags: Iterable[str] = ()
    part: str = ""


def block(middle: tuple[int, ...], *sizes: str, part: str = "") -> Shape:
    """Return a box of sizes along x, y, z, a plane if that along y is empty; middle: `ANCHORS`."""
    moved = tag("translate", **dict(zip("xyz", middle, strict=True)))
    scaled = {axis: each for axis, each in zip("xyz", sizes, strict=True) if each}
    shaping = moved, tag("scale", value=0.5), tag("scale", **scaled)
    if len(scaled) == 3:
        return Shape("cube", shaping, part=part)
    return Shape("rectangle", (tag("rotate", x=1, angle=90), *shaping), part=part)


class Body(Strict):
    """Name, bearer and reflectance, of all occluders.

    With a bearer (``with`` in a document), places and turns are in the bearer's coordinates: from
    its anchor, along its own axes. There numbers without an error are exact. `parts` are the last
    words of the ids of its shapes if it has several.
    """

    parts: ClassVar[tuple[str, ...]] = ()
    has_axes: ClassVar[bool] = True
    if TYPE_CHECKING:
        kind: str
    name: entries.Name
    bearer: Annotated[str, Field(alias="with", min_length=1)] = ""
    reflectance: entries.Reflectance = (0.3, 0.3, 0.3)

    @property
    def ids(self) -> set[str]:
        """Return its name and the ids of its shapes."""
        return {self.name, *(f"{self.name}_{part}" for part in self.parts)}

    @property
    def entry(self) -> str:
        """Return what messages call it."""
        return f"occluder '{self.name}'"

    def _placed(self, measured: entries.Measured) -> entries.Measured:
        """Return a place or turn; one without an error is exact if another occluder bears this."""
        is_exact = self.bearer and measured.error is None
        return entries.exactly(measured.value) if is_exact else measured

    @property
    def _beside(self) -> str:
        return f", in the coordinates of '{self.bearer}'" if self.bearer else ""


class StandingBody(Body):
    """Place and turns of all occluders that stand at a place: that of their `anchor`, or base."""

    position: entries.Place
    turn: entries.Angle = entries.exactly(0.0)
    tilt: entries.Angle = entries.exactly(0.0)

    def add_to(self, scene: SceneText, bearer: list[str]) -> list[str]:
        """Add its numbers and shapes, given its bearer's tags to the world; return its own tags."""
        scene.section(
            f"The {self.kind} '{self.name}': the place of its {self._anchor}, its tilt and turn "
            f"there{self._beside}."
        )
        place = scene.place(self.name, map(self._placed, self.position), f"{self.entry}: position")
        tilt, turn = self._placed(self.tilt), self._placed(self.turn)
        to_world = [*scene.turns(self.name, tilt, turn, self.entry), place, *bearer]
        for shape in self._shapes(scene):
            placed = transform(*shape.shaping, *to_world)
            label = f"{self.name}_{shape.part}" if shape.part else self.name
            scene.add(shape.plugin, label, *shape.tags, placed, paint(self.reflectance))
        return to_world

    @property
    def _anchor(self) -> str:
        return getattr(self, "anchor", "base")

    def _shapes(self, scene: SceneText) -> Iterable[Shape]:
        """Declare its sizes in a scene; return its shapes before it is tilted, turned and moved."""
        raise NotImplementedError

    def _block(self, scene: SceneText, deep: str) -> Iterable[Shape]:
        """Return a box, or a plane, of a width, a height, and a size along y that has this name."""
        width, height, thickness = self._sizes(scene, "width", "height", deep)
        return (block(ANCHORS[self._anchor], width, thickness, height),)

    def _round(self, scene: SceneText, *outline: tuple[float, float]) -> Iterable[Shape]:
        """Return a solid of revolution; bodies of one kind share its mesh.

        Its outline, (radius, z) from axis to axis, is that of a diameter and a height of 1.
        """
        across, height = self._sizes(scene, "diameter", "height")
        lowered = [tag("translate", z=-0.5)] if self._anchor == "center" else []
        shaping = *lowered, tag("scale", x=across, y=across, z=height)
        return (Shape("ply", shaping, scene.mesh(self.kind, revolved(outline))),)

    def _sizes(self, scene: SceneText, *names: str) -> list[str]:
        """Declare sizes in a scene; return the references to them, empty where there is none."""
        return [
            scene.declare(f"{self.name}_{each}", size, "length", f"{self.entry}: {each}")
            if (size := getattr(self, each))
            else ""
            for each in names
        ]


class Box(StandingBody):
    """A box: width along x, depth along y, height along z, before it is turned."""

    kind: Literal["box"]
    anchor: Anchor = "base"
    width: entries.Size
    depth: entries.Size
    height: entries.Size

    def _shapes(self, scene: SceneText) -> Iterable[Shape]:
        return self._block(scene, "depth")


class Plate(StandingBody):
    """An upright plate, parallel to the wall before it is turned."""

    kind: Literal["plate"]
    anchor: Anchor = "base"
    width: entries.Size
    height: entries.Size
    thickness: entries.Size = entries.exactly(0.001)

    def _shapes(self, scene: SceneText) -> Iterable[Shape]:
        return self._block(scene, "thickness")


class Frame(StandingBody):
    """An upright frame of four bars; `bar` is how wide they are."""

    parts: ClassVar[tuple[str, ...]] = ("left", "right", "bottom", "top")
    kind: Literal["frame"]
    width: entries.Size
    height: entries.Size
    bar: entries.Size
    thickness: entries.Size = entries.exactly(0.001)

    def _shapes(self, scene: SceneText) -> Iterable[Shape]:
        width, thickness, height, bar = self._sizes(scene, "width", "thickness", "height", "bar")
        shrink = tag("scale", value=0.5)  # Mitsuba's cube has a side of 2
        lying = shrink, tag("scale", x=width, y=thickness, z=bar)
        for side, part in ((1, "left"), (-1, "right")):
            yield Shape("cube", (
                tag("translate", x=side, z=1), shrink, tag("scale", x=bar, y=thickness, z=height),
                tag("scale", x=-2 * side), tag("translate", x=width), tag("scale", x=-0.5 * side),
            ), part=part)  # fmt: skip
        yield Shape("cube", (tag("translate", z=1), *lying), part="bottom")
        top = tag("translate", z=-1), *lying, tag("translate", z=height)
        yield Shape("cube", top, part="top")


class UprightCylinder(StandingBody):
    """A cylinder that stands, before it is tilted."""

    kind: Literal["cylinder"]
    anchor: Literal["base", "center"] = "base"
    diameter: entries.Size
    height: entries.Size

    def _shapes(self, scene: SceneText) -> Iterable[Shape]:
        return self._round(scene, (0, 0), (0.5, 0), (0.5, 1), (0, 1))


class Rod(Body):
    """A round rod between two points."""

    has_axes: ClassVar[bool] = False
    kind: Literal["rod"]
    start: entries.Place
    end: entries.Place
    diameter: entries.Size

    @model_validator(mode="after")
    def _has_a_length(self) -> Self:
        if [each.value for each in self.start] == [each.value for each in self.end]:
            raise ValueError(f"rod '{self.name}': start and end are one point; give it a length")
        return self

    def add_to(self, scene: SceneText, bearer: list[str]) -> list[str]:
        """Add its numbers and a cylinder, given its bearer's tags to the world; return these."""
        name, entry = self.name, self.entry
        scene.section(f"The rod '{name}': its ends{self._beside}, and its radius.")
        ends = []
        for p, end, point in (("p0", "start", self.start), ("p1", "end", self.end)):
            scene.place(f"{name}_{end}", map(self._placed, point), f"{entry}: {end}")
            at = ", ".join(f"${name}_{end}_{axis}" for axis in "xyz")
            ends.append(tag("point", name=p, value=at))
        value, error = self.diameter.value, self.diameter.error
        radius = entries.Measured(value / 2, None if error is None else error / 2)
        declared = scene.declare(f"{name}_radius", radius, "length", f"{entry}: diameter")
        thickness = tag("float", name="radius", value=declared)
        to_world = transform(*bearer) if bearer else ""
        scene.add("cylinder", name, *ends, thickness, to_world, paint(self.reflectance))
        return bearer


class Edge(StandingBody):
    """A wall that ends: its position is the foot of its free end, from which it runs along x.

    Without a thickness it is a plane.
    """

    anchor: ClassVar[str] = "end"
    kind: Literal["edge"]
    width: entries.Size = entries.exactly(3.0)
    height: entries.Size = entries.exactly(3.0)
    thickness: entries.Size | None = None

    def _shapes(self, scene: SceneText) -> Iterable[Shape]:
        return self._block(scene, "thickness")


class Doorway(StandingBody):
    """A wall with an opening: its position is the corner where jamb and lintel meet.

    Before it is turned, the opening runs from there along x and down, the jamb's wall the other
    way, `jamb` wide. The jamb reaches `height` down from the lintel, which is `lintel` high, over
    an opening `width` wide. Without a thickness all is a plane.
    """

    parts: ClassVar[tuple[str, ...]] = ("jamb", "lintel", "corner")
    anchor: ClassVar[str] = "corner"
    kind: Literal["doorway"]
    width: entries.Size = entries.exactly(3.0)
    height: entries.Size = entries.exactly(3.0)
    jamb: entries.Size = entries.exactly(3.0)
    lintel: entries.Size = entries.exactly(0.5)
    thickness: entries.Size | None = None

    def _shapes(self, scene: SceneText) -> Iterable[Shape]:
        names = "width", "jamb", "lintel", "height", "thickness"
        width, jamb, lintel, height, thickness = self._sizes(scene, *names)
        yield block((-1, 0, -1), jamb, thickness, height, part="jamb")
        yield block((1, 0, 1), width, thickness, lintel, part="lintel")
        yield block((-1, 0, 1), jamb, thickness, lintel, part="corner")


class MeshBody(StandingBody):
    """A mesh file; its anchor stands at the position."""

    kind: Literal["mesh"]
    file: str
    unit: Literal["m", "cm", "mm", "in", "ft"] | None = None
    up: Literal["x", "y", "z"] | None = None
    anchor: Literal["origin", "base", "center"] = "origin"

    @model_validator(mode="after")
    def _has_a_unit(self) -> Self:
        if self.unit is None and not self._is_gltf:
            raise ValueError("the file's numbers have no unit; give it, such as unit: mm")
        return self

    @property
    def _is_gltf(self) -> bool:
        """Whether the format itself says unit and axes: metres, y up."""
        return Path(self.file).suffix.lower() == ".glb"

    def _shapes(self, scene: SceneText) -> Iterable[Shape]:
        path = scene.folder / self.file
        scene.inputs.append(path)
        yield Shape("ply", tags=scene.mesh(self.name, self._mesh(path)))

    def _mesh(self, path: Path) -> TriangleMesh:
        """Return a file's mesh in metres, z up, its anchor at the origin."""
        if not path.is_file():
            raise ConfigurationError(f"{self.entry}: there is no file '{path}'")
        try:
            mesh = read_mesh(path)
        except ValueError as error:
            raise ConfigurationError(f"{self.entry}: the file '{path}' {error}; {REMEDY}") from None
        x, y, z = mesh.vertices.T * float(entries.LENGTHS[self.unit or "m"])
        up = self.up or ("y" if self._is_gltf else "z")
        vertices = np.stack({"x": (y, z, x), "y": (x, -z, y), "z": (x, y, z)}[up], axis=1)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        if self.anchor == "base":
            foot = vertices[vertices[:, 2] <= low[2] + FOOT * (high - low)[2]]
            low, high = foot.min(axis=0), foot.max(axis=0)
            high[2] = low[2]
        if self.anchor != "origin":
            vertices -= (low + high) / 2
        return TriangleMesh(vertices, mesh.faces, mesh.texture_coordinates)


AnyBody = Annotated[
    Box | Plate | Frame | UprightCylinder | Rod | Edge | Doorway | MeshBody,
    Field(discriminator="kind"),
]
"""The table of kinds, in the order in which messages list them."""
