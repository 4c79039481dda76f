"""The measurements of a laboratory: a YAML file, checked before a scene is made of it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, FiniteFloat, model_validator

from periscopy_sim.storage.formats.yaml_document import RowsAndColumns, Strict, read_yaml, text_of

LENGTHS = {"m": "1", "cm": "0.01", "mm": "0.001", "in": "0.0254", "ft": "0.3048"}
"""Units of length in metres."""

ANGLES = {"deg": "1", "degree": "1", "degrees": "1", "°": "1"}
"""Units of angle in degrees."""

_NUMBER = r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,2})?)"
_UNIT = r"\s*([^\W\d_]+|°)?\s*"
_QUANTITY = re.compile(rf"\s*{_NUMBER}{_UNIT}(?:(?:\+-|\+/-|±)\s*{_NUMBER}{_UNIT})?")


@dataclass(frozen=True)
class Measured:
    """A number in metres or degrees, or without a unit, and its standard deviation.

    An error of None was not stated; one of 0 says that the number is exact.
    """

    value: float
    error: float | None = None


def exactly(value: float) -> Measured:
    """Return a number without an error."""
    return Measured(value, 0.0)


def parse_quantity(
    given: Any, units: Mapping[str, str], example: str, above: float = -np.inf
) -> Measured:
    """Return a number from text such as ``12.5 cm +- 3 mm``, in the unit of factor 1.

    Also ``12.5 +- 0.3 cm``. No units are those of a bare number. A ValueError says that it is no
    number with a unit, or not above `above`.
    """
    if isinstance(given, Measured):
        return given
    text = text_of(given)
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise ValueError(f"'{text}' is not a number with its unit; write it as in '{example}'")
    number, unit, error, error_unit = match.groups()

    def in_base(number: str, unit: str | None) -> float:
        if bool(unit) != bool(units):
            lack = "a" if unit else "no"
            raise ValueError(f"{text} has {lack} unit; write it as in '{example}'")
        if unit and unit not in units:
            raise ValueError(f"'{text}' has the unit '{unit}'; there are {', '.join(units)}")
        return float(Decimal(number) * Decimal(units[unit] if unit else 1))  # rounded once

    value = in_base(number, unit or error_unit)
    spread = None if error is None else in_base(error, error_unit)
    if spread is not None and spread < 0:
        raise ValueError(f"the error in '{text}' is negative; write it as in '{example}'")
    if value <= above:
        raise ValueError(f"'{text}' is not positive; give a larger number")
    return Measured(value, spread)


def _reader(units: Mapping[str, str], example: str, above: float = -np.inf) -> BeforeValidator:
    return BeforeValidator(lambda given: parse_quantity(given, units, example, above))


Length = Annotated[Measured, _reader(LENGTHS, "12.5 cm +- 3 mm")]
"""Metres."""
Size = Annotated[Measured, _reader(LENGTHS, "12.5 cm +- 3 mm", 0.0)]
"""Metres, more than 0."""
Angle = Annotated[Measured, _reader(ANGLES, "30 deg +- 1 deg")]
"""Degrees."""
Exponent = Annotated[Measured, _reader({}, "18 +- 2", np.nextafter(0, -1))]
"""A bare number, 0 or more."""

EXAMPLE = Path(__file__).with_name("example.yaml")

SIDES = ("left", "right", "bottom", "top")
"""The bars of a frame."""

PLACES = ("center", "top_left", "top_right", "bottom_left", "bottom_right")
"""The places by one of which a monitor is known."""

TAKEN = {"wall", "camera", "monitor", "target", "view", "vertical", "horizontal", "field"}
"""First words of the scene's own names; no occluder may be called so."""


def _name(given: str) -> str:
    is_taken = given in TAKEN or given.endswith("_error")
    if is_taken or not re.fullmatch("[a-z][a-z0-9_]{0,39}", given):
        raise ValueError(
            f"'{given}' is no name, or one of the scene's own; use small letters, digits and _"
        )
    return given


Share = Annotated[FiniteFloat, Field(gt=0, le=1)]
Reflectance = Annotated[
    tuple[Share, Share, Share],
    BeforeValidator(lambda given: given if isinstance(given, list | tuple) else [given] * 3),
]
Place = tuple[Length, Length, Length]
"""x, y, z."""
OnWall = tuple[Length, Length]
"""x, z."""


class Errors(Strict):
    """Standard deviations of numbers without an error of their own."""

    length: Size | None = None
    angle: Annotated[Measured, _reader(ANGLES, "1 deg", 0.0)] | None = None


class Wall(Strict):
    """The plane y = distance, painted evenly."""

    distance: Size
    reflectance: Reflectance = (0.8, 0.8, 0.8)


class PerspectiveCamera(Strict):
    """A camera in the room: its place, the point of the wall that it looks at, how wide it sees."""

    kind: Literal["perspective"]
    film: RowsAndColumns
    position: Place
    target: OnWall
    roll: Angle = exactly(0.0)
    field_of_view: Angle

    @model_validator(mode="after")
    def _sees_something(self) -> Self:
        if not 0 < self.field_of_view.value < 180:
            raise ValueError("give a field_of_view, of the picture's width, between 0 and 180 deg")
        return self


class RectifiedCamera(Strict):
    """A picture that was brought to an upright rectangle of the wall."""

    kind: Literal["rectified"]
    film: RowsAndColumns
    bottom_left: OnWall
    width: Size
    height: Size


