"""Whose light transport, and of what sizes: a scene's or a matrix's."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.scenario import Scenario

Shape = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Sizes:
    """A matrix, the images it maps, and the wall's colour."""

    A: Any  # (M, N) float32 or float64 array, or what has `row_blocks`
    photograph_shape: Shape  # (rows, columns), of M pixels
    hidden_shape: Shape  # (rows, columns), of N patches
    channel_gain: NDArray[Any] | None  # (3,), of A's type; None where the wall is grey


def sizes_of(
    transport: Any,
    scene: Scenario | None = None,
    hidden_shape: Shape | None = None,
    photograph_shape: Shape | None = None,
    channel_gain: ArrayLike | None = None,
) -> Sizes:
    """Take a scene, whose A is rendered, or a matrix with its scene or its sizes.

    A size that is not known is one row of pixels or patches. What does not fit is a ValueError.
    """
    if isinstance(transport, Scenario):
        from periscopy_sim.rendering.transport.shadow_rays import render_transport

        scene, transport = transport, render_transport(transport)
    A = transport if hasattr(transport, "row_blocks") else np.asarray(transport)
    if isinstance(A, np.ndarray) and (A.ndim != 2 or A.dtype not in (np.float32, np.float64)):
        raise ValueError(f"A is {A.shape} of {A.dtype}: give (M, N) of float32 or float64")
    if scene is not None:
        photograph_shape = photograph_shape or scene.photograph_shape
        hidden_shape = hidden_shape or scene.hidden_shape
        channel_gain = scene.channel_gain if channel_gain is None else channel_gain
    M, N = A.shape
    photograph_shape, hidden_shape = photograph_shape or (1, M), hidden_shape or (1, N)
    if (np.prod(photograph_shape), np.prod(hidden_shape)) != (M, N):
        raise ValueError(
            f"A has {M} rows and {N} columns; photographs of {photograph_shape} and hidden images "
            f"of {hidden_shape} have not as many"
        )
    if channel_gain is None or np.all(np.asarray(channel_gain) == 1):
        return Sizes(A, photograph_shape, hidden_shape, None)
    gain = np.asarray(channel_gain, getattr(A, "dtype", np.float32))
    if gain.shape != (3,) or not (np.isfinite(gain).all() and (gain >= 0).all()):
        raise ValueError("the wall's colour is 3 finite numbers that are not negative")
    return Sizes(A, photograph_shape, hidden_shape, gain)
