"""The light transport on PyTorch's tensors, differentiable, on any device."""

from copy import copy
from typing import Any

import numpy as np

from periscopy_sim.adapters.linear_operator import transport_operator
from periscopy_sim.extras import require
from periscopy_sim.hidden import Size


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
