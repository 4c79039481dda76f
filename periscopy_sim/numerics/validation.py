"""Validation of what is given: numbers and their ranges, arrays, files before they are read."""

import errno
import json
import math
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from os import PathLike
from pathlib import Path
from stat import S_ISREG
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PeriscopyError, PhotographError
from periscopy_sim.numerics.machine import available_memory

LIGHT_RANGE = (1e-30, 1e30)
"""Least and greatest that a photograph's largest value may be: P is of single precision, and the
squares of what is farther from 1 leave double precision."""

FINITE = float(np.finfo(np.float64).max)
"""Largest finite number."""

AXES = ("row", "column", "channel")
"""Names of a photograph's dimensions, where they are labelled."""


class InputError(PeriscopyError):
    """A value that a function of arrays cannot use; a command adds the file or option it is of."""


def plain_array(values: Any, name: str = "the photograph") -> NDArray[Any]:
    """Return values as an array in the order of their dimensions, where these have names.

    NumPy drops masks and names. Masked values, other names, and what holds no real numbers, such as
    a file's name, are a `PhotographError`.
    """
    axes = getattr(values, "dims", ())
    if axes and isinstance(axes, tuple):
        if not set(axes) <= set(AXES):
            raise PhotographError(f"{name}: has dimensions {axes}; name them {', '.join(AXES)}")
        values = values.transpose(*(axis for axis in AXES if axis in axes))
    if np.ma.is_masked(values):
        raise PhotographError(f"{name}: has masked values; give the mask apart, True where used")
    array = np.asarray(values)
    if array.dtype.kind not in "buif":
        kind = f"{type(values).__name__} ({array.dtype})"
        raise PhotographError(f"{name} is of type {kind}; give an array of real numbers")
    return array


def checked_number(
    value: Any, name: str, least: float = -FINITE, most: float = FINITE, *, whole: bool = False
) -> float:
    """Return a number, within limits and perhaps a whole one, as such; else raise an InputError."""
    number = value.item() if getattr(value, "shape", None) == () else value
    is_number = isinstance(number, Real) and not isinstance(number, bool)
    if not (is_number and least <= number <= most and (not whole or number == int(number))):
        ends = (("from", least, -FINITE), ("to", most, FINITE))
        limits = "".join(f" {word} {end:.10g}" for word, end, none in ends if end != none)
        kind = "whole " if whole else "finite " if most == FINITE else ""
        is_quoted = isinstance(value, str) and math.isfinite(number_of(value))
        quotes = ", without quotes" if is_quoted else ""
        prefix = name if name.endswith("=") else f"{name} "
        raise InputError(f"{prefix}{number}: give a {kind}number{limits}{quotes}")
    return int(number) if whole else float(number)


def is_name(value: Any) -> bool:
    """Return whether a value is a name, or a file's path."""
    return isinstance(value, str | PathLike)


def listed(values: Any) -> list[Any]:
    """Return the entries of a list; a name or a number alone is a list of one."""
    is_one = is_name(values) or getattr(values, "shape", None) == ()
    return [values] if is_one or not isinstance(values, Iterable) else [*values]


def checked_scene(scene: Any) -> None:
    """Reject what is no scenario by an InputError; anything with its attributes is one."""
    if not (hasattr(scene, "photograph_shape") and hasattr(scene, "hidden")):
        raise InputError(
            f"the scene is of type {type(scene).__name__}: give a scenario, which "
            "ps.load_scenario(name, hidden=(rows, columns)) returns"
        )


def checked_matrix(values: Any, name: str) -> NDArray[np.floating[Any]]:
    """Return a dense matrix of real numbers as an array of the machine's floats.

    float16, float32 and float64 stay as they are, without a copy; other real numbers become
    float64. Anything else, such as what is sparse, complex or masked, is an `InputError`.
    """
    try:
        array, reason = np.asarray(values), "give a dense (rows, columns) array of real numbers"
    except (TypeError, ValueError, RuntimeError) as error:  # of another library
        array, reason = np.asarray(None), str(error).partition("\n")[0]
    if array.ndim != 2 or array.dtype.kind not in "iuf" or np.ma.is_masked(values):
        shape, kind = (getattr(values, each, getattr(array, each)) for each in ("shape", "dtype"))
        raise InputError(
            f"{name} is of type {type(values).__name__} ({kind}), shape {tuple(shape)}: {reason}"
        )
    is_kept = array.dtype.kind == "f" and array.dtype.isnative and array.itemsize <= 8
    return array if is_kept else array.astype(np.float64)


