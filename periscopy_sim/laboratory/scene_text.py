"""The text of a scene as it grows: measured numbers as ``<default>``s, and what they place."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import wrap
from xml.sax.saxutils import escape, quoteattr

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.document import Laboratory
from periscopy_sim.laboratory.quantities import Measured

HEAD = """<!-- {title}
     Metres and degrees; x to the right as one faces the wall, y from the monitor to the wall, z up.
     Turns are about the vertical, counterclockwise from above; tilts about x, the top away from the
     wall. NAME_error is the standard deviation of NAME, in its unit: how far off the ruler may be.
     -->
<scene version="3.0.0">
"""


class SceneText:
    """The text of a scene as it grows: what was measured, then what stands in the laboratory."""

    def __init__(self, laboratory: Laboratory) -> None:
        self._errors = {
            "length": laboratory.errors.length,
            "angle": laboratory.errors.angle,
            "number": Measured(0.0),
        }
        self._defaults: list[str] = []
        self._known: set[str] = set()
        self._shapes: list[str] = []

    def section(self, title: str) -> None:
        """Begin what was measured of one thing."""
        lines = wrap(f"<!-- {_comment(title)} -->", 95, subsequent_indent="     ")
        self._defaults += ["", *(f"    {line}" for line in lines)]

    def declare(self, name: str, measured: Measured, kind: str, entry: str) -> str:
        """Declare a number and its error; return what stands for it.

        The kind is ``length``, ``angle`` or ``number``, `entry` its name in the document.
        """
        error = measured.error
        if error is None:
            general = self._errors[kind]
            if general is None:
                raise ConfigurationError(
                    f"{entry} has no error; write it as in '12.5 cm +- 3 mm', or say how far off "
                    "such numbers are: 'errors: {length: 5 mm, angle: 1 deg}'"
                )
            error = general.value
        if {name, f"{name}_error"} & self._known:
            raise ConfigurationError(f"{entry}: two numbers of the scene would be called '{name}'")
        self._known |= {name, f"{name}_error"}
        self._default(name, measured.value)
        if error > 0:
            self._default(f"{name}_error", error)
        return f"${name}"

    def place(self, name: str, point: Iterable[Measured], entry: str, axes: str = "xyz") -> str:
        """Declare a point's coordinates; return the tag that moves there from the origin."""
        names = [
            f'{axis}="{self.declare(f"{name}_{axis}", each, "length", f"{entry}.{axis}")}"'
            for axis, each in zip(axes, point, strict=True)
        ]
        return f"<translate {' '.join(names)}/>"

    def turns(self, name: str, tilt: Measured, turn: Measured, entry: str) -> list[str]:
        """Declare a tilt about x and then a turn about z; return their tags."""
        tilted = self.declare(f"{name}_tilt", tilt, "angle", f"{entry}: tilt")
        turned = self.declare(f"{name}_turn", turn, "angle", f"{entry}: turn")
        return [f'<rotate x="1" angle="{tilted}"/>', f'<rotate z="1" angle="{turned}"/>']

    def film(self, size: tuple[int, int]) -> list[str]:
        """Declare the (rows, columns) of the film; return its lines."""
        self.section("Rows and columns of the photograph.")
        for name, pixels in zip(("height", "width"), size, strict=True):
            self._known.add(name)
            self._default(name, pixels)
        return [
            '    <film type="hdrfilm">',
            '        <integer name="width" value="$width"/>',
            '        <integer name="height" value="$height"/>',
            '        <rfilter type="box"/>',
            "    </film>",
            '    <sampler type="independent"/>',
        ]

    def add(self, lines: Iterable[str]) -> None:
        """Add something that stands in the laboratory."""
        self._shapes += ["", *(f"    {line}" for line in lines)]

    def text(self, title: str) -> str:
        """Return the whole scene."""
        lines = [*self._defaults, "", '    <integrator type="path"/>', *self._shapes, "</scene>"]
        return HEAD.format(title=_comment(title)) + "\n".join(lines[1:]) + "\n"

    def _default(self, name: str, value: float) -> None:
        self._defaults.append(
            f"    <default name={quoteattr(name)} value={quoteattr(repr(value))}/>"
        )


def transform(*tags: str) -> list[str]:
    """Return the lines of a shape's or sensor's place: its tags act one after the other."""
    lines = [f"        {tag}" for tag in tags]
    return ['    <transform name="to_world">', *lines, "    </transform>"]


def paint(reflectance: tuple[float, float, float]) -> list[str]:
    """Return the lines of a diffuse surface."""
    values = reflectance[:1] if len(set(reflectance)) == 1 else reflectance
    text = ", ".join(map(repr, values))
    return [
        '    <bsdf type="diffuse">',
        f'        <rgb name="reflectance" value="{text}"/>',
        "    </bsdf>",
    ]


def axes(x: str, y: str, z: str) -> str:
    """Return the attributes of a shift or a scaling."""
    return f'x="{x}" y="{y}" z="{z}"'


def _comment(text: str) -> str:
    """Return text that a comment may hold."""
    return escape(text).replace("--", "- -")
