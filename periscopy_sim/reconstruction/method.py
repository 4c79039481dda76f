"""What the methods for single photographs have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.background_photographs import Backgrounds
from periscopy_sim.reconstruction.explained import Explained
from periscopy_sim.reconstruction.observation import Mask, observation_of

if TYPE_CHECKING:
    from periscopy_sim.reconstruction.large_scale.transport_operator import TransportOperator
    from periscopy_sim.reconstruction.residual.residual import Residual

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]
Precision = TypeVar("Precision", bound=np.floating[Any])


class Method(Protocol):
    """Anything that turns a photograph into a hidden image: the package's methods, a user's own."""

    def reconstruct(self, photograph: Image) -> Image:
        """Recover the hidden image, (R, C, 3), from a photograph, (rows, columns, 3)."""


class Seen(Protocol):
    """The sizes and the wall's colour of a scene, as a `Scenario` has them."""

    @property
    def photograph_shape(self) -> tuple[int, int]:
        """(rows, columns) of the photograph."""

    @property
    def hidden_shape(self) -> tuple[int, int]:
        """(R, C) of the hidden image."""

    @property
    def channel_gain(self) -> Array:
        """(3,) colour of the wall, or (M, 3) of each pixel's."""


@dataclass(frozen=True, eq=False)
class Solution(Generic[Precision]):
    """A hidden image and how it came about.

    Attributes
    ----------
    image
        (R, C, 3) the result, in units of the photograph's over those of A.
    noise
        (3,) standard deviation of the photograph's noise in each channel, as estimated from what
        the method cannot explain of it.
    weight
        λ, the total-variation weight used: (3,) for each channel, or one for all.
    """

    image: NDArray[Precision]
    noise: Array
    weight: Array | float

    def __repr__(self) -> str:
        """Return its size, the mean noise and the mean weight on one line."""
        rows, columns = self.image.shape[:2]
        noise, weight = (float(np.mean(number)) for number in (self.noise, self.weight))
        return f"{type(self).__name__}({rows}x{columns}, noise {noise:.3g}, weight {weight:.3g})"

    def told(self) -> dict[str, Any]:
        """Return the numbers that a summary or a table keeps, by name."""
        return {"noise": self.noise, "lambda": self.weight}


