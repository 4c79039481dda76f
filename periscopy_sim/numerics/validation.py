"""Validation of what solvers are given: light, images for compiled loops, weights, tolerances."""

import warnings
from collections.abc import Iterable
from numbers import Real
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PeriscopyError, PhotographError

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
        quotes = ", without quotes" if isinstance(value, str) else ""
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
