"""Numbers as a person writes them down: a value, a unit, and its standard deviation."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

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
    match = None if isinstance(given, bool) else _QUANTITY.fullmatch(str(given))
    if match is None:
        raise ValueError(f"'{given}' is not a number with its unit; write it as in '{example}'")
    number, unit, error, error_unit = match.groups()
    value = _in_base(number, unit or error_unit, units, str(given), example)
    spread = None if error is None else _in_base(error, error_unit, units, str(given), example)
    if spread is not None and spread < 0:
        raise ValueError(f"the error in '{given}' is negative; write it as in '{example}'")
    if value <= above:
        raise ValueError(f"'{given}' is not positive; give a larger number")
    return Measured(value, spread)


def _in_base(
    number: str, unit: str | None, units: Mapping[str, str], given: str, example: str
) -> float:
    """Return a number in the unit of factor 1, rounded once."""
    if bool(unit) != bool(units):
        raise ValueError(f"{given} has {'no' if units else 'a'} unit; write it as in '{example}'")
    if not unit:
        return float(number)
    if unit not in units:
        raise ValueError(f"'{given}' has the unit '{unit}'; there are {', '.join(units)}")
    return float(Decimal(number) * Decimal(units[unit]))


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
