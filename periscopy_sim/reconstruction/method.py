"""The base of all methods for single photographs."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import wraps
from itertools import groupby, islice
from typing import Any, Generic, Protocol, Self, TypeAlias, TypedDict, TypeVar, Unpack

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.colour_matrix import ColourMatrix
from periscopy_sim.model.observation import Backgrounds, named, observation_of
from periscopy_sim.model.residual import Residual, residual_of
from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.numerics.validation import InputError, plain_array
from periscopy_sim.photograph import Photograph, unwrapped
from periscopy_sim.reconstruction.inherited import Documented

Precision = TypeVar("Precision", bound=np.floating[Any])
Result = TypeVar("Result")
Series: TypeAlias = Image | Iterable[Photograph | Image]


@dataclass(frozen=True)
class Note:
    """A note for the user: a code, whose sentence `cli.messages` holds, and its values."""

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Report:
    """A solution's numbers, pictures, notes and warnings.

    Attributes
    ----------
    numbers
        Numbers that a summary records, by name.
    notes, warnings
        Facts that a user may want to know, and reasons why the image may be wrong.
    stages
        Titles and images, (R, C, 3), that led to the solution.
    standard_errors
        (R, C, 3) of each patch; None where the method knows none.
    residual
        None where the method does not know A, or the photograph's rows and columns.
    """

    numbers: Mapping[str, Any] = field(default_factory=dict)
    notes: Sequence[Note] = ()
    warnings: Sequence[Note] = ()
    stages: Sequence[tuple[str, Image]] = ()
    standard_errors: Array | None = None
    residual: Residual | None = None

    @property
    def verdict(self) -> Note:
        """Whether the scene fits, with what is unexplained and the noise, in percent."""
        residual = self.residual
        if residual is None:
            return Note("no_residual")
        code: str = residual.diagnosis if residual.diagnosis != "unknown" else "not_judged"
        if residual.is_large and code != "does_not_fit":
            code = "unexplained"
        names = "unexplained", "unexplained_by_any", "noise_alone"
        return Note(code, {name: 100 * (getattr(residual, name) or 0.0) for name in names})


class Method(Protocol):
    """Anything that turns a photograph into a hidden image: the package's methods, a user's own."""

    def reconstruct(self, photograph: Image) -> Image:
        """Recover the hidden image, (R, C, 3), from a photograph, (rows, columns, 3)."""


@dataclass(frozen=True, eq=False)
class Solution(Documented, Generic[Precision]):
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

    def numbers(self) -> dict[str, Any]:
        """Return the numbers that a summary or a table records, by name."""
        return {"noise": self.noise, "lambda": self.weight}


BATCH = 64
"""Photographs that a matrix is applied to in one product: 6 MB each at 500 x 500 pixels."""

SIGNIFICANT = 3.0
"""Standard errors by which a hidden image's light exceeds what noise alone would make of one."""


class Observed(TypedDict, total=False):
    """Keywords of every method that describe the photographs; see `StillMethod`."""

    hidden_shape: tuple[int, int]
    channel_gain: Image | None
    photograph_shape: tuple[int, int] | None
    mask: Mask | None
    backgrounds: Backgrounds | None
    colour_matrix: ColourMatrix | None


def of_all(function: Callable[..., Result]) -> Callable[..., Result]:
    """Let a method's function of a photograph accept a `Photograph`, and use all of it."""

    @wraps(function)
    def accepting(self: Any, photograph: Photograph | Image, *rest: Any, **named: Any) -> Result:
        if not isinstance(photograph, Photograph):
            return function(self, photograph, *rest, **named)
        same: Callable[..., Result] = getattr(self.fitted_to(photograph), function.__name__)
        return same(photograph.values, *rest, **named)

    return accepting


