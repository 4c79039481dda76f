"""Reconstruction methods by name, and a user's own, as ``module:callable`` or ``file.py:callable``.

A user's camera is named like a method.
"""

import hashlib
import inspect
import re
import runpy
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from importlib import import_module
from pathlib import Path
from time import thread_time
from types import SimpleNamespace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.hidden import Hidden
from periscopy_sim.model.uncertainty import UncertainTransport
from periscopy_sim.numerics import Image, machine
from periscopy_sim.numerics.validation import InputError, plain_array
from periscopy_sim.photograph import Photograph, blackened
from periscopy_sim.reconstruction.method import Method, Report, Solution, StillMethod, of_all
from periscopy_sim.reconstruction.noise_aware import NoiseAware
from periscopy_sim.reconstruction.registry import METHODS, SUCCESSORS, MethodEntry

OwnError = (Exception, SystemExit)
"""Errors of a user's code that end nothing else; `sys.exit` in it is such an error."""

PACKAGE = Path(__file__).parent


@dataclass(frozen=True)
class OwnCode:
    """A user's own code by its name; messages say what it is, such as "method".

    Modules of the working folder are found too.
    """

    kind: str
    name: str

    @property
    def place(self) -> str:
        """The module or file."""
        return self.name.rpartition(":")[0]

    @property
    def attribute(self) -> str:
        """What it is called there."""
        return self.name.rpartition(":")[2]

    @property
    def is_complete(self) -> bool:
        """Whether the name has both parts."""
        return bool(self.place) and all(map(str.isidentifier, self.attribute.split(".")))

    @property
    def file(self) -> Path | None:
        """The file, where the module has one."""
        is_file = self.place.endswith(".py")
        file = self.place if is_file else self._definitions().get("__file__")
        return Path(file) if file else None

    def load(self) -> Any:
        """Return the callable; a PeriscopyError says that it does not exist."""
        try:
            defined: Any = SimpleNamespace(**self._definitions())
            return reduce(getattr, self.attribute.split("."), defined)
        except AttributeError as error:
            raise PeriscopyError(
                f"{self.kind} '{self.name}': there is no '{self.attribute}'; check the name"
            ) from error

    def _definitions(self) -> dict[str, Any]:
        """Return what the module or the file defines.

        No other code can import what a file defines, so that pickle sends its definitions along
        with its objects, to workers that have no such file.
        """
        path = Path(self.place).resolve()
        sys.path.insert(0, str(path.parent))
        try:
            with own_errors(f"{self.kind} '{self.name}' cannot be imported", path):
                if path.suffix == ".py":
                    return runpy.run_path(self.place, run_name=f"{path.stem} of {path}")
                return vars(import_module(self.place))
        finally:
            sys.path.remove(str(path.parent))


def place_of(function: Callable[..., Any]) -> str:
    """Return the file and the first line of a function, in brackets; empty where it has none."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    code = code or getattr(type(function).__call__, "__code__", None)
    return f" ({Path(code.co_filename).name}:{code.co_firstlineno})" if code else ""


@contextmanager
def own_errors(failure: str, file: Path | None = None) -> Iterator[None]:
    """Turn any error of a user's own code into a PeriscopyError that says where it arose.

    It names the failure, the error, and the last line of a file in its traceback: None for the
    first file that is not of this package. A lack of memory passes.
    """
    try:
        yield
    except MemoryError:  # says more about the machine than about the code
        raise
    except OwnError as error:
        frames = [
            (Path(each.filename).resolve(), each.lineno)
            for each in traceback.extract_tb(error.__traceback__)
        ]
        outside = (path for path, _ in frames if PACKAGE not in path.parents)
        file = file.resolve() if file else next(outside, None)
        lines = [line for path, line in frames if path == file]
        where = f" ({file.name}:{lines[-1]})" if file and lines else ""
        raise PeriscopyError(f"{failure}: {type(error).__name__}: {error}{where}") from error


Name = str | Callable[..., Any]
"""A method's name, see `find_method`, or a user's own factory."""


@dataclass(frozen=True)
class OwnEntry:
    """A user's own method, as `MethodEntry` is one of the package."""

    name: Name
    factory: Callable[..., Method]  # (scenario, A, B), and a keyword ``mask`` if it takes one
    takes_mask: bool

    def __call__(
        self,
        scene: Any,
        A: Image,
        B: Image,
        uncertain: UncertainTransport | None = None,  # noqa: ARG002  it knows none
    ) -> "OwnMethod":
        """Return the method for a scene; the first photograph makes the user's own object."""
        return OwnMethod.for_scene(scene, A, B, scenario=scene, entry=self)


