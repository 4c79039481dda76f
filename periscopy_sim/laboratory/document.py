"""The measurements of a laboratory: a YAML file, checked before a scene is made of it.

Its numbers are as a ruler gives them: with a unit and an error.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from periscopy_sim.scene import HIDDEN, MONITOR, WALL
from periscopy_sim.storage.yaml_document import Number, RowsAndColumns, Strict, read_yaml, text_of

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


def reader(units: Mapping[str, str], example: str, above: float = -np.inf) -> BeforeValidator:
    """Return what reads a model's field by `parse_quantity`."""
    return BeforeValidator(lambda given: parse_quantity(given, units, example, above))


Length = Annotated[Measured, reader(LENGTHS, "12.5 cm +- 3 mm")]
"""Metres."""
Size = Annotated[Measured, reader(LENGTHS, "12.5 cm +- 3 mm", 0.0)]
"""Metres, more than 0."""
Angle = Annotated[Measured, reader(ANGLES, "30 deg +- 1 deg")]
"""Degrees."""
Exponent = Annotated[Measured, reader({}, "18 +- 2", np.nextafter(0, -1))]
"""A bare number, 0 or more."""


def _choice(given: Measured) -> Measured:
    if given.error:
        raise ValueError("this number is a choice, not a measurement; leave out its error")
    return exactly(given.value)


ChosenLength = Annotated[Length, AfterValidator(_choice)]
ChosenSize = Annotated[Size, AfterValidator(_choice)]
ChosenAngle = Annotated[Angle, AfterValidator(_choice)]
"""Numbers that are chosen, not measured: exact."""


EXAMPLE = Path(__file__).with_name("example.yaml")

SIDES = ("left", "right", "bottom", "top")
"""The bars of a frame."""

DOORWAY = {"jamb": (-1, -1), "lintel": (1, 1), "corner": (-1, 1)}
"""The parts of a doorway's wall: their sides of its corner along x and z."""

PLACES = ("center", "top_left", "top_right", "bottom_left", "bottom_right")
"""The places by one of which a monitor is known."""

TAKEN = {"wall", "camera", "monitor", "target", "view", "vertical", "horizontal", "field"}
"""First words of the scene's own names; nothing else may be called so."""


def _name(given: str) -> str:
    is_taken = given in TAKEN or given.startswith((HIDDEN, WALL)) or given.endswith("_error")
    if is_taken or not re.fullmatch("[a-z][a-z0-9_]{0,39}", given):
        raise ValueError(
            f"'{given}' is no name, or one of the scene's own; use small letters, digits and _"
        )
    return given


Share = Annotated[Number, Field(gt=0, le=1)]
Reflectance = Annotated[
    tuple[Share, Share, Share],
    BeforeValidator(lambda given: given if isinstance(given, list | tuple) else [given] * 3),
]
Place = tuple[Length, Length, Length]
"""x, y, z."""
OnWall = tuple[Length, Length]
"""x and z of a wall that stands, x and y of one that lies."""


class Errors(Strict):
    """Standard deviations of numbers without an error of their own."""

    length: Size | None = None
    angle: Annotated[Measured, reader(ANGLES, "1 deg", 0.0)] | None = None


class Wall(Strict):
    """The relay wall, painted evenly, which stands or lies.

    `axes` are those along it, to the right and to the top of a picture that shows it squarely or,
    of a ceiling, to its bottom; `depth` is the other one. `measure` names the entry that is its
    place there.
    """

    axes: ClassVar[str] = "xz"
    depth: ClassVar[str] = "y"
    measure: ClassVar[str] = "distance"
    reflectance: Reflectance = (0.8, 0.8, 0.8)

    @property
    def place(self) -> Measured:
        """Return its place along `depth`."""
        place: Measured = getattr(self, self.measure)
        return place


class StandingWall(Wall):
    """The plane y = distance, behind the room."""

    kind: Literal["standing"]
    distance: Size


class LyingWall(Wall):
    """The plane z = height: a floor below the room, or a ceiling above it."""

    axes: ClassVar[str] = "xy"
    depth: ClassVar[str] = "z"
    measure: ClassVar[str] = "height"
    kind: Literal["floor", "ceiling"]
    height: Length


TURNS = {"floor": 0, "standing": 90, "ceiling": 180}
"""Degrees about x that turn a floor into each kind of wall."""

AnyWall = Annotated[
    StandingWall | LyingWall,
    Field(discriminator="kind"),
    BeforeValidator(
        lambda given: {"kind": "standing", **given} if isinstance(given, dict) else given
    ),
]


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


