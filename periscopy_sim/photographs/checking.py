"""What any photograph must be before it is used: of the camera's size, real, finite, in range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics.validation import LIGHT_RANGE

_TOO_DARK = "check its sign, and the dark frame that was subtracted from it"
_NOT_REAL = {
    "b": "truth values", "c": "complex numbers", "S": "text", "U": "text", "V": "records",
    "M": "dates", "m": "times", "O": "Python objects, which are never loaded",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph as read from a file.

    Attributes
    ----------
    values : (rows, columns, 3) float64
        Linear light; row 0 is the top.
    warnings : tuple of str
        What had to be assumed or left out, one line each.
    """

    values: NDArray[np.float64]
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return its size, its mean and how many warnings there are on one line."""
        rows, columns = self.values.shape[:2]
        finite = self.values[np.isfinite(self.values)]
        mean = float(finite.mean()) if finite.size else float("nan")
        return f"Photograph({rows}x{columns}, mean {mean:.3g}, {len(self.warnings)} warnings)"

    def __array__(
        self, dtype: np.dtype[Any] | None = None, copy: bool | None = None
    ) -> NDArray[Any]:
        """Return `values`, wherever an array is taken."""
        return np.array(self.values, dtype=dtype, copy=copy)


def check_photograph(
    values: ArrayLike, shape: tuple[int, int], name: str, mask: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Check that an array can be a photograph, and return it in its one form, (rows, columns, 3).

    `values` are (rows, columns), (rows, columns, 1) or (rows, columns, 3), with a single channel
    being grey: finite real numbers, one of them positive, the largest from 1e-30 to 1e30; negatives
    may come of subtracted dark frames. The (rows, columns) bool mask is True where the wall is
    used; elsewhere the photograph may hold anything, also NaN, and keeps it: whoever computes with
    it leaves those pixels out. `name` is what messages call the array. The result is a new float64
    array; a `PhotographError` is raised if any of this does not hold.
    """
    try:
        array = np.asarray(values)
    except ValueError as error:  # rows of different lengths
        raise PhotographError(f"{name}: is no array of numbers ({error}); give one") from error
    check_real(array.dtype, name)
    array = with_channels(array, name)
    check_size(array.shape[:2], shape, name)
    # What is out of range becomes infinite, and is refused below; so are signalling NaNs.
    with np.errstate(over="ignore", invalid="ignore"):
        photograph = np.asarray(array, dtype=np.float64)
    if mask is not None and mask.shape != tuple(shape):
        raise PhotographError(f"{name}: the mask has shape {mask.shape}, not {tuple(shape)}")
    light = used_pixels(photograph, mask)
    if not np.isfinite(light).all():
        broken = np.argwhere(blackened(~np.isfinite(photograph), mask))
        row, column, channel = broken[0]
        counted, them = f"{len(broken)} values are", "them"
        if len(broken) == 1:
            counted, them = "1 value is", "it"
        raise PhotographError(
            f"{name}: {counted} NaN or infinite, the first at row {row}, "
            f"column {column}, channel {channel}; replace {them}, or leave {them} out by a mask"
        )
    if not light.any():
        raise PhotographError(f"{name}: every value is zero; check the exposure or the export")
    if light.max() <= 0:
        raise PhotographError(f"{name}: no value is positive, as light is; {_TOO_DARK}")
    largest = np.abs(light).max()
    if not LIGHT_RANGE[0] <= largest <= LIGHT_RANGE[1]:
        raise PhotographError(f"{name}: its largest value is {largest:.3g}; scale it to about 1")
    return np.repeat(photograph, 3 // photograph.shape[2], axis=2)


def doubts_of(
    photograph: NDArray[np.float64], name: str, mask: NDArray[np.bool_] | None
) -> list[str]:
    """Return lines of doubt about a photograph that passed its checks, but is hardly light."""
    is_dark = np.mean(used_pixels(photograph, mask) < 0) > 0.5
    return [f"{name}: most values are negative; {_TOO_DARK}"] if is_dark else []


def used_pixels(image: NDArray[Any], mask: NDArray[np.bool_] | None) -> NDArray[Any]:
    """Return the pixels of an image that a mask leaves, (M', channels); without one, the image."""
    return image if mask is None else image[mask]


def blackened(image: NDArray[Any], mask: NDArray[np.bool_] | None) -> NDArray[Any]:
    """Return an image, (rows, columns, channels), black where a mask leaves it out.

    So it is drawn, and so a method sees it that takes no mask.
    """
    return image if mask is None else np.where(mask[..., np.newaxis], image, 0)


def with_channels(values: NDArray[Any], name: str) -> NDArray[Any]:
    """Return (rows, columns, 1 or 3) values, which may lack a channel of grey; refuse others."""
    channels = values[..., np.newaxis] if values.ndim == 2 else values
    if channels.ndim != 3 or channels.shape[2] not in (1, 3):
        raise PhotographError(
            f"{name}: has shape {values.shape}; give (rows, columns, 3), or one channel of grey"
        )
    return channels


def check_size(size: tuple[int, ...], shape: tuple[int, int], name: str) -> None:
    """Check that a photograph of (rows, columns) `size` is as large as the camera sees it.

    The message says both sizes, and whether averaging blocks would fix it.
    """
    if tuple(size) == tuple(shape):
        return
    k = size[0] // shape[0]
    if k > 1 and tuple(size) == (k * shape[0], k * shape[1]):
        remedy = f"average {k} x {k} blocks first, by `periscopy prepare`"
    else:
        remedy = (
            "bring it to that size by `periscopy prepare`, or change the film size in the scene "
            "(of shipped ones by -D resolution=N)"
        )
    raise PhotographError(
        f"{name}: {size[0]} x {size[1]} pixels (rows x columns), but the scene's camera has "
        f"{shape[0]} x {shape[1]}; {remedy}"
    )


def check_real(dtype: np.dtype[Any], name: str) -> None:
    """Refuse a dtype whose values are not integers or floating-point numbers."""
    if dtype.kind not in "iuf":
        held = _NOT_REAL.get(dtype.kind, "no numbers")
        raise PhotographError(f"{name}: holds {held} ({dtype}); save real numbers, as float32 say")
