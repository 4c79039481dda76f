"""The light transport matrix with light that bounces: A_c = A + W X_c of channel c."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from periscopy_sim.rendering.transport.bounced import BouncedLight, render_bounced_light
from periscopy_sim.scenario import Array, Scenario

ROWS = 1024
"""Of A to which bounced light is added at once; bounds the memory."""


@dataclass(frozen=True, eq=False)
class BouncedTransport:
    """The light transport matrix of each channel, where surroundings reflect the monitor's light.

    `A @ f` is the photograph, (M, 3), of a hidden image, (N, 3), each channel by its own matrix,
    before `Scenario.channel_gain`. As an array, `np.asarray(A)`, it is the channels' mean, (M, N),
    by which methods work: what channels differ by is smooth over the wall, as ambient light is. So
    NumPy's functions, `np.dot` for one, take the mean too; its operators take none.

    Attributes
    ----------
    mean
        (M, N) float32, direct light and the channels' mean of bounced light.
    bounced
        What has bounced.
    bounces
        Most reflections of a path, 2 or more; None of any number.
    """

    mean: NDArray[np.float32]
    bounced: BouncedLight
    bounces: int | None

    @property
    def shape(self) -> tuple[int, int]:
        """(M, N)."""
        return self.mean.shape[0], self.mean.shape[1]

    __array_ufunc__ = None  # array * A and array @ A must not take the mean silently

    def __matmul__(self, image: NDArray[np.floating[Any]]) -> Array:
        """Return the photograph, (M, 3), of a hidden image, (N, 3).

        A ValueError says that the image has another shape.
        """
        image = np.asarray(image)
        if image.shape != (self.shape[1], 3):
            raise ValueError(
                f"the hidden image has shape {image.shape}; its channels have matrices of their "
                f"own: give ({self.shape[1]}, 3)"
            )
        return np.asarray(self.mean @ image + self.beyond_mean(image))

    def beyond_mean(self, images: NDArray[np.floating[Any]]) -> Array:
        """Return by how much photographs, (..., M, 3), of images, (..., N, 3), are off the mean's.

        That is what the channels' matrices send beyond their mean.
        """
        sent = np.einsum("ckn,...nc->...kc", self.bounced.colour, images, dtype=np.float64)
        return np.asarray(self.bounced.over_wall @ sent)

    def channel(self, c: int) -> NDArray[np.float32]:
        """Return the matrix of channel c, (M, N)."""
        return np.asarray(self.mean + self.bounced.over_wall @ self.bounced.colour[c])

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the channels' mean, (M, N)."""
        return np.array(self.mean, dtype=dtype, copy=copy)


def add_bounces(
    scenario: Scenario,
    A: NDArray[np.float32],
    bounces: int | None,
    *,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> BouncedTransport:
    """Add light that bounces to a direct A, (M, N), in place; for the rest see `render_transport`.

    `bounces` is 2 or more, or None. The array becomes the mean of what is returned.
    """
    bounced = render_bounced_light(scenario, bounces=bounces, seed=seed, progress=progress)
    for start in range(0, len(A), ROWS):
        rows = slice(start, start + ROWS)
        A[rows] += bounced.rows(rows)
    return BouncedTransport(A, bounced, bounces)


def channels_mean(A: NDArray[Any] | BouncedTransport) -> NDArray[Any]:
    """Return the channels' mean of a matrix, (M, N), itself if it is one; memory maps stay such."""
    return A.mean if isinstance(A, BouncedTransport) else A
