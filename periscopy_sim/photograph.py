"""One photograph of the relay wall with all that belongs to it, checked once."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics.validation import LIGHT_RANGE, plain_array

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph of the relay wall; make one with `Photograph.of` or by reading a file.

    Methods, videos, sweeps and calibrations use all of it. An array cannot hold the mask or the
    photographs with the monitor off: NumPy converts a photograph that has none alone.

    Attributes
    ----------
    values : (rows, columns, 3) float64
        Linear light; row 0 is the top. Pixels outside the mask may hold anything, also NaN.
    mask : (rows, columns) bool or None
        True where methods use the photograph; None for everywhere.
    monitor_off : mapping of str to (rows, columns, 3) float64
        Photographs of the same wall with the monitor off, by name.
    warnings : tuple of str
        What the reader had to assume or leave out, one line each.
    """

    values: Array
    mask: Mask | None = None
    monitor_off: Mapping[str, Array] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        values: ArrayLike,
        shape: tuple[int, int] | None = None,
        name: str = "photograph",
        *,
        mask: Mask | None = None,
        monitor_off: Mapping[str, ArrayLike] | Sequence[ArrayLike] | None = None,
        warnings: tuple[str, ...] = (),
    ) -> "Photograph":
        """Return a checked photograph from arrays, which are copied.

        Parameters
        ----------
        values
            (rows, columns), (rows, columns, 1) or (rows, columns, 3) real numbers, where one
            channel is grey. Inside the mask they are finite, one is positive, and the largest is
            from 1e-30 to 1e30. A subtracted dark frame may leave negative values.
        shape
            (rows, columns) of the scene's camera; None for any.
        name
            What messages call the photograph.
        mask
            (rows, columns) bool, True where methods use the photograph; None for everywhere.
        monitor_off
            Photographs with the monitor off, of the same shape, by name or in a sequence.
        warnings
            Lines of the reader. One is added if most values are negative.

        Raises
        ------
        PhotographError
            If an array is no such photograph.
        """
        mask = None if mask is None else np.array(mask)
        light = _checked(values, shape, name, mask)
        if np.mean(used_pixels(light, mask) < 0) > 0.5:
            warnings = (*warnings, f"{name}: most values are negative; check the dark frame")
        off = {} if monitor_off is None else monitor_off
        if not isinstance(off, Mapping):
            off = {f"monitor-off photograph {k}": each for k, each in enumerate(off, 1)}
        size = (light.shape[0], light.shape[1])
        return cls(light, mask, {k: _checked(v, size, k, mask) for k, v in off.items()}, warnings)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.values.shape[0], self.values.shape[1]

    @property
    def pixels(self) -> Mask:
        """(rows, columns) bool, True inside the mask; without one, everywhere."""
        return np.ones(self.shape, bool) if self.mask is None else self.mask

    @property
    def used(self) -> Array:
        """(M', 3) values of the pixels inside the mask, row-major."""
        return self.values[self.pixels]

    @property
    def planes(self) -> Array:
        """(3, rows, columns) values, NaN outside the mask."""
        return np.where(self.pixels, np.moveaxis(self.values, -1, 0), np.nan)

    @property
    def conditions(self) -> bytes | None:
        """Digest of the mask and the photographs with the monitor off; None without any."""
        if self.mask is None and not self.monitor_off:
            return None
        digest = hashlib.sha256()
        for each in (self.pixels, *self.monitor_off.values()):
            digest.update(each.tobytes())
        return digest.digest()

    def __repr__(self) -> str:
        """Return its size, its mean and how many warnings there are on one line."""
        finite = self.used[np.isfinite(self.used)]
        mean = float(finite.mean()) if finite.size else float("nan")
        size = "x".join(map(str, self.shape))
        return f"Photograph({size}, mean {mean:.3g}, {len(self.warnings)} warnings)"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return `values`, for functions of arrays; a PhotographError if they are not all."""
        if self.conditions is not None:
            raise PhotographError(
                "the photograph has a mask, or photographs with the monitor off, which an array "
                "cannot hold; give its values and these apart"
            )
        return np.array(self.values, dtype=dtype, copy=copy)


def _checked(
    values: ArrayLike, shape: tuple[int, int] | None, name: str, mask: Mask | None
) -> Array:
    """Return values as (rows, columns, 3) float64; see `Photograph.of`."""
    try:
        array = plain_array(values, name)
    except PhotographError:
        raise
    except ValueError as error:  # rows of different lengths
        raise PhotographError(f"{name}: is no array of numbers ({error}); give one") from error
    check_real(array.dtype, name)
    array = with_channels(array, name)
    if shape is not None:
        check_size(array.shape[:2], shape, name)
    with np.errstate(over="ignore", invalid="ignore"):  # of longer floats, and signalling NaN
        light = np.asarray(array, dtype=np.float64)
    if mask is not None and (mask.shape != light.shape[:2] or mask.dtype != np.bool_):
        raise PhotographError(
            f"{name}: the mask is {mask.shape} of {mask.dtype}; give {light.shape[:2]} of bool"
        )
    if mask is not None and not mask.any():
        raise PhotographError(
            f"{name}: the mask leaves out every pixel; it is True where the wall is"
        )
    broken = np.argwhere(blackened(~np.isfinite(light), mask))
    if len(broken):
        counted = "1 value is" if len(broken) == 1 else f"{len(broken)} values are"
        row, column, channel = broken[0]
        raise PhotographError(
            f"{name}: {counted} NaN or infinite, the first at row {row}, column {column}, channel "
            f"{channel}; replace them, or leave them out by a mask"
        )
    used = used_pixels(light, mask)
    if not used.any():
        raise PhotographError(f"{name}: every value is zero; check the exposure or the export")
    if used.max() <= 0:
        raise PhotographError(f"{name}: no value is positive, as light is; check the dark frame")
    if not LIGHT_RANGE[0] <= (largest := np.abs(used).max()) <= LIGHT_RANGE[1]:
        raise PhotographError(f"{name}: its largest value is {largest:.3g}; scale it to about 1")
    return np.repeat(light, 3 // light.shape[2], axis=2)


def unwrapped(
    photographs: Any, mask: Mask | None = None, monitor_off: Mapping[str, Any] | None = None
) -> tuple[list[Any], Mask | None, dict[str, Any]]:
    """Return the values of photographs of one wall, and the mask and the backgrounds of all.

    They are one photograph, a sequence or a stack, of which `Photograph`s add to the mask and the
    photographs with the monitor off that are given; of equal ones, one.
    """
    is_one = isinstance(photographs, Photograph)
    if is_one or not (isinstance(photographs, Sequence) or np.ndim(photographs) == 4):
        photographs = [photographs]
    values, off = [], dict(monitor_off or {})
    for k, each in enumerate(photographs, 1):
        values.append(each.values if isinstance(each, Photograph) else each)
        if isinstance(each, Photograph):
            mask = common_pixels(mask, each.mask)
            for name, light in each.monitor_off.items():
                if not any(np.array_equal(light, other, equal_nan=True) for other in off.values()):
                    off[f"{name} of photograph {k}" if name in off else name] = light
    return values, mask, off


def common_pixels(mask: Mask | None, other: Mask | None) -> Mask | None:
    """Return the mask of the pixels that two masks leave; None for everywhere."""
    if mask is None or other is None:
        return other if mask is None else mask
    if mask.shape != other.shape:
        raise PhotographError(f"masks of {mask.shape} and {other.shape} pixels; give one size")
    return mask & other


def used_pixels(image: NDArray[Any], mask: Mask | None) -> NDArray[Any]:
    """Return the pixels of an image inside a mask, (M', channels); without a mask, the image."""
    return image if mask is None else image[mask]


def blackened(image: NDArray[Any], mask: Mask | None) -> NDArray[Any]:
    """Return a (rows, columns, channels) image that is black outside the mask.

    Figures and methods that take no mask get such an image.
    """
    return image if mask is None else np.where(mask[..., np.newaxis], image, 0)


def with_channels(values: NDArray[Any], name: str) -> NDArray[Any]:
    """Return (rows, columns, 1 or 3) values from those or from (rows, columns) values."""
    channels = values[..., np.newaxis] if values.ndim == 2 else values
    if channels.ndim != 3 or channels.shape[2] not in (1, 3):
        raise PhotographError(
            f"{name}: has shape {values.shape}; give (rows, columns, 3), or one channel of grey"
        )
    return channels


def check_size(size: tuple[int, ...], shape: tuple[int, int], name: str) -> None:
    """Check that (rows, columns) of a photograph are those of the scene's camera."""
    if tuple(size) != tuple(shape):
        raise PhotographError(
            f"{name}: {size[0]} x {size[1]} pixels (rows x columns), but the scene's camera has "
            f"{shape[0]} x {shape[1]}; bring it to that size by `periscopy prepare`, or change the "
            "film size in the scene (of shipped ones by -D resolution=N)"
        )


def check_real(dtype: np.dtype[Any], name: str) -> None:
    """Check that the values of a dtype are integers or floating-point numbers."""
    if dtype.kind not in "iuf":
        raise PhotographError(f"{name}: holds {dtype} values; save real numbers, as float32 say")
