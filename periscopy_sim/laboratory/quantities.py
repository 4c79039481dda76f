"""Numbers as a person writes them down: a value, a unit, and how far it may be off."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from difflib import get_close_matches
from typing import Annotated, Any

from pydantic import BeforeValidator

LENGTHS = {"m": "1", "cm": "0.01", "mm": "0.001", "in": "0.0254", "ft": "0.3048"}
"""Units of length in metres."""

ANGLES = {"deg": "1", "degree": "1", "degrees": "1", "°": "1"}
"""Units of angle in degrees."""

LONGEST, WIDEST, HIGHEST = 1000, 360, 1000
"""Metres, degrees and exponents that a laboratory may have."""

_NUMBER = r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]{1,3})?)"
_UNIT = r"\s*([^\W\d_]+|°)?\s*"
_QUANTITY = re.compile(rf"\s*{_NUMBER}{_UNIT}(?:(?:\+-|\+/-|±)\s*{_NUMBER}{_UNIT})?")


@dataclass(frozen=True)
class Measured:
    """A number in metres or degrees, or without a unit, and its standard deviation.

    An error of None was not stated; one of 0 says that the number is exact.
    """

    value: float
    error: float | None = None


EXACTLY_0 = Measured(0.0, 0.0)


def parse_quantity(
    given: Any,
    units: Mapping[str, str],
    example: str,
    most: float,
    *,
    least: float = float("-inf"),
    above: float = float("-inf"),
) -> Measured:
    """Return a number from text such as ``12.5 cm +- 3 mm``, in the unit of factor 1.

    Also ``12.5 +- 0.3 cm``. No units are those of a bare number. What is wrong is a ValueError: no
    unit or another one, no number, one below `least`, not above `above`, or larger than `most`.
    """
    if isinstance(given, Measured):
        return given
    if isinstance(given, bool) or not isinstance(given, str | int | float):
        raise ValueError(f"give a number, such as '{example}'")
    if isinstance(given, int | float) and units:
        raise ValueError(f"{given} has no unit; write it as in '{example}'")
    found = _QUANTITY.fullmatch(str(given))
    if found is None:
        raise ValueError(f"'{given}' is not a number with its unit; write it as in '{example}'")
    value, unit, error, error_unit = found.groups()
    measured = Measured(
        _in_base(value, unit or error_unit, units, str(given), example),
        None if error is None else _in_base(error, error_unit, units, str(given), example),
    )
    if measured.error is not None and measured.error < 0:
        raise ValueError(f"the error in '{given}' is negative; write it as in '{example}'")
    if measured.value < least:
        raise ValueError(f"'{given}' is negative; give one of 0 or more")
    if measured.value <= above:
        raise ValueError(f"'{given}' is not positive; give one above 0")
    if max(abs(measured.value), measured.error or 0) > most:
        raise ValueError(f"'{given}' is beyond {most:g}; check the number and its unit")
    return measured


def _in_base(
    number: str, unit: str | None, units: Mapping[str, str], given: str, example: str
) -> float:
    """Return a number in the unit of factor 1, rounded once."""
    if not units:
        if unit:
            raise ValueError(f"'{given}' has a unit; write it as in '{example}'")
        return float(number)
    if unit is None:
        raise ValueError(f"'{given}' lacks a unit; write it as in '{example}'")
    if unit not in units:
        near = get_close_matches(unit.lower(), units, 1, 0.4) or [next(iter(units))]
        raise ValueError(
            f"'{given}' has the unit '{unit}'; there are {', '.join(units)} (did you mean "
            f"'{near[0]}'?)"
        )
    return float(Decimal(number) * Decimal(units[unit]))


def _reader(
    units: Mapping[str, str], example: str, most: float, **bounds: float
) -> Callable[[Any], Measured]:
    return lambda given: parse_quantity(given, units, example, most, **bounds)


Length = Annotated[Measured, BeforeValidator(_reader(LENGTHS, "12.5 cm +- 3 mm", LONGEST))]
"""Metres."""
Size = Annotated[Measured, BeforeValidator(_reader(LENGTHS, "12.5 cm +- 3 mm", LONGEST, above=0))]
"""Metres, more than 0."""
Angle = Annotated[Measured, BeforeValidator(_reader(ANGLES, "30 deg +- 1 deg", WIDEST))]
"""Degrees."""
Exponent = Annotated[Measured, BeforeValidator(_reader({}, "18 +- 2", HIGHEST, least=0))]
"""A bare number, 0 or more."""
