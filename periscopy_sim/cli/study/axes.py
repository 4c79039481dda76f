"""What a sweep varies, as users write it: values of axes, ratios, ambient light."""

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from periscopy_sim.cli.options import parse_definitions
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.numerics.limits import RANGES, in_range, number_of


def parse_values(text: str, flag: str) -> list[Any]:
    """Read the values of an axis: ``1,2,5`` or words, ``0:1:5``, or ``0.1:10:log:9`` (or ``lin``).

    Values that are all numbers become such.
    """
    steps = re.fullmatch("(.+?):(.+?):(?:(log|lin):)?([0-9]{1,4})", text)
    words = [*steps.groups()[:2]] if steps else text.split(",")
    values: list[Any] = [number_of(each) for each in words]
    if steps:
        valid = np.isfinite(values).all() and (steps[3] != "log" or min(values) > 0)
        space: Any = np.geomspace if steps[3] == "log" else np.linspace
        values = [float(f"{each:.6g}") for each in space(*values, int(steps[4]))] if valid else []
    elif not np.isfinite(values).all():
        is_range = ":" in text and np.isfinite([number_of(each) for each in text.split(":")]).all()
        values = [] if is_range else [each.strip() for each in words]
    if not (in_range("count", len(values)) and all(map(str, values))):
        form = "1,2,5, or 0:1:5, or 0.1:10:log:9, at most {:,}".format(RANGES["count"].most)
        raise PeriscopyError(f"{flag} '{text}': write values as {form}")
    if len({*values}) < len(values):
        raise PeriscopyError(f"{flag} '{text}': give each value once")
    return values


def parse_axes(entries: Iterable[str] | None) -> dict[str, list[Any]]:
    """Read ``--vary NAME=VALUES``, each name once."""
    axes = parse_definitions(entries, "--vary")
    return {name: parse_values(text, f"--vary {name}") for name, text in axes.items()}