class _Rectangle(Strict):
    """A rectangle, and the place of its centre or of one corner.

    Corners are those that a viewer who faces it sees.
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

    @model_validator(mode="after")
    def _has_one_place(self) -> Self:
        if sum(place is not None for place in self.places.values()) != 1:
            raise ValueError(f"give one of {', '.join(self.places)}: [x, y, z]")
        return self

    @property
    def places(self) -> dict[str, Place | None]:
        """Return the places by name; exactly one is not None."""
        return {name: getattr(self, name) for name in PLACES}


class Screen(_Rectangle):
    """The lit part of a monitor."""

    falloff: Falloff | None = None


class _HiddenSurface(Strict):
    """Name of all hidden surfaces of the list; the scene has it after ``hidden_``."""

    name: Annotated[str, AfterValidator(_name)]

    @property
    def id(self) -> str:
        """Return its id in the scene."""
        return f"{HIDDEN}_{self.name}"


class HiddenScreen(Screen, _HiddenSurface):
    """One of several screens."""

    kind: Literal["screen"]


class Card(_Rectangle, _HiddenSurface):
    """A matte rectangle that other light falls on: it is recovered as the light that it sends."""

    kind: Literal["card"]
    reflectance: Reflectance = (0.8, 0.8, 0.8)


STEEP = 89.0
"""Degrees, beyond which a direction is too close to a pole of the angles."""


class AngularSurface(_HiddenSurface):
    """Directions about a point, as part of a sphere; all of its numbers are choices.

    Azimuths are counterclockwise from x as seen from above, elevations above the horizontal; a
    `projected` elevation is that of the direction's projection on the plane y = 0, as a lintel
    along y separates it. Both are taken before the surface is turned.
    """

    kind: Literal["angular"]
    position: tuple[ChosenLength, ChosenLength, ChosenLength]
    radius: ChosenSize
    azimuth: tuple[ChosenAngle, ChosenAngle]
    elevation: tuple[ChosenAngle, ChosenAngle]
    projected: bool = False
    turn: ChosenAngle = exactly(0.0)

    @model_validator(mode="after")
    def _is_part_of_a_sphere(self) -> Self:
        azimuth, elevation = self.degrees
        steep = np.abs([*elevation, *(azimuth if self.projected else ())]).max() > STEEP
        if not (0 < np.diff(azimuth) < 360 and np.diff(elevation) > 0) or steep:
            raise ValueError(
                f"angular surface '{self.name}': give [from, to] that increase, an azimuth of less "
                f"than a full turn, elevations (and azimuths, if projected) within {STEEP:g} deg"
            )
        return self

    @property
    def degrees(self) -> NDArray[np.float64]:
        """Return the ends of azimuth and elevation, (2, 2), in degrees."""
        return np.array([[end.value for end in each] for each in (self.azimuth, self.elevation)])


HiddenSurface = Annotated[HiddenScreen | Card | AngularSurface, Field(discriminator="kind")]


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


class Edge(_Body):
    """A wall that ends: its position is the foot of its free end, from which it runs along x.

    Without a thickness it is a plane.
    """

    anchor: ClassVar[str] = "end"
    kind: Literal["edge"]
    width: Size = exactly(3.0)
    height: Size = exactly(3.0)
    thickness: Size | None = None


class Doorway(_Body):
    """A wall with an opening: its position is the corner where jamb and lintel meet.

    Before it is turned, the opening runs from there along x and down, the jamb's wall the other
    way, `jamb` wide. The jamb reaches `height` down from the lintel, which is `lintel` high, over
    an opening `width` wide. Without a thickness all is a plane.
    """

    anchor: ClassVar[str] = "corner"
    kind: Literal["doorway"]
    width: Size = exactly(3.0)
    height: Size = exactly(3.0)
    jamb: Size = exactly(3.0)
    lintel: Size = exactly(0.5)
    thickness: Size | None = None


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
    Box | Plate | Frame | UprightCylinder | Rod | Edge | Doorway | MeshBody,
    Field(discriminator="kind"),
]


class Laboratory(Strict):
    """A laboratory as measured; ``example.yaml`` beside this file explains each entry.

    `folder`, where relative paths start, is set by `load_laboratory`.
    """

    errors: Errors = Errors()
    wall: AnyWall
    camera: Annotated[PerspectiveCamera | RectifiedCamera, Field(discriminator="kind")]
    monitor: Screen | None = None
    hidden: tuple[HiddenSurface, ...] = ()
    occluders: tuple[Occluding, ...] = ()
    folder: Path = Path()

    @model_validator(mode="after")
    def _names_are_known_and_differ(self) -> Self:
        bearers, names, mistakes = {""}, set[str](), list[str]()
        if not (self.monitor or self.hidden):
            mistakes.append(f"no surface is hidden; give a {MONITOR}, or a list {HIDDEN}")
        surfaces = [each.name for each in self.hidden]
        if len(set(surfaces)) < len(surfaces):
            mistakes.append(f"two hidden surfaces have one name: {', '.join(surfaces)}; rename one")
        for each in self.occluders:
            own = {each.name}
            if isinstance(each, Frame):
                own |= {f"{each.name}_{side}" for side in SIDES}
            if isinstance(each, Doorway):
                own |= {f"{each.name}_{part}" for part in DOORWAY}
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
