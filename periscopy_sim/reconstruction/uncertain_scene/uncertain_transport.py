"""How the light transport of a scene changes with the errors of its parameters."""

from __future__ import annotations

from collections.abc import Callable
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
        (P,) where A is of.
    directions
        (P, K) L, in the units of the parameters.
    changes
        (1, K, M, N) or (2, K, M, N) D: by how much A changes along each direction by one standard
        error, rendered once or by two independent sets of rays. A second set tells the noise of
        the first from what is seen.
    render
        Returns A, (M, N), at any values, (P,), and raises a ValueError where there is none; None
        where A is taken for linear.
    held
        Whether the photograph has had its say on where the parameters are, as after a calibration:
        they stay, and their errors are those of the image.
    """

    names: tuple[str, ...]
    values: Array
    directions: Array
    changes: Image
    render: Callable[[Array], Image] | None = None
    held: bool = False

    @property
    def standard_errors(self) -> Array:
        """(P,) of the parameters, before the photograph is looked at."""
        return np.asarray(np.sqrt(np.sum(self.directions**2, axis=1)))

    def check(self, transport_shape: tuple[int, ...]) -> None:
        """Refuse what does not fit a transport matrix of (M, N), and errors that change nothing.

        A ValueError tells which.
        """
        parameters, count = self.directions.shape
        sizes = (len(self.names), len(self.values))
        if sizes != (parameters, parameters) or count < 1:
            raise ValueError(
                f"uncertain: {sizes[0]} names and {sizes[1]} values of parameters, and directions "
                f"of shape {self.directions.shape}; give (P,), (P,) and (P, K)"
            )
        shape = self.changes.shape
        if shape[1:] != (count, *transport_shape) or shape[0] not in (1, 2):
            raise ValueError(
                f"uncertain: changes have shape {shape}; A is {transport_shape}, so with "
                f"{count} directions they must be {(1, count, *transport_shape)}, or 2 of them"
            )
        for direction, change in zip(self.directions.T, self.changes[0], strict=True):
            if not np.isfinite(change).all():
                raise ValueError("uncertain: changes must be finite")
            if not change.any():
                name = self.names[int(np.argmax(np.abs(direction)))]
                raise ValueError(
                    f"uncertain: the photograph does not show an error of '{name}'; leave it out"
                )

    def at(self, u: Array) -> Array:
        """Return the parameters, (P,), at u, (K,)."""
        return np.asarray(self.values + self.directions @ u)

    def lights(self, images: Array, mask: NDArray[np.bool_] | None = None) -> Array:
        """Return D f: what each direction's standard error does to the light of images, (N, 3).

        It is (1 or 2, K, 3, M'), of the pixels used.
        """
        used = slice(None) if mask is None else mask.ravel()
        f = images.astype(np.float32)
        return np.array(
            [[(change @ f)[used].T for change in each] for each in self.changes], np.float64
        )

    def change(self, u: Array, mask: NDArray[np.bool_] | None = None) -> Array:
        """Return Σ u_k D_k, (M', N), of the pixels used."""
        used = slice(None) if mask is None else mask.ravel()
        changed = np.zeros(self.changes.shape[2:])
        for by_rays in self.changes:
            for each, change in zip(u / len(self.changes), by_rays, strict=True):
                changed += each * change
        return changed[used]
