"""What the methods for single photographs have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]
Precision = TypeVar("Precision", bound=np.floating[Any])
Found = TypeVar("Found", bound=np.floating[Any], covariant=True)


class Seen(Protocol):
    """The sizes and the wall's colour of a scene, as a `Scenario` has them."""

    @property
    def photograph_shape(self) -> tuple[int, int]:
        """(rows, columns) of the photograph."""
        ...

    @property
    def hidden_shape(self) -> tuple[int, int]:
        """(R, C) of the hidden image."""
        ...

    @property
    def channel_gain(self) -> Array:
        """(3,) colour of the wall."""
        ...


def settings_of(scene: Seen) -> dict[str, Any]:
    """Take from a scene what methods are told of it, by the names of their parameters."""
    return {
        "hidden_shape": scene.hidden_shape,
        "photograph_shape": scene.photograph_shape,
        "channel_gain": scene.channel_gain,
    }


class Solved(Protocol[Found]):
    """A hidden image and how it came about."""

    @property
    def image(self) -> NDArray[Found]:
        """(R, C, 3) the hidden image."""
        ...


class StillMethod(ABC, Generic[Precision]):
    """A method fitted to one scene, which recovers each photograph's hidden image on its own."""

    @abstractmethod
    def solve(self, photograph: Image) -> Solved[Precision]:
        """Recover the hidden image and tell how it came about; see `reconstruct`."""

    def reconstruct(self, photograph: Image) -> NDArray[Precision]:
        """Recover the hidden image from one photograph.

        Parameters
        ----------
        photograph
            (rows, columns, 3) or (M, 3), linear, in any unit.

        Returns
        -------
        ndarray
            (R, C, 3), linear, in units of the photograph's over those of A; negative where noise
            makes it so and the method lets it. float64, but float32 from an explicit `Periscope`.

        Raises
        ------
        ValueError
            If the photograph has not M pixels of 3 channels or is not finite where it is used.

        Warns
        -----
        RuntimeWarning
            Iterations, where the method takes any, did not reach its tolerance.
        """
        return self.solve(photograph).image
