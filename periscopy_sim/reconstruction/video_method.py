"""What the methods for video have in common: a frame follows from its photograph and the last."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.method import Image, Precision, Solved

Found = TypeVar("Found", bound=Solved[Any])


class FrameByFrame(ABC, Generic[Found, Precision]):
    """A method for video, fitted to one scene: frames one at a time, or many at once.

    Parameters
    ----------
    hidden_shape
        (R, C) of the frames.
    precision
        Their type.

    Attributes
    ----------
    previous
        (R, C, 3) the latest frame; None before the first and after `restart`.
    """

    def __init__(self, hidden_shape: tuple[int, int], precision: type[Precision]) -> None:
        self.hidden_shape = hidden_shape
        self.precision = precision
        self.restart()

    def restart(self) -> None:
        """Forget the latest frame: the next one is a first one."""
        self.previous: NDArray[Precision] | None = None

    def fitted(self) -> dict[str, Any]:
        """Return what fitting to the scene settled, for a summary."""
        return {}

    def told(self, found: Any) -> dict[str, Any]:
        """Return the numbers that a table keeps of a frame's solution, by name."""
        numbers: dict[str, Any] = found.told()
        return numbers

    @abstractmethod
    def begun(self, photographs: Image) -> Iterator[Callable[[], Found]]:
        """Do what is done to many photographs at once.

        Parameters
        ----------
        photographs
            (K, rows, columns, 3) or (K, M, 3), linear, in time's order.

        Yields
        ------
        callable
            What is left to do for each: recovers its frame, once those before it are recovered.

        Raises
        ------
        ValueError
            As `next_frame`.
        """

    def next_frame(self, photograph: Image) -> NDArray[Precision]:
        """Recover the frame that follows the latest one.

        Parameters
        ----------
        photograph
            (rows, columns, 3) or (M, 3), linear, in the unit of the photographs before it.

        Returns
        -------
        ndarray
            (R, C, 3), linear, of the type that the method for stills gives.

        Raises
        ------
        ValueError
            If the photograph has not M pixels of 3 channels or is not finite where it is used; the
            next one then follows the latest frame all the same.

        Warns
        -----
        RuntimeWarning
            The tolerance was not reached.
        """
        image: NDArray[Precision] = self.solve_next(photograph).image
        return image

    def solve_next(self, photograph: Image) -> Found:
        """Recover the next frame and tell how it came about; see `next_frame`."""
        (finish,) = self.begun(np.asarray(photograph)[None])
        return finish()

    def frames(self, photographs: Image) -> NDArray[Precision]:
        """Recover the frames that follow the latest one, many photographs in one product.

        Parameters
        ----------
        photographs
            (K, rows, columns, 3) or (K, M, 3), linear, in time's order.

        Returns
        -------
        ndarray
            (K, R, C, 3), what `next_frame` gives one after the other.

        Raises
        ------
        ValueError
            As `next_frame`.
        """
        images = [finish().image for finish in self.begun(photographs)]
        return np.array(images, self.precision).reshape(-1, *self.hidden_shape, 3)
