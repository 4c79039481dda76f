"""The base of all methods for video: a frame follows from its photograph and the last frame."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics import Image
from periscopy_sim.numerics.validation import checked_number
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.method import Precision, Series, Solution, StillMethod

FrameSolution = TypeVar("FrameSolution", bound=Solution[Any])


class FrameByFrame(ABC, Generic[FrameSolution, Precision]):
    """A method for video, fitted to one scene: frames one at a time, or many at once.

    Parameters
    ----------
    still
        The method for stills, whose weights and tolerance serve every frame.
    coupling
        Name of the coupling to the previous frame.
    l1_weight
        λ₂ over λ.

    Attributes
    ----------
    previous
        (R, C, channels) the latest frame, of several surfaces by id; None before the first and
        after `restart`.

    Raises
    ------
    ValueError
        If the coupling is unknown, or a weight is negative or not finite.
    """

    couplings: tuple[str, ...]
    """Names of the couplings that the method accepts."""

    def __init__(self, still: StillMethod[Precision], coupling: str, l1_weight: float) -> None:
        if coupling not in self.couplings:
            known = ", ".join(f"'{each}'" for each in self.couplings)
            raise ValueError(f"coupling '{coupling}' is not known; use one of {known}")
        checked_number(l1_weight, "l1_weight", 0)
        self.still = still
        self.precision = still.precision
        self.coupling = coupling
        self.l1_weight = l1_weight
        self.restart()

    def __repr__(self) -> str:
        """Return its sizes and coupling on one line."""
        sizes = self.still.hidden.sizes
        return f"{type(self).__name__}({sizes} patches, coupling '{self.coupling}')"

    def restart(self) -> None:
        """Forget the latest frame: the next one is a first one."""
        self.previous: NDArray[Precision] | None = None

    @abstractmethod
    def recoveries(self, photographs: Series) -> Iterator[Callable[[], FrameSolution]]:
        """Prepare many photographs together, and yield what recovers each frame, to call in order.

        They are (K, rows, columns, C) or (K, M, C), linear, in time's order; or K `Photograph`s, to
        which `still` is fitted, see `StillMethod.fitted_to`. Errors are those of `next_frame`.
        """

    def next_frame(self, photograph: Photograph | Image) -> NDArray[Precision]:
        """Recover the frame, (R, C, channels), that follows the latest one.

        The photograph is in the unit of the photographs before it. After an error, the next frame
        follows the latest one. See `StillMethod.reconstruct` for the rest, errors and warnings.
        """
        image: NDArray[Precision] = self.solve_next(photograph).image
        return image

    def solve_next(self, photograph: Photograph | Image) -> FrameSolution:
        """Recover the next frame, with its noise and weight; see `next_frame`."""
        (recover,) = self.recoveries([photograph])
        return recover()

    def frames(self, photographs: Series) -> NDArray[Precision]:
        """Recover the frames, (K, R, C, channels), that follow the latest one; see `recoveries`.

        Of several surfaces they are a mapping of such by id.
        """
        hidden = self.still.hidden
        images = [hidden.images(recover().image) for recover in self.recoveries(photographs)]
        stacks = {
            name: np.array([each[name] for each in images], self.precision)
            if images
            else np.zeros((0, *shape, np.asarray(photographs).shape[-1]), self.precision)
            for name, shape in hidden.shapes.items()
        }
        stack: NDArray[Precision] = hidden.unwrapped(stacks)
        return stack
