"""The bases of all methods, for single photographs and for video."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from itertools import groupby, islice
from typing import Any, Generic, Protocol, Self, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.model.fit import Fit
from periscopy_sim.model.residual import Residual, quick_residual, residual_of
from periscopy_sim.model.transport_operator import RANK_TOLERANCE
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.validation import InputError, checked_number, checked_scene, plain_array
from periscopy_sim.photograph import Photograph

Precision = TypeVar("Precision", bound=np.floating[Any])
Result = TypeVar("Result")
Series: TypeAlias = Image | Iterable[Photograph | Image]


@dataclass(frozen=True)
class Note:
    """A note for the user: a code, whose sentence `cli.messages` holds, and its values."""

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return the code and its values on one line; the command line has whole sentences."""
        texts = {n: f"{v:.3g}" if isinstance(v, float) else str(v) for n, v in self.values.items()}
        listed = ", ".join(f"{name.replace('_', ' ')} {text}" for name, text in texts.items())
        return ": ".join(filter(None, [self.code.replace("_", " "), listed]))


@dataclass(frozen=True, eq=False)
class Report:
    """A solution's numbers, pictures, notes and warnings."""

    numbers: Mapping[str, Any] = field(default_factory=dict)  # for a summary, by name
    notes: Sequence[Note] = ()  # facts that a user may want to know
    warnings: Sequence[Note] = ()  # reasons why the image may be wrong
    stages: Sequence[tuple[str, Image]] = ()  # titles and images that led to the solution
    standard_errors: Array | None = None  # (R, C, channels); None where the method knows none
    residual: Residual | None = None  # None where the photograph's rows and columns are unknown
    remedies: Sequence[Note] = ()  # what lowers the residual, see `Scenario.judge`

    def lines(self) -> list[str]:
        """Return the verdict, the remedies, the other warnings and the notes, one line each."""
        others = [note for note in self.warnings if note.code != self.verdict.code]
        return [*map(str, [self.verdict, *self.remedies, *others, *self.notes])]

    def __str__(self) -> str:
        """Return `lines` as a text."""
        return "\n".join(self.lines())

    @property
    def verdict(self) -> Note:
        """Whether the scene fits, with what is unexplained and the noise, in percent."""
        residual = self.residual
        if residual is None:
            return Note("no_residual")
        code: str = residual.diagnosis if residual.diagnosis != "unknown" else "not_judged"
        if residual.is_large and code != "does_not_fit":
            code = "unexplained"
        elif residual.is_left and code == "fits":
            code = "image_does_not_fit"
        elif residual.is_smooth and code == "fits":
            code = "nearly_fits"
        names = "unexplained", "unexplained_by_any", "noise_alone"
        return Note(code, {name: 100 * (getattr(residual, name) or 0.0) for name in names})

    @property
    def is_doubted(self) -> bool:
        """Whether the verdict is a warning."""
        return self.verdict.code not in ("fits", "not_judged", "no_residual")


class Method(Protocol):
    """Anything that turns a photograph into a hidden image: the package's methods, a user's own."""

    def reconstruct(self, photograph: Image) -> Image:
        """Recover the hidden image, (R, C, channels), from (rows, columns, channels)."""


@dataclass(frozen=True, eq=False)
class Solution(Generic[Precision]):
    """A hidden image and how it came about.

    Attributes
    ----------
    image
        (R, C, channels) the result, in units of the photograph's over those of A.
    noise
        (channels,) standard deviation of the photograph's noise, as estimated from what the method
        cannot explain of it.
    weight
        λ, the total-variation weight used: (channels,), or one for all.
    """

    image: NDArray[Precision]
    noise: Array
    weight: Array | float

    def __repr__(self) -> str:
        """Return its size, the mean noise and the mean weight on one line."""
        image: Any = self.image
        images = image.values() if isinstance(image, Mapping) else [image]
        sizes = ", ".join("{}x{}".format(*each.shape[:2]) for each in images)
        noise, weight = (float(np.mean(number)) for number in (self.noise, self.weight))
        return f"{type(self).__name__}({sizes}, noise {noise:.3g}, weight {weight:.3g})"

    def numbers(self) -> dict[str, Any]:
        """Return the numbers that a summary or a table records, by name."""
        return {"noise": self.noise, "lambda": self.weight}


BATCH = 64
"""Photographs that a matrix is applied to in one product: 6 MB each at 500 x 500 pixels."""

SIGNIFICANT = 3.0
"""Standard errors by which a hidden image's light exceeds what noise alone would make of one."""


