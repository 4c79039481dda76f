"""What the methods for single photographs have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]
Precision = TypeVar("Precision", bound=np.floating[Any])
Found = TypeVar("Found", bound=np.floating[Any], covariant=True)


class Method(Protocol):
    """Anything that turns a photograph into a hidden image: the package's methods, a user's own."""

    def reconstruct(self, photograph: Image) -> Image:
        """Recover the hidden image, (R, C, 3), from a photograph, (rows, columns, 3)."""
        ...


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
    """Return what methods need of a scene, by the names of their parameters."""
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
    """A method fitted to one scene, which recovers each photograph's hidden image on its own.

    What a method knows beside the image, it says in `told`, `remark`, `doubt`, `stages`
    and `standard_errors`; each takes what `solve` returned.
    """

    @classmethod
    def for_scene(cls, scene: Seen, A: Any, B: Any = None, **settings: Any) -> Self:
        """Fit to a scenario: its sizes and the colour of its wall are taken from it.

        Parameters
        ----------
        scene
            A `Scenario`, or anything with its ``photograph_shape``, ``hidden_shape`` and
            ``channel_gain``.
        A, B
            As in the class.
        **settings
            The class's other parameters.
        """
        construct: Any = cls
        fitted: Self = construct(A, B, **settings_of(scene), **settings)
        return fitted

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

    def told(self, found: Any) -> dict[str, Any]:  # noqa: ARG002
        """Return the numbers that a summary keeps of a solution, by name."""
        return {}

    def remark(self, found: Any) -> str:  # noqa: ARG002
        """Return a sentence for the user about a solution, or nothing."""
        return ""

    def doubt(self, found: Any) -> str:  # noqa: ARG002
        """Return why a solution may show nothing of the hidden scene; empty where it may not."""
        return ""

    def stages(self, found: Any) -> Sequence[tuple[str, Image]]:  # noqa: ARG002
        """Return titles and images, (R, C, 3), of what led to a solution; none by default."""
        return ()

    def standard_errors(self, found: Any) -> Array | None:  # noqa: ARG002
        """Return the standard error of each patch, (R, C, 3); None where they are not known."""
        return None
