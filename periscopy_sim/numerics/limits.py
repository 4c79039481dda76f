"""Limits on what a file may ask for, checked before it is read: its kind, its bytes, its pixels."""

import errno
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from stat import S_ISREG
from typing import Any, NamedTuple

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics.machine import available_memory
from periscopy_sim.numerics.validation import InputError, checked_number, listed

MOST_PIXELS = 1 << 27
"""Pixels of three colours that are decoded as a whole: a third more than the largest cameras' 102
million, 3.2 GB in double precision."""

PIXEL_BYTES = 48
"""Memory that a pixel takes while it is decoded: three colours in double precision, and a copy."""

MOST_BYTES = 1 << 30
"""Bytes of a file that is read as a whole: a mesh of 20 million triangles."""

MOST_TEXT = 1 << 24
"""Bytes of an XML or JSON document, which the parsers read within a second."""

SMALLEST, LARGEST = 1e-12, 1e12
"""Magnitudes, but for 0, of numbers in scenes, and of their errors: the squares of what is farther
from 1 leave single precision with little to spare."""


class Range(NamedTuple):
    """A kind of number that users give: its ends, and what a command's help and a page say."""

    least: float
    most: float
    whole: bool = False
    unit: str = ""
    help: str = ""

    @property
    def ends(self) -> tuple[float, float]:
        """Its least and greatest number."""
        return self.least, self.most


_SNR = "Signal-to-noise ratio of Gaussian noise; the signal includes ambient light."
RANGES: Mapping[str, Range] = {
    # Mitsuba takes seeds of 32 bits; commands count on from this one.
    "seed": Range(0, 2**31 - 1, True, help="Seed of random draws."),
    "decibels": Range(-100, 300, unit="dB", help=_SNR),
    "ratio": Range(1e-6, 1e6, help="Signal-to-background ratio."),
    "sbr": Range(1e-6, math.inf, help="Signal-to-background ratio; inf: no ambient light."),
    "error": Range(1e-6, 1, help="Relative error of a pixel of ambient light to reach."),
    "tolerance": Range(1e-15, 0.5, help="Singular values of B that are kept, over the largest."),
    "effort": Range(1e-4, 1),
    "rate": Range(0.1, 1000),
    "level": Range(-1e9, 1e9),  # of a camera's counts, which have 32 bits at most
    "side": Range(1, 10_000, True),  # of a block of pixels
    "resolution": Range(2, 2048, True),  # as many pixels as a scene may have
    "grid": Range(2, 100, True),
    "inches": Range(2, 20),
    "count": Range(1, 1000, True),
    "samples": Range(1, 10**8, True),  # photographs of 126 x 126 pixels would take 19 TB
    "rays": Range(1, 65536, True),  # more would be hours in one kernel, which nothing interrupts
    "camera samples": Range(1, 2**20, True),
    "bounces": Range(1, 999_999, True),
    "port": Range(0, 65535, True),
    "parameter": Range(-LARGEST, LARGEST),
    "exposure": Range(SMALLEST, LARGEST),
}
"""The kinds of numbers that users give: in constructors, options, YAML and on the page."""


def in_range(kind: str, *values: float) -> bool:
    """Return whether numbers of a kind are in its range."""
    return all(RANGES[kind].least <= value <= RANGES[kind].most for value in values)


def checked(name: str, values: Any, kind: str) -> list[float]:
    """Return `checked_number`s that a user gives, one or several, of a kind in `RANGES`."""
    kin = RANGES[kind]
    return [checked_number(each, name, *kin.ends, whole=kin.whole) for each in listed(values)]


def number_of(text: str) -> float:
    """Return the number that a text holds, infinity too; NaN if it holds none."""
    try:
        return float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        return math.nan


def size_of(given: Any) -> tuple[int, int]:
    """Return a size, (rows, columns), of two whole numbers or of text: ROWSxCOLUMNS."""
    text = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", str(given), re.IGNORECASE)
    sides = [*map(int, text.groups())] if text else given
    if isinstance(sides, str) or not isinstance(sides, Iterable) or len(sides := [*sides]) != 2:
        raise InputError(f"'{given}' is not a size; write ROWSxCOLUMNS, such as 29x36")
    rows, columns = checked(f"the size {given}: a side of", sides, "side")
    return int(rows), int(columns)


def read_regular(path: Path, most: int = MOST_TEXT) -> bytes:
    """Return the bytes of a regular file; an OSError says that it is none, or has more than `most`.

    Anything else, such as a pipe or a device, could be waited for without end.
    """
    state = path.stat()
    if not S_ISREG(state.st_mode):
        raise OSError(errno.EINVAL, "is a folder or no regular file", str(path))
    if state.st_size > most:
        raise OSError(errno.EFBIG, f"has {state.st_size} bytes, more than {most}", str(path))
    with path.open("rb") as stream:
        return stream.read(state.st_size)  # what the system makes up, as in /proc, has a size of 0


def read_json(path: Path) -> Any:
    """Return what a JSON file holds; a ValueError or an OSError says that it is none."""
    try:
        return json.loads(read_regular(path))
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None


def check_budget(shape: Sequence[int], path: Path) -> None:
    """Reject a file's array that is larger than any photograph, or than the memory.

    The last of three or more dimensions are channels.
    """
    *size, channels = shape if len(shape) > 2 else (*shape, 3)
    pixels, available = math.prod(size) * max(channels / 3, 1), available_memory()
    if pixels > MOST_PIXELS or (available is not None and pixels * PIXEL_BYTES > available):
        text = "x".join(map(str, shape))
        raise PhotographError(
            f"{path}: has {text} values, more than the memory for a picture; make it smaller"
        )