def of_all(function: Callable[..., Result]) -> Callable[..., Result]:
    """Let a method's function of a photograph accept a `Photograph`, and use all of it."""

    @wraps(function)
    def accepting(self: Any, photograph: Photograph | Image, *rest: Any, **named: Any) -> Result:
        if isinstance(photograph, Photograph):
            self, photograph = self.fitted_to(photograph), photograph.values
        return function(self, photograph, *rest, **named)

    return accepting


class StillMethod(ABC, Generic[Precision]):
    """A method for one scene; it recovers the hidden image of each photograph separately.

    `solve` returns the image and its numbers, `report` everything else that the method knows of
    them. Both accept arrays, and `Photograph`s, whose masks, photographs with the monitor off and
    colour matrices the method then uses, see `fitted_to`.

    The constructor checks sizes and settings. The first photograph, or `fitted_to`, computes what
    all photographs share.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds; None for none. Methods that model no backgrounds ignore them.
    hidden
        The hidden surfaces, `Scenario.hidden`; or the size (R, C) of one, with R C = N, or a
        mapping of sizes by id.
    photograph_shape
        (rows, columns) that photographs must have; None checks the number of pixels alone.
    channel_gain
        Positive colour of the wall, `Scenario.channel_gain`: a number for each channel, or (M,
        channels) of a texture; None for a grey wall. A grey photograph shows no colour.
    paint
        (M, 1) brightness of the wall in the rows of A and B, `Scenario.paint`, for smooth light
        beside B; None for an even wall.
    rank_tolerance
        Relative tolerance on B's singular values, for methods that model backgrounds; see
        `background_basis`.

    Attributes
    ----------
    fit
        The `Fit` that the method asks, under the conditions of the photographs that it is for.

    Raises
    ------
    TypeError
        If a scene stands in the place of A: use `for_scene`.
    ValueError
        If A or B is no dense matrix of real numbers, the sizes do not fit, the wall reflects
        nothing in a channel, or a number is out of range. With the first photograph: if A or B is
        not finite where it is used.
    """

    precision: type[np.floating[Any]] = np.float64
    """Floating-point type of the images."""

    mixes_colours = False
    """Whether the method's model has the colour matrix; the others unmix the photograph."""

    judges_scene = True
    """Whether the image is a least-squares fit, whose residual shows if the scene fits."""

    name = ""
    """The method's name, where a scenario fitted it."""

    plan: Any = None
    """How A was made, where a scenario fitted the method: a `TransportPlan`."""

    _latest: tuple[bytes, Self] | None = None

    def __new__(cls, *arguments: Any, **_: Any) -> Self:
        """Reject a scene in the place of A, by a TypeError that names `for_scene`."""
        if arguments and hasattr(arguments[0], "photograph_shape"):
            raise TypeError(
                f"A comes first; to fit to a scene, {cls.__name__}.for_scene(scene, A, B)"
            )
        return super().__new__(cls)

    def __init__(
        self,
        A: Any,
        B: Image | None = None,
        *,
        hidden: Hidden | Size | Mapping[str, Size],
        photograph_shape: Size | None = None,
        channel_gain: Image | None = None,
        paint: Image | None = None,
        rank_tolerance: float = RANK_TOLERANCE,
    ) -> None:
        self.fit = Fit(
            A,
            B,
            hidden=Hidden.of(hidden),
            photograph_shape=photograph_shape,
            channel_gain=channel_gain,
            paint=paint,
            rank_tolerance=rank_tolerance,
            unmixes=not self.mixes_colours,
        )

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the latest method for other conditions."""
        return {**vars(self), "_latest": None}

    def __repr__(self) -> str:
        """Return its sizes on one line."""
        pixels = "x".join(map(str, self.fit.shape or self.fit.A.shape[:1]))
        return f"{type(self).__name__}({self.hidden.sizes} patches, {pixels} pixels)"

    @property
    def hidden(self) -> Hidden:
        """The hidden surfaces of the N patches."""
        return self.fit.hidden

    @property
    def hidden_shape(self) -> Size:
        """(R, C) of the hidden image, of one surface."""
        return self.hidden.shape

    @classmethod
    def for_scene(cls, scene: Any, A: Any, B: Any = None, **settings: Any) -> Self:
        """Fit to a scenario, which gives the sizes and the colour of the wall.

        The scene is a `Scenario`, or anything with its ``photograph_shape``, ``hidden`` and
        ``channel_gain``, and ``paint`` where the wall has a texture. A, B and the settings are the
        class's parameters.
        """
        checked_scene(scene)
        construct: Callable[..., Self] = cls
        return construct(
            A,
            B,
            hidden=scene.hidden,
            photograph_shape=scene.photograph_shape,
            channel_gain=scene.channel_gain,
            paint=getattr(scene, "paint", None),
            **settings,
        )

    def fitted_to(self, photograph: Photograph | Image | None = None) -> Self:
        """Return the method for the conditions of a photograph, ready for it.

        The method uses the pixels of its mask, projects out the light of its photographs with the
        monitor off, and knows its colour matrix; for a photograph without conditions, an array, or
        None, it is this method. All that does not depend on the values is computed. The latest such
        method is kept: photographs under the same conditions are fitted once.

        Raises
        ------
        ValueError
            As the class, if the mask leaves fewer pixels than patches, the wall's colour or the
            colour matrix is not of the photograph's channels, or a photograph with the monitor off
            is of another size, not finite where it is used, or without light.
        """
        key = photograph.conditions if isinstance(photograph, Photograph) else None
        own = self.fit.conditions
        if key is None or (own is not None and own.conditions == key):
            self.prepare()
            return self
        latest = self._latest  # another thread may replace it
        if latest is None or latest[0] != key:
            assert isinstance(photograph, Photograph)
            method = copy(self)
            for name in [*vars(method)]:
                if isinstance(getattr(type(self), name, None), cached_property):
                    delattr(method, name)  # it followed from the fit
            method.fit, method._latest = replace(self.fit, conditions=photograph), None
            method.prepare()
            self._latest = latest = key, method
        return latest[1]

    def prepare(self) -> None:
        """Compute all that photographs under the same conditions share."""

    def batches(self, photographs: Series) -> Iterator[tuple[Self, Image]]:
        """Yield photographs in turn, `BATCH` at most, beside the method for their conditions."""
        stack: Any = photographs
        if hasattr(stack, "shape"):
            for start in range(0, len(stack), BATCH):
                yield self, np.asarray(stack[start : start + BATCH])
            return
        for method, group in groupby(photographs, self.fitted_to):
            while part := [*islice(group, BATCH)]:
                values = (each.values if isinstance(each, Photograph) else each for each in part)
                yield method, np.stack([plain_array(each) for each in values])

    @abstractmethod
    def solve(self, photograph: Photograph | Image) -> Solution[Precision]:
        """Recover the hidden image, with its noise and weight; see `reconstruct`."""

    def reconstruct(self, photograph: Photograph | Image) -> NDArray[Precision]:
        """Recover the hidden image from one photograph.

        Parameters
        ----------
        photograph
            A `Photograph`; or (rows, columns, channels) or (M, channels), linear, in any unit.

        Returns
        -------
        ndarray
            (R, C, channels), linear, in units of the photograph's over those of A; negative where
            noise makes it so and the method lets it. float64, but float32 from an explicit
            `Periscope`.

        Raises
        ------
        ValueError
            If the photograph has not M pixels, or is not finite where it is used, or its channels
            do not show the wall's colour.

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

        The photograph is the one that `solve` got, the solution its result. Errors are those of
        `reconstruct`.
        """
        operator = self.fit.operator
        signal = operator.light(self.fit.mixed(solution.image))
        over_noise = operator.project_out(signal) / np.maximum(solution.noise, 1e-100)
        count = signal.shape[1] * min(operator.shape)
        is_noise = np.sum(over_noise**2) < count + SIGNIFICANT * np.sqrt(2 * count)
        warnings = [Note("no_hidden_image")] * bool(is_noise)
        residual, numbers = None, solution.numbers()
        y = self.corrected(photograph, solution)
        if y.shape != signal.shape:
            raise InputError(
                f"the solution is of another photograph or scenario: {y.shape} pixels and channels "
                f"beside {signal.shape}; give those that it was solved for"
            )
        if self.fit.shape is not None:
            residual = residual_of(y, signal, self.fit, solution.image)
            if not self.judges_scene:
                residual = replace(residual, diagnosis="unknown")
            numbers = {**numbers, **residual.numbers()}
        report = Report(numbers=numbers, residual=residual)
        warnings += [report.verdict] * report.is_doubted
        return replace(report, warnings=warnings)

    def residual(self, photograph: Photograph | Image, solution: Any) -> Residual | None:
        """Return what the scene and a solution leave of a photograph, and whether it is noise.

        The photograph is the corrected one. None where the photograph's rows and columns are
        unknown. Arguments and errors are those of `report`.
        """
        report: Report = StillMethod.report(self, photograph, solution)
        return report.residual

    def quick_residual(self, photograph: Image, solution: Any, noise: float) -> Residual:
        """Return the residual of a photograph whose noise over its light is known, quickly."""
        y = self.corrected(photograph, solution)
        return quick_residual(y, solution.image, noise, self.fit)

    def corrected(self, photograph: Image, solution: Any) -> Array:  # noqa: ARG002
        """Return the photograph that A f + B c + n describes, (M', C), in the pixels used."""
        return self.fit.vectors(photograph)


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
