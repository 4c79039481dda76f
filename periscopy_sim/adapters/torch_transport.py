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
    hidden_shape, photograph_shape
        (rows, columns).
    gain
        (3, 1) tensor, the wall's colour.

    Raises
    ------
    PeriscopyError
        If PyTorch is not installed.
    ValueError
        If A is not in memory, or the sizes or the colour do not fit it.
    """

    def __init__(
        self, transport: Any, scene: Any = None, *, device: Any = None, dtype: Any = None
    ) -> None:
        torch = require("torch")
        if hasattr(transport, "row_blocks"):
            raise ValueError("tensors need A in memory: give what render_transport returns")
        known = transport_operator(transport, scene)
        self.hidden_shape, self.photograph_shape = (
            shape[:2] for shape in (known.hidden_shape, known.photograph_shape)
        )
        A = np.require(known.A, requirements=["C", "W"])
        self.A = torch.as_tensor(A, device=device, dtype=dtype)
        self.gain = torch.as_tensor(known.channel_gain).to(self.A)[:, None]

    def to(self, device: Any = None, dtype: Any = None) -> "TorchTransport":
        """Return the same on another device or of another type."""
        moved = copy(self)
        moved.A = self.A.to(device=device, dtype=dtype)
        moved.gain = self.gain.to(moved.A)
        return moved

    def forward(self, image: Any) -> Any:
        """Return the photographs, (..., 3, r, c), of hidden images, (..., 3, R, C)."""
        f = self._planes(image, self.hidden_shape, "hidden images")
        y = self._coloured(f @ self.A.T)
        return y.reshape(*image.shape[:-2], *self.photograph_shape)

    def adjoint(self, photograph: Any) -> Any:
        """Return the adjoint's images, (..., 3, R, C), of photographs, (..., 3, r, c)."""
        y = self._planes(photograph, self.photograph_shape, "photographs")
        f = self._coloured(y) @ self.A
        return f.reshape(*photograph.shape[:-2], *self.hidden_shape)

    __call__ = forward

    def _coloured(self, y: Any) -> Any:
        return (y.reshape(-1, 3, y.shape[-1]) * self.gain).reshape(y.shape)

    def _planes(self, images: Any, shape: Size, what: str) -> Any:
        """Return (..., 3, rows, columns) as (K, rows * columns)."""
        if images.ndim < 3 or tuple(images.shape[-3:]) != (3, *shape):
            raise ValueError(
                f"{what} are (..., 3, {shape[0]}, {shape[1]}), not {tuple(images.shape)}"
            )
        return images.reshape(-1, shape[0] * shape[1])
