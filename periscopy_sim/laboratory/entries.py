"""The entries of a laboratory's document: numbers as a ruler gives them, names, colours."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from periscopy_sim.scene import HIDDEN, WALL
from periscopy_sim.storage.yaml_document import Number, Strict, text_of

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


TAKEN = {"wall", "camera", "monitor", "target", "view", "vertical", "horizontal", "field"}
"""First words of the scene's own names; nothing else may be called so."""


def _name(given: str) -> str:
    is_taken = given in TAKEN or given.startswith((HIDDEN, WALL)) or given.endswith("_error")
    if is_taken or not re.fullmatch("[a-z][a-z0-9_]{0,39}", given):
        raise ValueError(
            f"'{given}' is no name, or one of the scene's own; use small letters, digits and _"
        )
    return given


Name = Annotated[str, AfterValidator(_name)]

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