def find_method(name: Name) -> MethodEntry | OwnEntry:
    """Return a method, one of `METHODS` or a user's own: of (scenario, A, B), a `StillMethod`.

    A user's own is a callable, ``module:callable`` or ``path/to/file.py:callable``, where it (a
    class, say) takes (scenario, A, B), and the keyword ``mask`` if it likes, and returns an object
    with ``reconstruct(photograph) -> image``. Modules of the working folder are found too. A
    PeriscopyError says that there is no such method, module, file or callable.
    """
    if isinstance(name, str) and name in METHODS:
        return METHODS[name]
    factory = _own_code(name).load() if isinstance(name, str) else name
    try:
        signature = inspect.signature(factory)
        signature.bind(None, None, None)
    except (TypeError, ValueError) as error:
        raise PeriscopyError(
            f"method '{label_of(name)}' is no callable of three arguments (scenario, A, B): {error}"
        ) from error
    return OwnEntry(name, factory, "mask" in signature.parameters)


@dataclass(frozen=True)
class OwnAxis:
    """A user's own axis of a sweep: what a camera makes of photographs at each of its values.

    Its function takes a photograph, (rows, columns, channels), and a value, and returns another.
    """

    name: Name
    function: Callable[[Image, Any], Any]

    @classmethod
    def of(cls, name: Name) -> Self:
        """Return the axis of ``module:callable``, ``file.py:callable`` or a callable.

        A PeriscopyError says that there is no such callable, or that it takes something else.
        """
        function = OwnCode("axis", name).load() if isinstance(name, str) else name
        try:
            inspect.signature(function).bind(None, None)
        except (TypeError, ValueError) as error:
            raise PeriscopyError(
                f"axis '{label_of(name)}' is no callable of a photograph and a value: {error}"
            ) from error
        return cls(name, function)

    @property
    def label(self) -> str:
        """The name of the axis in results: that of the function."""
        return label_of(self.name).rpartition(":")[2].rpartition(".")[2]

    def __call__(self, value: Any, photograph: Image) -> Image:
        """Return a photograph at a value; a PeriscopyError if the function fails or does not."""
        with own_errors(f"axis '{label_of(self.name)}' failed", _file_of(self.name)):
            changed = promised(self.function(photograph.copy(), value), photograph.shape)
        return changed.astype(np.float64)


def _own_code(name: str) -> OwnCode:
    """Return where a user's own method is; a PeriscopyError names those that there are."""
    own = OwnCode("method", name)
    if not own.is_complete:
        if name in SUCCESSORS:
            raise PeriscopyError(f"method '{name}' is gone: use {SUCCESSORS[name]}")
        guess = did_you_mean(name, METHODS)
        raise PeriscopyError(
            f"no method '{name}'; {f'{guess} ' if guess else ''}use "
            f"{', '.join(METHODS)}, or your own as module:callable or path/to/file.py:callable"
        )
    return own


def source_sha256(name: Name) -> str | None:
    """Return the digest of the file of a user's own method; None for one of `METHODS`.

    A PeriscopyError says that there is no such method or file.
    """
    file = _file_of(name)
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest() if file else None
    except OSError as error:
        reason = f"{file}: {error.strerror}"
        raise PeriscopyError(f"method '{label_of(name)}': {reason}; check the path") from error


