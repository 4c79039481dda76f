"""One photograph of the relay wall with all that belongs to it, checked once."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, repeat
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.numerics.validation import LIGHT_RANGE, InputError, plain_array

LARGEST_CONDITION = 100.0
"""Condition number from which a matrix no longer separates two primaries: real cameras have 2 to
10."""

CODES = (
    "8-bit integers, taken as linear light; if they are encoded for screens, as most are, give the "
    "PNG or JPEG file, which is decoded, or linear light as float"
)
"""A warning of photographs that are arrays."""


@dataclass(frozen=True, eq=False)
class ColourMatrix:
    """M of y_j = Σ_k M_jk A f_k + B c_j + n_j, f_k in the monitor's primaries.

    Attributes
    ----------
    matrix
        (C, P), the camera's C channels down, the monitor's P primaries across: column k is the
        colour that the camera sees where the monitor shows primary k alone.

    Raises
    ------
    ValueError
        If the matrix is not of finite real numbers, has fewer channels than primaries, or two
        primaries look alike.
    """

    matrix: Array

    def __post_init__(self) -> None:
        values = np.asarray(self.matrix)
        is_real = values.ndim == 2 and values.size and values.dtype.kind in "iuf"
        if not is_real or not np.isfinite(values).all():
            raise InputError(
                "a colour matrix is (channels, primaries) finite real numbers, not of shape "
                f"{values.shape} and type {values.dtype}"
            )
        channels, primaries = values.shape
        if channels < primaries or np.linalg.cond(values) > LARGEST_CONDITION:
            raise InputError(
                "two primaries look alike to the camera: the colour matrix, (channels, primaries), "
                f"is {channels} x {primaries} and of too low a rank"
            )
        object.__setattr__(self, "matrix", values.astype(np.float64))

    @classmethod
    def of(cls, matrix: "ColourMatrix | ArrayLike | None") -> "ColourMatrix | None":
        """Return a colour matrix, of an array too; None for the identity."""
        is_made = matrix is None or isinstance(matrix, ColourMatrix)
        return matrix if is_made else cls(np.asarray(matrix))  # type: ignore[return-value]

    def mix(self, light: Image) -> Array:
        """Return light in the camera's channels, (..., C), from light in the primaries."""
        return np.asarray(light @ self.matrix.T, np.float64)

    def unmix(self, light: Image) -> Array:
        """Return light in the primaries, (..., P), from light in the camera's channels.

        More channels than primaries are fitted by least squares.
        """
        return np.asarray(light @ np.linalg.pinv(self.matrix).T, np.float64)


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph of the relay wall; make one with `Photograph.of` or by reading a file.

    Methods, videos, sweeps and calibrations use all of it. An array cannot hold its conditions (the
    mask, the photographs with the monitor off and the colour matrix): NumPy converts a photograph
    that has none alone.

    Attributes
    ----------
    values : (rows, columns, C) float64
        Linear light in the camera's C channels, one if it is grey; row 0 is the top. Pixels outside
        the mask may hold anything, also NaN.
    mask : (rows, columns) bool or None
        True where methods use the photograph; None for everywhere.
    monitor_off : mapping of str to (rows, columns, C) float64
        Photographs of the same wall with the monitor off, by name; in any unit, of any exposure.
    colour_matrix : ColourMatrix, array or None
        From the monitor's primaries, in which hidden images are, to the camera's channels; None for
        the identity.
    warnings : tuple of str
        What the reader had to assume or leave out, one line each.
    relative_error : float or None
        A rendered photograph's own error before noise, over its root mean square; else None.
    """

    values: Array
    mask: Mask | None = None
    monitor_off: Mapping[str, Array] = field(default_factory=dict)
    colour_matrix: ColourMatrix | None = None
    warnings: tuple[str, ...] = ()
    relative_error: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "colour_matrix", ColourMatrix.of(self.colour_matrix))
        for name, light in self.monitor_off.items():
            if light.shape != self.values.shape:
                raise PhotographError(
                    f"{name}: has shape {light.shape}, the photograph {self.values.shape}; take "
                    "both by one camera"
                )
        if self.colour_matrix is not None and len(self.colour_matrix.matrix) != self.channels:
            raise PhotographError(
                f"the photograph has {self.channels} channels, the colour matrix "
                f"{len(self.colour_matrix.matrix)} rows; give the camera's own matrix"
            )

    @classmethod
    def of(
        cls,
        values: ArrayLike,
        shape: tuple[int, int] | None = None,
        name: str = "photograph",
        *,
        mask: Mask | None = None,
        monitor_off: Mapping[str, ArrayLike] | Sequence[ArrayLike] | None = None,
        colour_matrix: ColourMatrix | ArrayLike | None = None,
        warnings: tuple[str, ...] = (),
    ) -> "Photograph":
        """Return a checked photograph from arrays, which are copied.

        Parameters
        ----------
        values
            (rows, columns), which is one channel of grey, or (rows, columns, C) real numbers.
            Inside the mask they are finite, one is positive, and the largest is from 1e-30 to 1e30.
            A subtracted dark frame may leave negative values.
        shape
            (rows, columns) of the scene's camera; None for any.
        name
            What messages call the photograph.
        mask, colour_matrix
            As the attributes.
        monitor_off
            Photographs with the monitor off, of the same size and channels, by name or in a
            sequence.
        warnings
            Lines of the reader. One is added for 8-bit integers, and one if most values are
            negative.

        Raises
        ------
        PhotographError
            If an array is no such photograph.
        """
        mask = None if mask is None else np.array(mask)
        light = _checked(values, shape, name, mask)
        if getattr(values, "dtype", None) == np.uint8:
            warnings = (*warnings, f"{name}: {CODES}")
        if np.mean(light[... if mask is None else mask] < 0) > 0.5:
            warnings = (*warnings, f"{name}: most values are negative; check the dark frame")
        off = {} if monitor_off is None else monitor_off
        if not isinstance(off, Mapping):
            off = {f"monitor-off photograph {k}": each for k, each in enumerate(off, 1)}
        size = light.shape[0], light.shape[1]
        dark = {each: _checked(values, size, each, mask) for each, values in off.items()}
        return cls(light, mask, dark, ColourMatrix.of(colour_matrix), warnings)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.values.shape[0], self.values.shape[1]

    @property
    def channels(self) -> int:
        """C, the number of the camera's channels."""
        return int(self.values.shape[2])

    @property
    def pixels(self) -> Mask:
        """(rows, columns) bool, True inside the mask; without one, everywhere."""
        return np.ones(self.shape, bool) if self.mask is None else self.mask

    @property
    def used(self) -> Array:
        """(M', C) values of the pixels inside the mask, row-major."""
        return self.values[self.pixels]

    @property
    def planes(self) -> Array:
        """(C, rows, columns) values, NaN outside the mask."""
        return np.where(self.pixels, np.moveaxis(self.values, -1, 0), np.nan)

    @cached_property
    def conditions(self) -> bytes | None:
        """Digest of mask, photographs with the monitor off and colour matrix; None without any."""
        if self.mask is None and not self.monitor_off and self.colour_matrix is None:
            return None
        matrix = () if self.colour_matrix is None else (self.colour_matrix.matrix,)
        digest = hashlib.sha256()
        for each in (self.pixels, *self.monitor_off.values(), *matrix):
            digest.update(str(each.shape).encode())
            digest.update(each.tobytes())
        return digest.digest()

    def unmixed(self) -> "Photograph":
        """Return the photograph in the monitor's primaries, black outside the mask."""
        if (colours := self.colour_matrix) is None:
            return self
        off = {each: colours.unmix(light) for each, light in self.monitor_off.items()}
        values = colours.unmix(blackened(self.values, self.mask))
        return replace(self, values=values, monitor_off=off, colour_matrix=None)

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
                "the photograph has a mask, photographs with the monitor off or a colour matrix, "
                "which an array cannot hold; give the photograph itself, or its values"
            )
        return np.array(self.values, dtype=dtype, copy=copy)


