"""What a sweep varies, as users write it: values of axes, ratios, ambient light."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.cli.options import RANGES, in_range, parse_definitions, parse_list
from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.numerics.limits import number_of
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC

DARK = "none"
"""Names photographs without ambient light."""


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
        form = "1,2,5, or 0:1:5, or 0.1:10:log:9, at most {:,}".format(RANGES["count"][1])
        raise PeriscopyError(f"{flag} '{text}': write values as {form}")
    if len({*values}) < len(values):
        raise PeriscopyError(f"{flag} '{text}': give each value once")
    return values


def parse_axes(entries: Iterable[str] | None) -> dict[str, list[Any]]:
    """Read ``--vary NAME=VALUES``, each name once."""
    axes = parse_definitions(entries, "--vary")
    return {name: parse_values(text, f"--vary {name}") for name, text in axes.items()}


def check_numbers(kind: str, flag: str, values: Sequence[Any]) -> list[float]:
    """Return the values of an axis, if they are numbers of a kind."""
    wrong = [each for each in values if not (isinstance(each, float) and in_range(kind, each))]
    if wrong:
        limits = "{:g} to {:g}".format(*RANGES[kind])
        raise PeriscopyError(f"{flag} {wrong[0]}: write numbers from {limits}, without units")
    return [*values]


def parse_ambient(text: str) -> dict[str, Path | None]:
    """Read lighting conditions: names of shipped ones, groups of them, EXR files and folders.

    Return the EXR file of each name; None for a shipped condition, and for `DARK` alone.
    """
    if text == DARK:
        return {DARK: None}
    shipped = *REALISTIC, *ADVERSARIAL
    groups = {"all": REALISTIC, "adversarial": ADVERSARIAL, **{name: [name] for name in shipped}}
    lights: dict[str, Path | None] = {}
    for entry in parse_list("--ambient", text):
        path = Path(entry)
        files = sorted(path.glob("*.exr")) if path.is_dir() else [path]
        added: dict[str, Path | None] = {file.stem: file for file in files if file.suffix == ".exr"}
        added = dict.fromkeys(groups[entry]) if entry in groups else added
        if not added or added.keys() & lights.keys():
            guess = "" if entry in groups else did_you_mean(entry, groups)
            raise PeriscopyError(
                f"--ambient '{entry}': {guess and f'{guess} '}write an EXR file, a folder of EXR "
                f"files, all, adversarial, {', '.join(shipped)}, each once, or {DARK} alone"
            )
        lights |= added
    return lights