def label_of(name: Name) -> str:
    """Return what a method is called."""
    return name if isinstance(name, str) else getattr(name, "__qualname__", repr(name))


def entry_of(name: Name) -> MethodEntry | None:
    """Return the entry of a method in `METHODS`; None for a user's own."""
    return METHODS.get(label_of(name))


def _file_of(name: Name) -> Path | None:
    """Return the file of a user's own method; None for one of `METHODS`, or without a file."""
    if isinstance(name, str):
        return None if name in METHODS else _own_code(name).file
    with suppress(TypeError, OSError):
        if (file := Path(inspect.getfile(name))).is_file():  # none of what was typed in
            return file
    return None


def fit_method(
    name: Name,
    scenario: Any,
    A: Image,
    B: Image,
    photograph: Photograph | Image | None = None,
    uncertain: UncertainTransport | None = None,
    **options: float,
) -> StillMethod[Any]:
    """Fit a method to a scene and to the conditions of a photograph, see `StillMethod.fitted_to`.

    It runs on one thread: the bits then do not depend on the number of cores. A is (M, N), B
    (M, L). An uncertain scene and the options are for methods whose entry in `METHODS` takes them.
    A PeriscopyError says that a user's own callable raised an error or returned no method, a
    ValueError that one of `METHODS` cannot be fitted.
    """
    entry = find_method(name)
    known = {each.name: each for each in getattr(entry, "options", ())}
    for option, value in options.items():
        if option not in known:
            raise PeriscopyError(
                f"{label_of(name)} has no option '{option}'; it has {', '.join(known) or 'none'}"
            )
        options[option] = known[option].checked(value)
    with threadpool_limits(1):
        return entry(scenario, A, B, uncertain, **options).fitted_to(photograph)


def without_addresses(message: str) -> str:
    """Return a message on one line, without addresses of objects, which differ from run to run."""
    return " ".join(re.sub(r"0x[0-9a-f]{6,}", "0x...", message).split())


@contextmanager
def method_errors(name: Name, what: str) -> Iterator[None]:
    """Turn any error of a user's own method into a PeriscopyError that says where it arose.

    It names the method and the consequence `what`, such as "cannot be fitted"; see
    `own_errors`. Errors of `METHODS` pass.
    """
    if isinstance(name, str) and name in METHODS:
        yield
    else:
        with own_errors(f"method '{label_of(name)}' {what}", _file_of(name)):
            yield


Images = dict[str, NDArray[np.float32]]
"""By surface, (R, C, channels)."""


class Estimates(NamedTuple):
    """What a method makes of a photograph: images and, if it knows them, their standard errors."""

    images: Images
    errors: Mapping[str, Image]
    seconds: float  # of this thread, for the images


def estimates_by(method: Method, photograph: Image, hidden: Hidden, channels: int) -> Estimates:
    """Reconstruct from a photograph: `checked_images`, with standard errors by surface."""
    fitted: Any = method.fitted_by(photograph) if hasattr(method, "fitted_by") else method
    knows_errors = isinstance(fitted, NoiseAware)
    with machine.one_thread():
        started = thread_time()
        found = fitted.solve(photograph) if knows_errors else fitted.reconstruct(photograph)
        seconds = thread_time() - started
    images = checked_images(found.image if knows_errors else found, hidden, channels)
    errors = fitted.standard_errors(found) if knows_errors else None
    return Estimates(images, {} if errors is None else hidden.images(errors), seconds)


def checked_images(image: Any, hidden: Hidden, channels: int) -> Images:
    """Return what a method returned as each surface's image, checked by `promised`."""
    images = hidden.images(image)
    return {n: promised(images[n], (*shape, channels)) for n, shape in hidden.shapes.items()}


