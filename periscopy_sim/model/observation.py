"""The pixels of a photograph that are used, and the way from images to the vectors of y = A f.

With a colour matrix M, a photograph's channel is y_j = Σ_k M_jk g_k A f_k + B c_j + n_j, g the
wall's colour. So a grey wall would show Σ_k (M_jk g_k/g_j) A f_k.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.colour_matrix import ColourMatrix
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.numerics.validation import LIGHT_RANGE, InputError, plain_array

Backgrounds: TypeAlias = Sequence[Image] | Mapping[str, Image]
"""Photographs with the monitor off, (rows, columns, 3) or (M, 3) each; errors call them by their
names, or by number."""


@dataclass(frozen=True, eq=False)
class Observation:
    """The sizes of photograph and hidden image, the wall's colour, and where the wall is used.

    Make one by `observation_of`. Every vector omits the pixels that the mask excludes, whatever
    they hold.
    """

    pixels: int  # M, of the photograph
    hidden_shape: tuple[int, int]  # (R, C)
    channel_gain: Array  # (3,) colour of the wall
    mask: Mask | None = None  # (rows, columns) or (M,), True in the M' pixels used; None for all
    photograph_shape: tuple[int, int] | None = None  # (rows, columns), where it is known
    backgrounds: Mapping[str, Array] = field(default_factory=dict)  # (3, M') planes, by name
    mixing: Array = field(default_factory=lambda: np.eye(3))  # (3, 3) from f_k to grey planes
    unmixing: Array | None = None  # (3, 3) that `planar` applies; None for none

    @cached_property
    def hidden(self) -> Hidden:
        """The hidden surfaces."""
        return Hidden.of(self.hidden_shape)

    def used(self, matrix: Image | None) -> Image:
        """Return the rows of A or B, (M, K), of the M' pixels used; of no B, (M', 0)."""
        matrix = np.zeros((self.pixels, 0)) if matrix is None else matrix
        if len(matrix) != self.pixels:
            raise InputError(f"B has {len(matrix)} rows; they must match the {self.pixels} of A")
        return matrix if self.mask is None else matrix[self.mask.ravel()]

    def ambient(self) -> Image:
        """Return the columns of ambient light that K backgrounds show, (M', 3 K)."""
        return np.hstack([self.used(None), *(each.T for each in self.backgrounds.values())])

    def joined(self, B: Image) -> Image:
        """Return B beside the backgrounds, (M, L + 3 K), for callers that select used rows later.

        The backgrounds are 0 where the mask excludes them.
        """
        if not self.backgrounds:
            return B
        columns = self.ambient()
        whole = np.zeros((self.pixels, columns.shape[1]))
        whole[... if self.mask is None else self.mask.ravel()] = columns
        return np.hstack([B, whole])

    def used_transport(self, A: Image) -> Array:
        """Return the rows of A that are used, (M', N) float64; a ValueError if not finite."""
        used = np.ascontiguousarray(self.used(A), np.float64)
        if not np.isfinite(used).all():
            raise InputError("A must be finite")
        return used

    def unmixed(self) -> Observation:
        """Return an observation whose planes are in the monitor's primaries, their noise mixed."""
        if np.array_equal(self.mixing, np.eye(3)):
            return self
        inverse = np.asarray(np.linalg.inv(self.mixing), np.float64)
        backgrounds = {name: inverse @ planes for name, planes in self.backgrounds.items()}
        return replace(self, mixing=np.eye(3), unmixing=inverse, backgrounds=backgrounds)

    def mixed(self, image: Image) -> Array:
        """Return an image, (R, C, 3) or (N, 3), in the planes' channels, as (N, 3) float64."""
        return np.asarray(image, np.float64).reshape(-1, 3) @ self.mixing.T

    def vectorized(self, photograph: Image) -> Array:
        """Return a photograph as a grey wall would show it, the y of y = A f, (M', 3) float64.

        See `planar`, of one photograph.
        """
        return np.ascontiguousarray(self.planar(plain_array(photograph)[None])[0].T)

    def planar(self, photographs: Image) -> Array:
        """Return photographs' planes, (K, 3, M') float64, each channel divided by its gain.

        They are in the camera's channels, or of an `unmixed` observation in the primaries.

        Photographs are (K, rows, columns, 3) or (K, M, 3). A ValueError says that they are of
        another size, see `check_size`, or not finite where they are used.
        """
        photographs = np.asarray(photographs)
        if photographs.dtype.kind not in "buif":
            raise InputError(f"the photograph is of type {photographs.dtype}; give real numbers")
        if photographs.dtype == np.uint8:
            warnings.warn(
                "the photograph is of 8-bit integers, taken as linear light; if they are encoded "
                "for screens, as most are, read the file by ps.read_photograph, which decodes it",
                stacklevel=4,
            )
        self.check_size(photographs.shape)
        values = photographs.reshape(len(photographs), self.pixels, 3)
        if self.mask is not None:
            values = values[:, self.mask.ravel()]
        planes = np.moveaxis(values, -1, 1)
        grey = np.divide(planes, self.channel_gain[:, None], order="C", dtype=np.float64)
        if not np.isfinite(grey).all():
            raise InputError("the photograph must be finite")
        largest = float(np.abs(grey).max(initial=0))
        if largest > 0 and not LIGHT_RANGE[0] <= largest <= LIGHT_RANGE[1]:
            raise InputError(
                f"the photograph's largest value is {largest:.1e}; scale it to between "
                f"{LIGHT_RANGE[0]:g} and {LIGHT_RANGE[1]:g}"
            )
        return grey if self.unmixing is None else self.unmixing @ grey

    def check_size(self, shape: tuple[int, ...]) -> None:
        """Reject photographs whose shape does not suit `planar` or the mask."""
        size, known = shape[1:-1], self.rows_and_columns
        if known is not None and len(size) == 2 and size != tuple(known):
            raise InputError(
                f"the photograph has {size[0]}x{size[1]} pixels, the scene's camera or mask "
                f"{known[0]}x{known[1]}"
            )
        if shape[-1] != 3 or np.prod(size, dtype=int) != self.pixels or not size:
            raise InputError(
                f"the photograph has shape {shape[1:]}; A has {self.pixels} rows, so "
                f"it must be (rows, columns, 3) with rows x columns = {self.pixels}"
            )

    def placed(self, values: Array) -> Array:
        """Put (M', K) values of the pixels used into (K, rows, columns), NaN elsewhere.

        The rows and columns of photographs must be known.
        """
        assert self.rows_and_columns is not None
        planes = np.full((values.shape[1], self.pixels), np.nan)
        planes[:, slice(None) if self.mask is None else self.mask.ravel()] = values.T
        return planes.reshape(-1, *self.rows_and_columns)

    def image(self, f: Array) -> Array:
        """Turn (N, 3) into the (R, C, 3) hidden image."""
        return f.reshape(*self.hidden_shape, 3)

    @property
    def rows_and_columns(self) -> tuple[int, int] | None:
        """The size of photographs, as given or as the mask has it; None if neither has."""
        if self.photograph_shape is None and self.mask is not None and self.mask.ndim == 2:
            rows, columns = self.mask.shape
            return rows, columns
        return self.photograph_shape


def observation_of(
    A: Any,
    hidden_shape: tuple[int, int],
    channel_gain: Image | None = None,
    mask: Mask | None = None,
    photograph_shape: tuple[int, int] | None = None,
    backgrounds: Backgrounds | None = None,
    colour_matrix: ColourMatrix | None = None,
) -> Observation:
    """Return the observation of a scene, its parts checked; arguments as those of `StillMethod`.

    A ValueError says that the shapes of A, (M, N), the hidden image, (R, C), and the mask, (rows,
    columns) or (M,), do not fit, that the mask leaves fewer pixels than patches, that the wall
    reflects nothing in a channel, or what is wrong with a background photograph.
    """
    if hidden_shape[0] * hidden_shape[1] != A.shape[1]:
        raise InputError(
            f"a hidden image of {hidden_shape[0]}x{hidden_shape[1]} patches does not fit A's "
            f"{A.shape[1]} columns"
        )
    gain = np.ones(3) if channel_gain is None else np.asarray(channel_gain, np.float64)
    if gain.shape != (3,) or not (gain > 0).all():
        raise InputError(f"the wall's channel gains must be three positive numbers, not {gain}")
    used = None if mask is None else checked_mask(mask, A.shape, photograph_shape)
    alone = Observation(A.shape[0], hidden_shape, gain, used, photograph_shape)
    planes = _background_planes(alone, backgrounds)
    M = np.eye(3) if colour_matrix is None else colour_matrix.matrix
    return replace(alone, backgrounds=planes, mixing=M * gain / gain[:, None])


def _background_planes(
    observation: Observation, backgrounds: Backgrounds | None
) -> dict[str, Array]:
    """Return the planes of background photographs, by name; a ValueError names one that is none."""
    planes = {}
    for name, background in named(backgrounds).items():
        try:
            planes[name] = observation.planar(np.asarray(background)[None])[0]
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
        if not planes[name].max(initial=0) > 0:
            raise InputError(f"{name}: no value is positive where the wall is used")
    return planes


def named(backgrounds: Backgrounds | None) -> dict[str, Image]:
    """Return background photographs by name."""
    if backgrounds is None:
        return {}
    if isinstance(backgrounds, Mapping):
        return dict(backgrounds)
    if np.ndim(backgrounds[0] if len(backgrounds) else 0) == 1:
        raise InputError("backgrounds are a sequence of photographs, (rows, columns, 3) each")
    count = len(backgrounds)
    return {f"background photograph {k} of {count}": b for k, b in enumerate(backgrounds, 1)}


def checked_mask(
    mask: Mask, transport_shape: tuple[int, ...], photograph_shape: tuple[int, int] | None = None
) -> Mask:
    """Return a copy of a mask, (rows, columns) or (M,), that fits A, (M, N), and leaves enough.

    A ValueError says that it is not boolean, has another shape, leaves nothing, or leaves fewer
    pixels than patches where the whole photograph has as many.
    """
    checked = np.array(mask)
    if checked.dtype != np.bool_:
        raise InputError("the mask must be boolean, True where the wall is to be used")
    shape, count = checked.shape, int(np.count_nonzero(checked))
    pixels, patches = transport_shape
    rectangular = shape if photograph_shape is None else tuple(photograph_shape)
    is_rectangular = len(shape) == 2 and shape == rectangular
    if math.prod(shape) != pixels or not (is_rectangular or len(shape) == 1):
        size = "(rows, columns)" if photograph_shape is None else str(rectangular)
        raise InputError(
            f"the mask has shape {shape}: it must be {size} or ({pixels},), a value for each of "
            f"the {pixels} pixels"
        )
    if count == 0:
        raise InputError("the mask leaves out every pixel: it must be True where the wall is used")
    if count < patches <= pixels:
        raise InputError(
            f"the mask leaves {count} pixels for {patches} patches: leave out less of the wall, or "
            "use fewer patches"
        )
    return checked