def _checked(
    values: ArrayLike, shape: tuple[int, int] | None, name: str, mask: Mask | None
) -> Array:
    """Return values as (rows, columns, C) float64; see `Photograph.of`."""
    array = plain_array(values, name)
    check_real(array.dtype, name)
    array = with_channels(array, name)
    if shape is not None:
        check_size(array.shape[:2], shape, name)
    with np.errstate(over="ignore", invalid="ignore"):  # of longer floats, and signalling NaN
        light = np.array(array, dtype=np.float64, order="C")
    if mask is not None and (mask.shape != light.shape[:2] or mask.dtype != np.bool_):
        raise PhotographError(
            f"{name}: the mask is {mask.shape} of {mask.dtype}; give {light.shape[:2]} of bool"
        )
    if len(broken := np.argwhere(blackened(~np.isfinite(light), mask))):
        row, column, channel = broken[0]
        raise PhotographError(
            f"{name}: NaN or infinite values: {len(broken)}, the first at row {row}, column "
            f"{column}, channel {channel}; replace them, or leave them out by a mask"
        )
    used = light[... if mask is None else mask]
    if not (used > 0).any():
        raise PhotographError(
            f"{name}: no value inside the mask is positive; check the exposure, the dark frame and "
            "the mask, True where the wall is"
        )
    if not LIGHT_RANGE[0] <= (largest := np.abs(used).max()) <= LIGHT_RANGE[1]:
        raise PhotographError(f"{name}: its largest value is {largest:.3g}; scale it to about 1")
    return light


