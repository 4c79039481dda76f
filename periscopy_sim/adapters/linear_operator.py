"""The light transport as a SciPy linear operator over images: for SciPy, PyLops and the like."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.linalg import LinearOperator

from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.model.transport_operator import Matrix, checked_transport, row_blocks
from periscopy_sim.scenario import Scenario


class ImageOperator(LinearOperator):  # type: ignore[misc]  # SciPy has no types
    """A over images: a vector is ``image.ravel()`` of a (rows, columns, C) image.

    A product is one of BLAS, ``A @ x.reshape(N, C)``, and nothing is copied. Products are of A's
    type: with a float32 A, vectors of float64 are rounded, A is never converted.

    Attributes
    ----------
    hidden
        The hidden surfaces, whose patches are A's columns.
    photograph_shape
        (rows, columns).
    channel_gain
        (C,) the wall's colour, or (M, C) of a texture.
    """

    def __init__(
        self, A: Matrix, hidden: Hidden, photograph_shape: Size, channel_gain: NDArray[Any]
    ) -> None:
        (M, N), C = A.shape, channel_gain.shape[-1]
        super().__init__(np.dtype(getattr(A, "dtype", np.float32)), (C * M, C * N))
        self.A, self.hidden, self.photograph_shape = A, hidden, photograph_shape
        self.channel_gain = channel_gain.astype(self.dtype)

    def image(self, x: ArrayLike) -> Any:
        """Return a vector as the hidden image that it holds; see `Hidden.image`."""
        return self.hidden.image(np.reshape(x, (self.hidden.patches, -1)))

    def photograph(self, y: ArrayLike) -> NDArray[Any]:
        """Return a vector as the photograph that it holds, (rows, columns, C)."""
        return np.reshape(y, (*self.photograph_shape, -1))

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
        """Return (C n, K) as (n, C K), of A's type."""
        return np.asarray(X, self.dtype).reshape(-1, self.channel_gain.shape[-1] * X.shape[1])

    def _coloured(self, y: NDArray[Any]) -> NDArray[Any]:
        gain = self.channel_gain
        return (
            y if np.all(gain == 1) else y * np.repeat(gain, y.shape[1] // gain.shape[-1], axis=-1)
        )


def transport_operator(transport: Any, scene: Any = None) -> ImageOperator:
    """Return the light transport as a SciPy linear operator over images.

    Parameters
    ----------
    transport
        A scene, whose A is rendered; or A, (M, N) of real numbers, or what makes its rows
        anew in every pass (``row_blocks``, such as `RenderedTransport`).
    scene
        The scene of A, or anything with its ``photograph_shape``, its ``hidden`` surfaces, or their
        (R, C), and its ``channel_gain``, (C,) or (M, C); None for images of one row and a grey
        wall.

    Returns
    -------
    ImageOperator
        (C M, C N): of ``image.ravel()`` to ``photograph.ravel()``.

    Raises
    ------
    ValueError
        If A is no dense matrix of real numbers, or the scene's sizes do not fit it.
    """
    if isinstance(transport, Scenario):
        from periscopy_sim.rendering.transport.plan import transport as transport_of

        scene, transport = transport, transport_of(transport)
    A = checked_transport(transport)
    if scene is None:
        return ImageOperator(A, Hidden.of((1, A.shape[1])), (1, A.shape[0]), np.ones(3))
    hidden, shape = Hidden.of(scene.hidden), scene.photograph_shape
    if (math.prod(shape), hidden.patches) != A.shape:
        raise ValueError(f"A is {A.shape}; photographs {shape} and hidden images {hidden.sizes}")
    return ImageOperator(A, hidden, shape, np.asarray(scene.channel_gain))