class Falloff(Strict):
    """Exponents of the cosines of the vertical and the horizontal angle."""

    vertical: Exponent
    horizontal: Exponent


class Screen(Strict):
    """The lit part of the monitor, and the place of its centre or of one corner.

    Corners are those that a viewer who faces the screen sees.
    """

    width: Size
    height: Size
    center: Place | None = None
    top_left: Place | None = None
    top_right: Place | None = None
    bottom_left: Place | None = None
    bottom_right: Place | None = None
    turn: Angle = exactly(0.0)
    tilt: Angle = exactly(0.0)
    falloff: Falloff | None = None

    @model_validator(mode="after")
    def _has_one_place(self) -> Self:
        if sum(place is not None for place in self.places.values()) != 1:
            raise ValueError(f"give one of {', '.join(self.places)}: [x, y, z]")
        return self

    @property
    def places(self) -> dict[str, Place | None]:
        """Return the places by name; exactly one is not None."""
        return {name: getattr(self, name) for name in PLACES}


Anchor = Literal["base", "center", "corner"]


class _Occluder(Strict):
    """Name, bearer and reflectance, of all occluders.

    With a bearer (``with`` in a document), places and turns are in the bearer's coordinates: from
    its anchor, along its own axes. There numbers without an error are exact.
    """

    name: Annotated[str, AfterValidator(_name)]
    bearer: Annotated[str, Field(alias="with", min_length=1)] = ""
    reflectance: Reflectance = (0.3, 0.3, 0.3)


class _Body(_Occluder):
    """Place and turns of all occluders that stand at a place."""

    position: Place
    turn: Angle = exactly(0.0)
    tilt: Angle = exactly(0.0)


class Box(_Body):
    """A box: width along x, depth along y, height along z, before it is turned."""

    kind: Literal["box"]
    anchor: Anchor = "base"
    width: Size
    depth: Size
    height: Size


class Plate(_Body):
    """An upright plate, parallel to the wall before it is turned."""

    kind: Literal["plate"]
    anchor: Anchor = "base"
    width: Size
    height: Size
    thickness: Size = exactly(0.001)


class Frame(_Body):
    """An upright frame of four bars; `bar` is how wide they are."""

    kind: Literal["frame"]
    width: Size
    height: Size
    bar: Size
    thickness: Size = exactly(0.001)


class UprightCylinder(_Body):
    """A cylinder that stands, before it is tilted."""

    kind: Literal["cylinder"]
    anchor: Literal["base", "center"] = "base"
    diameter: Size
    height: Size


class Rod(_Occluder):
    """A round rod between two points."""

    kind: Literal["rod"]
    start: Place
    end: Place
    diameter: Size

    @model_validator(mode="after")
    def _has_a_length(self) -> Self:
        if [each.value for each in self.start] == [each.value for each in self.end]:
            raise ValueError(f"rod '{self.name}': start and end are one point; give it a length")
        return self


class MeshBody(_Body):
    """A mesh file; its anchor stands at the position."""

    kind: Literal["mesh"]
    file: str
    unit: Literal["m", "cm", "mm", "in", "ft"] | None = None
    up: Literal["x", "y", "z"] | None = None
    anchor: Literal["origin", "base", "center"] = "origin"

    @model_validator(mode="after")
    def _has_a_unit(self) -> Self:
        if self.unit is None and not self.is_gltf:
            raise ValueError("the file's numbers have no unit; give it, such as unit: mm")
        return self

    @property
    def is_gltf(self) -> bool:
        """Return whether the format itself says unit and axes: metres, y up."""
        return Path(self.file).suffix.lower() == ".glb"


Occluding = Annotated[
    Box | Plate | Frame | UprightCylinder | Rod | MeshBody, Field(discriminator="kind")
]


class Laboratory(Strict):
    """A laboratory as measured; ``example.yaml`` beside this file explains each entry.

    `folder`, where relative paths start, is set by `load_laboratory`.
    """

    errors: Errors = Errors()
    wall: Wall
    camera: Annotated[PerspectiveCamera | RectifiedCamera, Field(discriminator="kind")]
    monitor: Screen
    occluders: tuple[Occluding, ...] = ()
    folder: Path = Path()

    @model_validator(mode="after")
    def _names_are_known_and_differ(self) -> Self:
        bearers, names, mistakes = {""}, set[str](), list[str]()
        for each in self.occluders:
            own = {each.name}
            if isinstance(each, Frame):
                own |= {f"{each.name}_{side}" for side in SIDES}
            if twice := own & names:
                mistakes.append(f"two occluders or bars are called '{min(twice)}'; rename one")
            if each.bearer not in bearers:
                mistakes.append(
                    f"occluder '{each.name}' stands with '{each.bearer}', but no occluder above it "
                    "with axes of its own (a rod has none) is called so"
                )
            names |= own
            bearers |= set() if isinstance(each, Rod) else {each.name}
        if mistakes:
            raise ValueError("; ".join(mistakes))
        return self


def load_laboratory(path: str | Path) -> Laboratory:
    """Read the measurements of a laboratory from a YAML file like `EXAMPLE`.

    A ConfigurationError names the line where a number is missing, has no unit or is out of range.
    """
    return read_yaml(Path(path), Laboratory)