def of_one_wall(
    photographs: Any, shape: tuple[int, int] | None = None, names: Iterable[str] = ()
) -> list[Photograph]:
    """Return photographs of one wall, each checked, with the conditions of all of them.

    They are one photograph, a sequence or a stack, of `Photograph`s or arrays. Each gets the mask
    of the pixels that all masks leave, all photographs with the monitor off, of equal ones one, and
    the colour matrix. Messages call them by `names`. A PhotographError says that one is no
    photograph of this shape, or that they have different colour matrices.
    """
    is_one = isinstance(photographs, Photograph)
    if is_one or not (isinstance(photographs, Sequence) or np.ndim(photographs) == 4):
        photographs = [photographs]
    given = [each for each in photographs if isinstance(each, Photograph)]
    mask, off = None, dict[str, Array]()
    matrices = [each.colour_matrix for each in given if each.colour_matrix is not None]
    for k, each in enumerate(given, 1):
        mask = common_pixels(mask, each.mask)
        for name, light in each.monitor_off.items():
            if not any(np.array_equal(light, other, equal_nan=True) for other in off.values()):
                off[f"{name} of photograph {k}" if name in off else name] = light
    if any(not np.array_equal(each.matrix, matrices[0].matrix) for each in matrices):
        raise PhotographError("the photographs have different colour matrices; give one")
    common: dict[str, Any] = {"mask": mask, "monitor_off": off}
    common["colour_matrix"] = matrices[0] if matrices else None
    checked = list[Photograph]()
    for each, name in zip(photographs, chain(names, repeat("photograph")), strict=False):
        is_known = isinstance(each, Photograph)
        y = Photograph.of(each.values if is_known else each, shape, name, **common)
        checked.append(replace(y, relative_error=each.relative_error if is_known else None))
    return checked


def common_pixels(mask: Mask | None, other: Mask | None) -> Mask | None:
    """Return the mask of the pixels that two masks leave; None for everywhere."""
    if mask is None or other is None:
        return other if mask is None else mask
    if mask.shape != other.shape:
        raise PhotographError(f"masks of {mask.shape} and {other.shape} pixels; give one size")
    return mask & other


def blackened(image: NDArray[Any], mask: Mask | None) -> NDArray[Any]:
    """Return a (rows, columns, channels) image that is black outside the mask.

    Figures and methods that take no mask get such an image.
    """
    return image if mask is None else np.where(mask[..., np.newaxis], image, 0)


def with_channels(values: NDArray[Any], name: str) -> NDArray[Any]:
    """Return (rows, columns, C) values from those, or from (rows, columns) values of grey."""
    channels = values[..., np.newaxis] if values.ndim == 2 else values
    if channels.ndim != 3 or not channels.shape[2]:
        raise PhotographError(
            f"{name}: has shape {values.shape}; give (rows, columns, channels), or (rows, columns) "
            "of grey"
        )
    return channels


def seen_in(light: NDArray[Any], channels: int) -> NDArray[Any]:
    """Return rendered light, (..., C), as a camera of some channels sees it.

    A grey camera sees the mean of the C channels. Other numbers than C are a PhotographError.
    """
    if channels == 1:
        return np.asarray(light.mean(axis=-1, keepdims=True))
    if light.shape[-1] != channels:
        raise PhotographError(
            f"rendered light has {light.shape[-1]} channels, the photograph {channels}; give "
            f"photographs of {light.shape[-1]} channels, or of one"
        )
    return light


def check_size(size: tuple[int, ...], shape: tuple[int, int], name: str) -> None:
    """Check that (rows, columns) of a photograph are those of the scene's camera."""
    if tuple(size) != tuple(shape):
        raise PhotographError(
            f"{name}: {size[0]} x {size[1]} pixels (rows x columns), but the scene's camera has "
            f"{shape[0]} x {shape[1]}; `prepare` brings it to that size; or change the film's size "
            "in the scene (of shipped ones by the parameter resolution or film)"
        )


def check_real(dtype: np.dtype[Any], name: str) -> None:
    """Check that the values of a dtype are integers or floating-point numbers."""
    if dtype.kind not in "iuf":
        raise PhotographError(f"{name}: holds {dtype} values; save real numbers, as float32 say")
