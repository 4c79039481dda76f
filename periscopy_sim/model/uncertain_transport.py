"""What errors of a scene's parameters do to the light of a hidden image."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Array, Image


@dataclass(frozen=True, eq=False)
class UncertainTransport:
    """A scene's parameters θ ~ N(values, L Lᵀ), and the effect of their errors on light.

    θ = values + L u, u ~ N(0, I): the columns of L, its directions, err independently of each
    other. With A nearly linear, A(u) f ≈ A f + Σ u_k D_k f.

    Attributes
    ----------
    names
        Names of the P parameters.
    directions
        (P, K) L, in the units of the parameters.
    slopes
        Returns the derivatives by the parameters, (P, M, 3), of the light of an image, (R, C, 3).
    """

    names: tuple[str, ...]
    directions: Array
    slopes: Callable[[Array], Image]

    def lights(self, image: Array, mask: NDArray[np.bool_] | None = None) -> Array:
        """Return D f, (K, 3, M'): what each direction's standard error does to an image's light.

        The image is (R, C, 3); M' counts the pixels used.
        """
        used = slice(None) if mask is None else mask.ravel()
        light = self.slopes(image)[:, used]
        return np.asarray(np.einsum("pk,pmc->kcm", self.directions, light))
