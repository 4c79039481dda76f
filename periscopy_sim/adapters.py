"""The light transport for other libraries: SciPy's linear operators, PyTorch's tensors.

PyLops and the like take the operator. The tensors are differentiable, on any device.
"""

import math
from collections.abc import Iterable
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.linalg import LinearOperator

from periscopy_sim.errors import require
from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.numerics import Image
from periscopy_sim.numerics.validation import checked_matrix
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
        self, A: Any, hidden: Hidden, photograph_shape: Size, channel_gain: NDArray[Any]
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
        for rows, block in self._row_blocks():
            y[rows] = block @ f
        return self._coloured(y).reshape(-1, X.shape[1])

    def _rmatmat(self, Y: NDArray[Any]) -> NDArray[Any]:
        y = self._coloured(self._planes(Y))
        f = np.zeros((self.A.shape[1], y.shape[1]), self.dtype)
        for rows, block in self._row_blocks():
            f += block.T @ y[rows]
        return f.reshape(-1, Y.shape[1])

    def _rmatvec(self, y: NDArray[Any]) -> NDArray[Any]:
        return self._rmatmat(y.reshape(-1, 1)).ravel()

    def _row_blocks(self) -> Iterable[tuple[slice, Image]]:
        """Return the rows of an array at once, or in the blocks that A makes of them."""
        streams: bool = hasattr(self.A, "row_blocks")
        return self.A.row_blocks() if streams else [(slice(None), self.A)]

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
        from periscopy_sim.rendering.transport import transport as transport_of

        scene, transport = transport, transport_of(transport)
    A = transport if hasattr(transport, "row_blocks") else checked_matrix(transport, "A")
    if scene is None:
        return ImageOperator(A, Hidden.of((1, A.shape[1])), (1, A.shape[0]), np.ones(3))
    hidden, shape = Hidden.of(scene.hidden), scene.photograph_shape
    if (math.prod(shape), hidden.patches) != A.shape:
        raise ValueError(f"A is {A.shape}; photographs {shape} and hidden images {hidden.sizes}")
    return ImageOperator(A, hidden, shape, np.asarray(scene.channel_gain))


class TorchTransport:
    """A and its adjoint on tensors of images, channels first as PyTorch has them.

    Both are differentiable any number of times with respect to the images.

    Parameters
    ----------
    transport
        A scene, whose A is rendered; or A, (M, N) of float32 or float64.
    scene
        As of `transport_operator`.
    device, dtype
        Where A is kept, and as what; None for the CPU and A's own type.

    Attributes
    ----------
    A
        (M, N) tensor.
    hidden
        The hidden surface, (R, C) patches.
    photograph_shape
        (r, c), rows and columns.
    gain
        (channels, 1) tensor, the wall's colour; or (channels, M) of a texture.

    Raises
    ------
    PeriscopyError
        If PyTorch is not installed.
    ValueError
        If A is not in memory, or the sizes do not fit it.
    """

    def __init__(
        self, transport: Any, scene: Any = None, *, device: Any = None, dtype: Any = None
    ) -> None:
        torch = require("torch")
        if hasattr(transport, "row_blocks"):
            raise ValueError("tensors need A in memory: give what render_transport returns")
        known = transport_operator(transport, scene)
        self.hidden, self.photograph_shape = known.hidden, known.photograph_shape
        A = np.require(known.A, requirements=["C", "W"])
        self.A = torch.as_tensor(A, device=device, dtype=dtype)
        self.gain = torch.as_tensor(np.atleast_2d(known.channel_gain).T.copy()).to(self.A)

    def to(self, device: Any = None, dtype: Any = None) -> "TorchTransport":
        """Return the same on another device or of another type."""
        moved = copy(self)
        moved.A = self.A.to(device=device, dtype=dtype)
        moved.gain = self.gain.to(moved.A)
        return moved

    def forward(self, image: Any) -> Any:
        """Return photographs, (..., channels, r, c), of images, (..., channels, R, C)."""
        y = self._coloured(self._planes(image, self.hidden.shape, "hidden images") @ self.A.T)
        return y.reshape(*image.shape[:-2], *self.photograph_shape)

    def adjoint(self, photograph: Any) -> Any:
        """Return the adjoint's images, (..., channels, R, C), of such photographs."""
        y = self._planes(photograph, self.photograph_shape, "photographs")
        return (self._coloured(y) @ self.A).reshape(*photograph.shape[:-2], *self.hidden.shape)

    __call__ = forward

    def _coloured(self, y: Any) -> Any:
        return (y.reshape(-1, len(self.gain), y.shape[-1]) * self.gain).reshape(y.shape)

    def _planes(self, images: Any, shape: Size, what: str) -> Any:
        """Return (..., channels, rows, columns) as (K, rows * columns)."""
        expected = len(self.gain), *shape
        if tuple(images.shape[-3:]) != expected:
            sizes = ", ".join(map(str, expected))
            raise ValueError(f"{what} are (..., {sizes}), not {tuple(images.shape)}")
        return images.reshape(-1, shape[0] * shape[1])