class StillMethod(ABC, Generic[Precision]):
    """A method fitted to one scene, which recovers each photograph's hidden image on its own.

    What a method knows beside the image, it says in `told`, `remark`, `doubt`, `stages`
    and `standard_errors`; each takes what `solve` returned.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds; None for none. Not used by methods that know no backgrounds.
    hidden_shape
        (R, C) with R C = N.
    channel_gain
        (3,) positive colour of the wall, `Scenario.channel_gain`; None for a grey wall; or (M, 3)
        of each pixel, one of which is left out where a channel is 0.
    rank_tolerance
        Of methods that know backgrounds: relative tolerance on B's singular values, see
        `background_basis`.
    photograph_shape
        (rows, columns) that photographs must have; None checks the number of pixels alone.
    mask
        (rows, columns) or (M,), True where the wall is to be used; None for everywhere. The other
        rows of A and B are left out, and what the photograph holds there, be it NaN.
    backgrounds
        Photographs of the same wall with the monitor off, (rows, columns, 3) each, in any unit, of
        any exposure; None for none. Each channel of each is one more column of B, also for methods
        that do not use B; see `background_photographs`.

    Attributes
    ----------
    observation
        The sizes of photograph and hidden image, the wall's colour, and which pixels are used.

    Raises
    ------
    ValueError
        If the shapes do not fit, the mask leaves fewer pixels than patches, A or B is not finite
        where it is used, the wall reflects nothing in a channel, a number is out of range, or a
        background photograph is of another size, not finite where it is used, without light, or
        shows the monitor (see `monitor_left_on`; of methods that use B).
    """

    precision: type[np.floating[Any]] = np.float64
    """Of the images."""

    def __new__(cls, *arguments: Any, **_: Any) -> Self:
        """Refuse a scene in the place of A, by a TypeError that names what takes one."""
        if arguments and hasattr(arguments[0], "photograph_shape"):
            raise TypeError(
                f"A comes first; to fit to a scene, {cls.__name__}.for_scene(scene, A, B)"
            )
        return super().__new__(cls)

    def __init__(
        self,
        A: Any,
        hidden_shape: tuple[int, int],
        channel_gain: Image | None,
        photograph_shape: tuple[int, int] | None,
        mask: Mask | None,
        backgrounds: Backgrounds | None,
    ) -> None:
        self.observation = observation_of(
            A, hidden_shape, channel_gain, mask, photograph_shape, backgrounds
        )
        self.hidden_shape = hidden_shape
        self.photograph_shape = photograph_shape

    def __repr__(self) -> str:
        """Return its sizes on one line."""
        patches = "{}x{}".format(*self.hidden_shape)
        pixels = "x".join(map(str, self.photograph_shape or (self.observation.pixels,)))
        return f"{type(self).__name__}({patches} patches, {pixels} pixels)"

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
        # Rows may come as they are needed; what else is no array has one.
        matrix = A if isinstance(A, np.ndarray) or hasattr(A, "row_blocks") else np.asarray(A)
        fitted: Self = construct(
            matrix,
            B,
            hidden_shape=scene.hidden_shape,
            photograph_shape=scene.photograph_shape,
            channel_gain=scene.channel_gain,
            **settings,
        )
        return fitted

    @abstractmethod
    def solve(self, photograph: Image) -> Solution[Precision]:
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
            If the photograph has not M pixels of 3 channels, is not finite where it is used, or is
            one of the background photographs.

        Warns
        -----
        RuntimeWarning
            Iterations, where the method takes any, did not reach its tolerance.
        UserWarning
            The photograph is of 8-bit integers, which are mostly encoded for screens.
        """
        return self.solve(photograph).image

    def evenness(self, photograph: Image) -> Array:
        """Return what a photograph is multiplied by to show an even wall of one colour.

        Background photographs show the wall's fine unevenness, if the photograph, (rows, columns,
        3) or (M, 3), agrees; see `unevenness`. The result is (3, M'), of the M' pixels used; ones
        where none is found, no background photographs were given, or the method does not use B.
        Methods for stills find it for each photograph, those for videos for the first.
        """
        plane = self.observation.planar(np.asarray(photograph)[None])[0]
        even = self._evenness(plane)
        return np.ones(plane.shape) if even is None else even

    def _evenness(self, planes: Array) -> Array | None:  # noqa: ARG002
        """Return the evenness of a photograph's (3, M') planes; None where it is not known."""
        return None

    def _planes(self, photographs: Image, evenness: Array | None = None) -> Array:
        """Return photographs' (K, 3, M') planes on an even wall; None: each by its own."""
        planes = self.observation.planar(photographs)
        for plane in planes:
            even = self._evenness(plane) if evenness is None else evenness
            if even is not None:
                plane *= even
        return planes

    def fitted(self) -> dict[str, Any]:
        """Return what fitting to the scene settled, for a summary."""
        return {}

    def explained(self, found: Any) -> Explained | None:  # noqa: ARG002
        """Return how well the scene and a solution explain the photograph; None if not known."""
        return None

    def residual(self, photograph: Image, found: Any) -> Residual | None:
        """Return what scene and solution leave of a photograph, and whether it is noise.

        The photograph is taken as an even wall would have shown it, see `evenness`.

        Parameters
        ----------
        photograph
            As `solve` took it.
        found
            What `solve` returned.

        Returns
        -------
        Residual or None
            None where the method does not know A, or the photograph's rows and columns.

        Raises
        ------
        ValueError
            As `reconstruct`.
        """
        from periscopy_sim.reconstruction.residual.residual import residual_of

        transport, shape = self.projected_transport(), self.observation.rows_and_columns
        if transport is None or shape is None:
            return None
        y = self._planes(np.asarray(photograph)[None])[0].T
        signal, place = self._signal(transport, found), self.observation.placed
        left = residual_of(y, signal, transport, place)
        return replace(left, has_backgrounds=bool(self.observation.backgrounds))

    def projected_transport(self) -> TransportOperator | None:
        """Return A⊥ of the pixels used; None where the method does not know it."""
        return None

    def _signal(self, transport: TransportOperator, found: Any) -> Array:
        """Return the light A f̂ of a solution, (M', 3), as the method models it."""
        return transport.light(np.asarray(found.image, np.float64).reshape(-1, 3))

    def told(self, found: Any) -> dict[str, Any]:
        """Return the numbers that a summary keeps of a solution, by name."""
        return {**self.fitted(), **found.told()}

    def remark(self, found: Any) -> str:  # noqa: ARG002
        """Return a sentence for the user about a solution, or nothing."""
        return ""

    def doubt(self, found: Any) -> str:
        """Return why a solution may show nothing of the hidden scene; empty where it may not."""
        explained = self.explained(found)
        return "" if explained is None else explained.doubt

    def stages(self, found: Any) -> Sequence[tuple[str, Image]]:  # noqa: ARG002
        """Return titles and images, (R, C, 3), of what led to a solution; none by default."""
        return ()

    def standard_errors(self, found: Any) -> Array | None:  # noqa: ARG002
        """Return the standard error of each patch, (R, C, 3); None where they are not known."""
        return None
