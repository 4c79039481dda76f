"""The light transport as a SciPy linear operator over images: for SciPy, PyLops and the like."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.linalg import LinearOperator

from periscopy_sim.hidden import Size
from periscopy_sim.model.transport_operator import Matrix, row_blocks
from periscopy_sim.scenario import Scenario


class ImageOperator(LinearOperator):  # type: ignore[misc]  # SciPy has no types
    """A over images: a vector is ``image.ravel()`` of a (rows, columns, 3) image.

    A product is one of BLAS, ``A @ x.reshape(N, 3)``, and nothing is copied. Products are of A's
    type: with a float32 A, vectors of float64 are rounded, A is never converted.

    Attributes
    ----------
    hidden_shape, photograph_shape
        (rows, columns, 3) of the images that vectors hold.
    channel_gain
        (3,) the wall's colour.
    """

    def __init__(
        self, A: Matrix, hidden_shape: Size, photograph_shape: Size, channel_gain: ArrayLike
    ) -> None:
        (M, N), dtype = A.shape, np.dtype(getattr(A, "dtype", np.float32))
        super().__init__(dtype, (3 * M, 3 * N))
        self.A = A
        self.hidden_shape, self.photograph_shape = (*hidden_shape, 3), (*photograph_shape, 3)
        self.channel_gain = np.asarray(channel_gain, dtype)

    def image(self, x: ArrayLike) -> NDArray[Any]:
        """Return a vector as the hidden image that it holds, (rows, columns, 3)."""
        return np.reshape(x, self.hidden_shape)

    def photograph(self, y: ArrayLike) -> NDArray[Any]:
        """Return a vector as the photograph that it holds, (rows, columns, 3)."""
        return np.reshape(y, self.photograph_shape)

    def _matmat(self, X: NDArray[Any]) -> NDArray[Any]:
        f = self._planes(X)
        y = np.empty((self.A.shape[0], f.shape[1]), self.dtype)
        for rows, block in row_blocks(self.A):
            y[rows] = block @ f
        return self._coloured(y).reshape(-1, X.shape[1])

    def _rmatmat(self, Y: NDArray[Any]) -> NDArray[Any]:
        y = self._coloured(self._planes(Y))
        f = np.zeros((self.A.shape[1], y.shape[1]), self.dtype)
        for rows, block in row_blocks(self.A):
            f += block.T @ y[rows]
        return f.reshape(-1, Y.shape[1])

    def _rmatvec(self, y: NDArray[Any]) -> NDArray[Any]:
        return self._rmatmat(y.reshape(-1, 1)).ravel()

    def _planes(self, X: NDArray[Any]) -> NDArray[Any]:
        """Return (3 n, K) as (n, 3 K), of A's type."""
        return np.asarray(X, self.dtype).reshape(-1, 3 * X.shape[1])

    def _coloured(self, y: NDArray[Any]) -> NDArray[Any]:
        gain = self.channel_gain
        return y if np.all(gain == 1) else y * np.repeat(gain, y.shape[1] // 3)


def transport_operator(transport: Any, scene: Any = None) -> ImageOperator:
    """Return the light transport as a SciPy linear operator over images.

    Parameters
    ----------
    transport
        A scene, whose A is rendered; or A, (M, N) of float32 or float64, or what makes its rows
        anew in every pass (``row_blocks``, such as `RenderedTransport`).
    scene
        The scene of A, or anything with its ``photograph_shape``, ``hidden_shape`` and
        ``channel_gain``; None for images of one row and a grey wall.

    Returns
    -------
    ImageOperator
        (3 M, 3 N): of ``image.ravel()`` to ``photograph.ravel()``.

    Raises
    ------
    ValueError
        If the sizes or the colour do not fit A.
    """
    if isinstance(transport, Scenario):
        from periscopy_sim.rendering.transport.plan import transport as transport_of

        scene, transport = transport, transport_of(transport)
    A = transport if hasattr(transport, "row_blocks") else np.asarray(transport)
    if isinstance(A, np.ndarray) and (A.ndim != 2 or A.dtype not in (np.float32, np.float64)):
        raise ValueError(f"A is {A.shape} of {A.dtype}: give (M, N) of float32 or float64")
    if scene is None:
        return ImageOperator(A, (1, A.shape[1]), (1, A.shape[0]), np.ones(3))
    sizes, gain = (scene.photograph_shape, scene.hidden_shape), np.asarray(scene.channel_gain)
    if tuple(map(math.prod, sizes)) != A.shape:
        raise ValueError(f"A is {A.shape}; photographs {sizes[0]} and hidden images {sizes[1]}")
    if gain.shape != (3,):
        raise ValueError(f"the wall's colour is {gain}: give a number for each of 3 channels")
    return ImageOperator(A, scene.hidden_shape, scene.photograph_shape, gain)
