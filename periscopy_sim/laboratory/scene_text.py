"""The text of a scene: measured numbers as ``<default>``s, and the shapes and camera they place.

Mitsuba's XML has no arithmetic, but transforms: half of a width is a scaling by one half, and minus
half of it a scaling by -2, a shift by the width, and a scaling by -1/2.
"""

from collections.abc import Iterable
from pathlib import Path
from textwrap import indent, wrap
from xml.sax.saxutils import quoteattr

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.entries import Errors, Measured
from periscopy_sim.rendering.scene_files import TriangleMesh, comment, literal

HEAD = """<!-- {title}
     Metres and degrees; x to the right as one looks along y, to a wall that stands, and z up.
     Turns are about the vertical, counterclockwise from above; tilts about x, the top away from the
     wall. NAME_error is the standard deviation of NAME, in its unit: how far off the ruler may be.
     -->
<scene version="3.0.0">
"""

FILM = """<film type="hdrfilm">
    <integer name="width" value="$width"/>
    <integer name="height" value="$height"/>
    <rfilter type="box"/>
</film>
<sampler type="independent"/>"""


class SceneText:
    """The text of a scene as it grows: first the measured numbers, then shapes and sensor.

    The names of the files of its `meshes` begin with the scene's own, `stem`. The document's paths
    start in `folder`; `inputs` are the files that it names.
    """

    def __init__(self, errors: Errors, stem: str, folder: Path) -> None:
        self.meshes: dict[str, TriangleMesh] = {}
        self.inputs: list[Path] = []
        self.folder, self._stem = folder, stem
        self._errors = {"length": errors.length, "angle": errors.angle, "number": Measured(0.0)}
        self._without_error: list[str] = []
        self._defaults: list[str] = []
        self._names: set[str] = set()
        self._elements: list[str] = []

    def section(self, title: str) -> None:
        """Begin the measured numbers of one thing."""
        lines = wrap(f"<!-- {comment(title)} -->", 95, subsequent_indent="     ")
        self._defaults += ["", *(f"    {line}" for line in lines)]

    def declare(self, name: str, measured: Measured, kind: str, entry: str) -> str:
        """Declare a number and its error; return the reference to it.

        The kind is ``length``, ``angle`` or ``number``, `entry` its name in the document.
        """
        default = self._errors[kind]
        if measured.error is None and default is None:
            self._without_error.append(entry)
        error = default.value if measured.error is None and default else measured.error or 0.0
        if {name, f"{name}_error"} & self._names:
            raise ConfigurationError(f"{entry}: two numbers of the scene would be called '{name}'")
        self._default(name, measured.value)
        if error > 0:
            self._default(f"{name}_error", error)
        return f"${name}"

    def place(self, name: str, point: Iterable[Measured], entry: str, axes: str = "xyz") -> str:
        """Declare a point's coordinates; return the tag that moves there from the origin."""
        shifts = {
            axis: self.declare(f"{name}_{axis}", each, "length", f"{entry}.{axis}")
            for axis, each in zip(axes, point, strict=True)
        }
        return tag("translate", **shifts)

    def turns(self, name: str, tilt: Measured, turn: Measured, entry: str) -> list[str]:
        """Declare a tilt about x and then a turn about z; return their tags."""
        tilted = self.declare(f"{name}_tilt", tilt, "angle", f"{entry}: tilt")
        turned = self.declare(f"{name}_turn", turn, "angle", f"{entry}: turn")
        return [tag("rotate", x=1, angle=tilted), tag("rotate", z=1, angle=turned)]

    def add(self, kind: str, name: str, *parts: str, element: str = "shape") -> None:
        """Add a shape, or another element, of a type and an id, made of parts."""
        inside = indent("\n".join(filter(None, parts)), "    ")
        text = f'<{element} type="{kind}" id="{name}">\n{inside}\n</{element}>'
        self._elements.append("\n" + indent(text, "    "))

    def mesh(self, name: str, mesh: TriangleMesh) -> tuple[str, str]:
        """Return the tags of a shape that is a mesh; shapes of one mesh share its file."""
        file = f"{self._stem}_{name}.ply"
        if self.meshes.setdefault(file, mesh) is not mesh:
            raise ConfigurationError(f"a mesh is called '{name}'; name it otherwise")
        flat = tag("boolean", name="face_normals", value="true")  # its faces have no other normals
        return tag("string", name="filename", value=literal(file)), flat

    def add_camera(self, kind: str, size: tuple[int, int], *parts: str) -> None:
        """Add the camera, with a film of (rows, columns)."""
        self.section("Rows and columns of the photograph.")
        rows, columns = size
        if rows == columns:
            self._default("film", rows)
        self._default("height", "$film" if rows == columns else rows)
        self._default("width", "$film" if rows == columns else columns)
        self.add(kind, "camera", *parts, FILM, element="sensor")

    def text(self, title: str) -> str:
        """Return the whole scene; a ConfigurationError lists the numbers without an error."""
        if self._without_error:
            raise ConfigurationError(
                f"{', '.join(self._without_error)}: no error is given; write '12.5 cm +- 3 mm', or "
                "the error of all such numbers: 'errors: {length: 5 mm, angle: 1 deg}'"
            )
        lines = [*self._defaults, "", '    <integrator type="path"/>', *self._elements, "</scene>"]
        return HEAD.format(title=comment(title)) + "\n".join(lines[1:]) + "\n"

    def _default(self, name: str, value: float | str) -> None:
        self._names.add(name)
        self._defaults.append("    " + tag("default", name=name, value=value))


def tag(kind: str, **attributes: object) -> str:
    """Return an empty element."""
    words = [kind, *(f"{name}={quoteattr(str(value))}" for name, value in attributes.items())]
    return f"<{' '.join(words)}/>"


def transform(*tags: str) -> str:
    """Return the place of a shape or sensor: its tags act one after the other."""
    inside = indent("\n".join(tags), "    ")
    return f'<transform name="to_world">\n{inside}\n</transform>'


def paint(reflectance: tuple[float, float, float]) -> str:
    """Return a diffuse surface."""
    values = reflectance[:1] if len(set(reflectance)) == 1 else reflectance
    colour = tag("rgb", name="reflectance", value=", ".join(map(repr, values)))
    return f'<bsdf type="diffuse">\n    {colour}\n</bsdf>'