class StillMethod(Documented, ABC, Generic[Precision]):
    """A method fitted to one scene; it recovers the hidden image of each photograph separately.

    `solve` returns the image and its numbers, `report` everything else that the method knows of
    them. Both accept arrays, and `Photograph`s, to whose masks and monitor-off photographs the
    method is then fitted as well, see `fitted_to`.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds; None for none. Methods that model no backgrounds ignore them.
    hidden_shape
        (R, C) with R C = N.
    channel_gain
        (3,) positive colour of the wall, `Scenario.channel_gain`; None for a grey wall.
    rank_tolerance
        Relative tolerance on B's singular values, for methods that model backgrounds; see
        `background_basis`.
    photograph_shape
        (rows, columns) that photographs must have; None checks the number of pixels alone.
    mask
        (rows, columns) or (M,), True where the wall is used; None for everywhere. The method
        ignores the other rows of A, B and the photograph, which may be NaN there.
    backgrounds
        Photographs of the same wall with the monitor off, (rows, columns, 3) each, in any unit, of
        any exposure; None for none. Each channel of each is one more column of B, also for methods
        that do not use B.
    colour_matrix
        From the monitor's primaries, in which the image is, to the camera's channels; None for the
        identity. Methods other than `NoiseAware` unmix the photograph, which mixes its noise.

    Attributes
    ----------
    observation
        The sizes of photograph and hidden image, the wall's colour, and which pixels are used.
    hidden
        The hidden surfaces of the N patches.

    Raises
    ------
    ValueError
        If the shapes do not fit, the mask leaves fewer pixels than patches, A or B is not finite
        where it is used, the wall reflects nothing in a channel, a number is out of range, or a
        background photograph is of another size, not finite where it is used, or without light.
    """

    precision: type[np.floating[Any]] = np.float64
    """Floating-point type of the images."""

    mixes_colours = False
    """Whether the method's model has the colour matrix; the others unmix the photograph."""

    judges_scene = True
    """Whether the image is a least-squares fit, whose residual shows if the scene fits."""

    _given: tuple[tuple[Any, ...], dict[str, Any]] = (), {}
    _latest: tuple[bytes, Any] | None = None

    def __new__(cls, *arguments: Any, **settings: Any) -> Self:
        """Reject a scene in the place of A, by a TypeError that names `for_scene`."""
        if arguments and hasattr(arguments[0], "photograph_shape"):
            raise TypeError(
                f"A comes first; to fit to a scene, {cls.__name__}.for_scene(scene, A, B)"
            )
        method = super().__new__(cls)
        method._given = arguments, settings
        return method

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without A and B, which are large; so a copy cannot be fitted anew."""
        backgrounds = {"backgrounds": self._given[1].get("backgrounds")}
        return {**vars(self), "_given": ((), backgrounds), "_latest": None}

    def __init__(self, A: Any, **observed: Unpack[Observed]) -> None:
        if "hidden_shape" not in observed:
            raise TypeError("give hidden_shape, (R, C)")
        observation = observation_of(A, **observed)
        self.observation = observation if self.mixes_colours else observation.unmixed()
        self.hidden = self.observation.hidden
        self.hidden_shape = self.observation.hidden_shape
        self.photograph_shape = self.observation.photograph_shape

    def __repr__(self) -> str:
        """Return its sizes on one line."""
        patches = "{}x{}".format(*self.hidden_shape)
        pixels = "x".join(map(str, self.photograph_shape or (self.observation.pixels,)))
        return f"{type(self).__name__}({patches} patches, {pixels} pixels)"

    @classmethod
    def for_scene(cls, scene: Any, A: Any, B: Any = None, **settings: Any) -> Self:
        """Fit to a scenario, which gives the sizes and the colour of the wall.

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
        construct: Callable[..., Self] = cls
        # Objects with `row_blocks` stream the rows of A; anything else is converted to an array.
        matrix = A if isinstance(A, np.ndarray) or hasattr(A, "row_blocks") else np.asarray(A)
        return construct(
            matrix,
            B,
            hidden_shape=scene.hidden_shape,
            photograph_shape=scene.photograph_shape,
            channel_gain=scene.channel_gain,
            **settings,
        )

    def fitted_to(self, photograph: Photograph | Image) -> Self:
        """Return the method that uses all of a photograph: this one, or one fitted to more.

        It uses the pixels that the masks of the method and of the photograph leave, and projects
        out the light of the monitor-off photographs of both. The latest such method is kept:
        photographs that share them are fitted once. A method keeps its A and B for that. An
        array is for the method as it is.

        Raises
        ------
        ValueError
            As the class, or if this method is a copy, which has no A.
        """
        if not isinstance(photograph, Photograph) or (key := photograph.conditions) is None:
            return self
        latest = self._latest  # another thread may replace it
        if latest is None or latest[0] != key:
            self._latest = latest = key, self._fitted_to_more(photograph)
        return latest[1] or self

    def _fitted_to_more(self, photograph: Photograph) -> Self | None:
        """Return a method fitted to more than this one; None if a photograph has no more."""
        self.observation.check_size((1, *photograph.values.shape))
        own, given = self.observation.mask, named(self._given[1].get("backgrounds"))
        own = None if own is None else own.reshape(photograph.shape)
        _, mask, backgrounds = unwrapped(photograph, own, given)
        if len(backgrounds) == len(given) and np.array_equal(np.array(mask), np.array(own)):
            return None
        return self._fitted_anew(mask, backgrounds)

    def _fitted_anew(self, mask: Mask | None, backgrounds: Mapping[str, Image]) -> Self:
        arguments, settings = self._given
        if "hidden_shape" not in settings:
            raise InputError(
                "the photograph has another mask, or other monitor-off photographs, than this copy "
                "of a method, which has no A; pass mask= and backgrounds= to the constructor"
            )
        return type(self)(*arguments, **{**settings, "mask": mask, "backgrounds": backgrounds})

    def batches(self, photographs: Series) -> Iterator[tuple[Self, Image]]:
        """Yield photographs in turn, `BATCH` at most, beside the method that uses all of them."""
        stack: Any = photographs
        if hasattr(stack, "shape"):
            for start in range(0, len(stack), BATCH):
                yield self, np.asarray(stack[start : start + BATCH])
            return
        for method, group in groupby(photographs, self.fitted_to):
            while part := [*islice(group, BATCH)]:
                yield method, np.stack([plain_array(each) for each in unwrapped(part)[0]])

    @abstractmethod
    def solve(self, photograph: Photograph | Image) -> Solution[Precision]:
        """Recover the hidden image, with its noise and weight; see `reconstruct`."""

    def reconstruct(self, photograph: Photograph | Image) -> NDArray[Precision]:
        """Recover the hidden image from one photograph.

        Parameters
        ----------
        photograph
            A `Photograph`; or (rows, columns, 3) or (M, 3), linear, in any unit.

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
        UserWarning
            The photograph is of 8-bit integers, which are mostly encoded for screens.
        """
        return self.solve(photograph).image

    @of_all
    def report(self, photograph: Image, solution: Any) -> Report:
        """Return what the method knows of a solution beside its image.

        Parameters
        ----------
        photograph
            The photograph that `solve` got.
        solution
            The result of `solve`.

        Raises
        ------
        ValueError
            As in `reconstruct`.
        """
        transport = self.projected_transport()
        if transport is None:
            return Report(numbers=solution.numbers())
        signal = transport.light(self.observation.mixed(solution.image))
        warnings = [Note("no_hidden_image")] * _is_noise(signal, transport, solution.noise)
        residual, numbers = None, solution.numbers()
        if self.observation.rows_and_columns is not None:
            y = self.corrected(photograph, solution)
            residual = residual_of(y, signal, transport, self.observation.placed)
            if not self.judges_scene:
                residual = replace(residual, diagnosis="unknown")
            numbers = {**numbers, **residual.numbers()}
        report = Report(numbers=numbers, residual=residual)
        warnings += [report.verdict] * (report.verdict.code in ("does_not_fit", "unexplained"))
        return replace(report, warnings=warnings)

    @of_all
    def residual(self, photograph: Image, solution: Any) -> Residual | None:
        """Return what the scene and a solution leave of a photograph, and whether it is noise.

        The photograph is the corrected one. None where the method does not know A, or the
        photograph's rows and columns. Arguments and errors are those of `report`.
        """
        report: Report = StillMethod.report(self, photograph, solution)
        return report.residual

    def corrected(self, photograph: Image, solution: Any) -> Array:  # noqa: ARG002
        """Return the photograph that A f + B c + n describes, (M', 3), in the pixels used."""
        return self.observation.vectorized(photograph)

    def projected_transport(self) -> TransportOperator | None:
        """Return A⊥ of the pixels used; None where the method does not know it."""
        return None


def _is_noise(light: Array, transport: TransportOperator, noise: Array) -> bool:
    """Return whether an image's light A f̂, (M', 3), is no more than what noise makes of images."""
    energy = np.sum((transport.project_out(light) / np.maximum(noise, 1e-100)) ** 2)
    count = light.shape[1] * min(transport.shape)
    return bool(energy < count + SIGNIFICANT * np.sqrt(2 * count))