def checked_image(image: ArrayLike, name: str = "image") -> NDArray[Any]:
    """Return a finite floating-point image, of any shape, as compiled loops take it.

    The values are the same, C-contiguous, aligned and writeable (each other kind of array would
    have the loops compiled anew): float32 from float16 and float32, else float64. Not necessarily a
    copy.
    """
    values = np.asarray(image)
    if values.dtype.kind != "f":
        raise TypeError(f"{name} is of type {values.dtype}: convert it to floating point")
    if not np.isfinite(values).all():
        raise InputError(f"{name} holds NaN or infinity: replace those values first")
    single = values.dtype.itemsize <= 4
    return np.require(values, np.float32 if single else np.float64, ["C", "A", "W"])


def checked_companion(image: ArrayLike, name: str, beside: NDArray[Any]) -> NDArray[Any]:
    """Return a companion of an image, checked like it, in its shape and precision."""
    values = checked_image(image, name)
    if values.shape != beside.shape:
        raise InputError(f"{name} has shape {values.shape}, the image beside it {beside.shape}")
    return values.astype(beside.dtype, copy=False)


def check_stopping(tolerance: float, max_iterations: int = 1) -> None:
    """Reject a relative tolerance outside (0, 1), and fewer iterations than one."""
    checked_number(tolerance, "tolerance", 1e-300, np.nextafter(1, 0))
    checked_number(max_iterations, "max_iterations", 1, whole=True)


def warn_unconverged(
    what: str, iterations: int, error: float, tolerance: float, stacklevel: int = 3
) -> None:
    """Warn, where an error exceeds its tolerance, that iterations stopped too early."""
    if not error <= tolerance:
        warnings.warn(
            f"{what} stopped after {iterations} iterations at a relative error of {error:.1e}, "
            f"above {tolerance:.1e}: raise max_iterations or tolerance",
            RuntimeWarning,
            stacklevel=stacklevel + 1,
        )


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
    """Return `checked_number`s that a user gives, one or several, of a kind in `RANGES`.

    In a list of texts, as axes of names are read, the error names one that is no number.
    """
    kin, entries = RANGES[kind], listed(values)
    words = [v for v in entries if isinstance(v, str) and not math.isfinite(number_of(v))]
    return [checked_number(each, name, *kin.ends, whole=kin.whole) for each in words or entries]


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


WORDS = {"direct": 1, "all": None}
"""Most reflections of a path, by the words of options and records."""

WAYS: Mapping[str, Literal["areas", "rays"]] = {"analytic": "areas", "rendered": "rays"}
"""Ways to A, by the same."""


def bounces_in_words(bounces: int | None) -> str:
    """Return how records and commands name a number of reflections: direct, all, or how many."""
    return next((word for word, count in WORDS.items() if count == bounces), str(bounces))


def bounces_of_words(text: str) -> int | None:
    """Return the number of reflections that `bounces_in_words` names, or raise an InputError."""
    is_whole = text.isascii() and text.isdecimal()
    if text not in WORDS and not (is_whole and in_range("bounces", float(text))):
        ends = "{} to {}".format(*RANGES["bounces"])
        raise InputError(f"'{text}': give direct, all, or a whole number from {ends}")
    return WORDS[text] if text in WORDS else int(text)


def percentages(*fractions: float) -> tuple[str, ...]:
    """Return fractions in percent, with three digits."""
    return tuple(f"{100 * each:.3g}" for each in fractions)


def with_error(value: float, error: float, unit: str = "") -> str:
    """Return a value, its standard error, which has two digits, and their unit, if any."""
    digits = max(0, 1 - int(f"{error:e}".partition("e")[2]))
    return f"{value:z.{digits}f} ± {error:.{digits}f} {unit}".rstrip()
