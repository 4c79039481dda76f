"""The light transport as a SciPy linear operator over images: for SciPy, PyLops and the like."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.linalg import LinearOperator

from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.model.transport_operator import Matrix, row_blocks
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
        (C,) the wall's colour.
    """

    def __init__(
        self, A: Matrix, hidden: Hidden, photograph_shape: Size, channel_gain: NDArray[Any]
    ) -> None:
        (M, N), C = A.shape, len(channel_gain)
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
        return np.asarray(X, self.dtype).reshape(-1, len(self.channel_gain) * X.shape[1])

    def _coloured(self, y: NDArray[Any]) -> NDArray[Any]:
        gain = self.channel_gain
        return y if np.all(gain == 1) else y * np.repeat(gain, y.shape[1] // len(gain))


def transport_operator(
    transport: Any,
    *,
    scene: Scenario | None = None,
    hidden: Hidden | Size | None = None,
    photograph_shape: Size | None = None,
    channel_gain: ArrayLike | None = None,
) -> ImageOperator:
    """Return the light transport as a SciPy linear operator over images.

    Parameters
    ----------
    transport
        A scene, whose A is rendered; or A, (M, N) of float32 or float64, or what makes its rows
        anew in every pass (``row_blocks``, such as `RenderedTransport`).
    scene
        The scene of A: its sizes and the colour of its wall are taken from it.
    hidden
        The hidden surfaces or (R, C); None for the scene's, or one row.
    photograph_shape
        (rows, columns); None for the scene's, or one row.
    channel_gain
        (C,) colour of the wall; None for the scene's, or grey in three channels.

    Returns
    -------
    ImageOperator
        (C M, C N): of ``image.ravel()`` to ``photograph.ravel()``.

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
    M, N = A.shape
    photograph_shape = photograph_shape or (scene.photograph_shape if scene else (1, M))
    hidden = Hidden.of(hidden or (scene.hidden if scene else (1, N)))
    if (np.prod(photograph_shape), hidden.patches) != (M, N):
        raise ValueError(
            f"A has {M} rows and {N} columns; photographs of {photograph_shape} and hidden images "
            f"of {hidden.sizes} have not as many"
        )
    if channel_gain is None:
        channel_gain = scene.channel_gain if scene else np.ones(3)
    gain = np.asarray(channel_gain)
    if gain.ndim != 1 or not (np.isfinite(gain).all() and (gain >= 0).all()):
        raise ValueError("the wall's colour is (C,) finite numbers that are not negative")
    return ImageOperator(A, hidden, photograph_shape, gain)