def promised(image: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return a method's image as float32; a ValueError unless it is real and finite.

    The shape is (R, C, channels), or (R, C) of any number of channels.
    """
    values = np.asarray(image)
    fits = values.ndim == 3 and values.shape[: len(shape)] == shape
    if not fits or values.dtype.kind not in "iuf":
        raise ValueError(
            f"returned {values.dtype} of shape {values.shape} instead of real numbers of shape "
            f"{shape}"
        )
    with np.errstate(over="ignore"):  # infinities are counted
        single: NDArray[np.float32] = values.astype(np.float32)
    if not np.isfinite(single).all():
        wrong = np.count_nonzero(~np.isfinite(single))
        raise ValueError(f"returned NaN or infinite values, {wrong} of {single.size}")
    return single


class OwnMethod(StillMethod[np.float64]):
    """A user's own method; its report rescales each channel to the best fit.

    The method's B has a column more for each channel of each photograph with the monitor off. Its
    photographs are black outside the mask, and in the monitor's primaries if there is a colour
    matrix.
    """

    def __init__(
        self, A: Image, B: Image | None = None, *, scenario: Any, entry: OwnEntry, **sizes: Any
    ) -> None:
        super().__init__(A, B, **sizes)
        self.fit = replace(self.fit, profiles=True)
        self._scenario, self._entry = scenario, entry

    @cached_property
    def method(self) -> Method:
        """The user's object, made for the fit."""
        fit, name = self.fit, self._entry.name
        keywords: dict[str, Any] = {}
        if fit.mask is not None and self._entry.takes_mask:
            keywords["mask"] = fit.mask.reshape(fit.shape)
        elif fit.mask is not None:
            warnings.warn(
                f"method '{label_of(name)}' takes no keyword mask: it sees the pixels that are "
                "left out as black",
                stacklevel=2,
            )
        with method_errors(name, "cannot be fitted"):
            method = self._entry.factory(self._scenario, fit.A, fit.whole_background, **keywords)
        if not callable(getattr(method, "reconstruct", None)):
            raise PeriscopyError(
                f"method '{label_of(name)}' makes an object of type {type(method).__name__}, which "
                "has no reconstruct(photograph); add one"
            )
        return method

    def prepare(self) -> None:
        """Make the user's object; see `StillMethod`."""
        _ = self.method

    @of_all
    def solve(self, photograph: Image) -> Solution[np.float64]:
        """Return the method's image, (R, C, channels), real and finite.

        Of several surfaces the method returns a mapping of such by id. A PeriscopyError names the
        method, and what it raised, or returned instead.
        """
        light = plain_array(photograph)
        if self.fit.mixing is not None:
            planes = self.fit.vectors(light)
            planes = planes * self.fit.gain(planes.shape[-1])
            light = np.moveaxis(self.fit.placed(planes), 0, -1)
        mask = None if self.fit.mask is None else self.fit.mask.reshape(light.shape[:-1])
        light = blackened(light, mask)
        channels, method = light.shape[-1], self.method
        with method_errors(self._entry.name, "failed"):
            found = checked_images(method.reconstruct(light), self.hidden, channels)
        image = self.hidden.image(self.hidden.join(found).astype(np.float64))
        return Solution(image, np.zeros(channels), 0.0)

    @of_all
    def report(self, photograph: Image, solution: Solution[np.float64]) -> Report:
        """Return the residual and its warnings; see `StillMethod`. Nothing if B explains all of A.

        The method's units are its own, so that each channel is rescaled to fit the photograph.
        """
        try:
            transport = self.fit.operator
        except InputError:
            return Report()
        y = transport.project_out(self.fit.vectors(photograph))
        light = transport @ self.fit.mixed(solution.image)
        gains = np.sum(light * y, axis=0) / np.maximum(np.sum(light**2, axis=0), 1e-100)
        image = self.hidden.image(self.hidden.vector(solution.image) * gains)
        report = super().report(photograph, replace(solution, image=image))
        return replace(report, numbers=report.residual.numbers() if report.residual else {})
