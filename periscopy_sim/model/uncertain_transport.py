"""How the light transport of a scene changes with the errors of its parameters."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class UncertainTransport:
    """A scene's parameters θ ~ N(values, L Lᵀ), and what their errors do to A.

    θ = values + L u, u ~ N(0, I): the columns of L, its directions, err independently of each
    other. With A nearly linear, A(u) ≈ A + Σ u_k D_k.

    Attributes
    ----------
    names
        Of the P parameters.
    values
        (P,) at which A was rendered.
    directions
        (P, K) L, in the units of the parameters.
    changes
        (K, M, N) D: by how much A changes along each direction by one standard error.
    """

    names: tuple[str, ...]
    values: Array
    directions: Array
    changes: Image

    @property
    def standard_errors(self) -> Array:
        """(P,) of the parameters."""
        return np.asarray(np.sqrt(np.sum(self.directions**2, axis=1)))

    def check(self, transport_shape: tuple[int, ...]) -> None:
        """Raise a ValueError if the sizes do not fit A, (M, N), or an error changes nothing."""
        count = self.directions.shape[1]
        if self.changes.shape != (count, *transport_shape):
            raise ValueError(
                f"uncertain: changes have shape {self.changes.shape}; A is {transport_shape}, so "
                f"with {count} directions they must be {(count, *transport_shape)}"
            )
        for direction, change in zip(self.directions.T, self.changes, strict=True):
            if not np.isfinite(change).all():
                raise ValueError("uncertain: changes must be finite")
            if not change.any():
                name = self.names[int(np.argmax(np.abs(direction)))]
                raise ValueError(
                    f"uncertain: the photograph does not show an error of '{name}'; leave it out"
                )

    def lights(self, image: Array, mask: NDArray[np.bool_] | None = None) -> Array:
        """Return D f, (K, 3, M'): what each direction's standard error does to an image's light.

        The image is (R, C, 3); M' counts the pixels used.
        """
        used = slice(None) if mask is None else mask.ravel()
        f = image.reshape(-1, 3).astype(np.float32)
        return np.array([(change @ f)[used].T for change in self.changes], np.float64)
