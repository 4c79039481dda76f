"""Reconstruction methods by name, a user's own among them."""

import hashlib
import inspect
import re
import runpy
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import reduce
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError, did_you_mean
from periscopy_sim.extras import require
from periscopy_sim.model.colour_matrix import ColourMatrix
from periscopy_sim.model.fit import ambient_basis
from periscopy_sim.model.observation import Backgrounds, observation_of
from periscopy_sim.model.transport_operator import TransportOperator
from periscopy_sim.model.uncertainty import UncertainTransport
from periscopy_sim.numerics import Image, Mask
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.photograph import blackened
from periscopy_sim.reconstruction.method import Method, Report, Solution, StillMethod, of_all
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.scenario import Scenario

Matrix = NDArray[np.floating[Any]]
Factory = Callable[..., Method]
"""Fits a method to a scene, from the scenario, A, (M, N), and B, (M, L). With a keyword `mask` it
gets the mask, (rows, columns), or None; with a keyword `backgrounds`, photographs with the monitor
off, which are columns of B for other methods; with a keyword `colour_matrix` a `ColourMatrix`."""
MethodError = (Exception, SystemExit)
"""Errors of a method that end nothing but the method; `sys.exit` in it is such an error."""


def find_method(name: str) -> Factory:
    """Look up a method: one of `METHODS`, or a user's own.

    Parameters
    ----------
    name
        A name; or ``module:callable`` or ``path/to/file.py:callable``, where the callable (a class,
        say) takes (scenario, A, B), and the keyword ``mask`` if it likes, and returns an object
        with ``reconstruct(photograph) -> image``. Modules of the working folder are found too.

    Returns
    -------
    callable
        See `Factory`.

    Raises
    ------
    PeriscopyError
        If there is no such method, module, file or callable.
    """
    if name in METHODS:
        return METHODS[name]
    attribute = name.rpartition(":")[2]
    defined = SimpleNamespace(**_definitions(name))
    try:
        factory = reduce(getattr, attribute.split("."), defined)
        inspect.signature(factory).bind(None, None, None)  # type: ignore[arg-type]
    except AttributeError as error:
        raise PeriscopyError(
            f"method '{name}': there is no '{attribute}'; check the name"
        ) from error
    except (TypeError, ValueError) as error:
        raise PeriscopyError(
            f"method '{name}' is no callable of three arguments (scenario, A, B): {error}"
        ) from error
    return factory  # type: ignore[return-value]


def check_able(name: str, hidden_shape: tuple[int, int]) -> None:
    """Raise a PeriscopyError if a method lacks its library or does not support this size."""
    entry = METHODS.get(name)
    if entry is None:
        return
    if entry.hidden is not None and tuple(hidden_shape) != entry.hidden:
        rows, columns = entry.hidden
        raise PeriscopyError(
            f"method '{name}' learned from hidden images of {rows}x{columns} patches alone: take "
            "this size, or train networks of your own (make learned)"
        )
    if entry.needs:
        require(entry.needs)


def source_sha256(name: str) -> str | None:
    """Return the digest of the file of a user's own method; None for one of `METHODS`."""
    file = None if name in METHODS else _file(name)
    return hashlib.sha256(file.read_bytes()).hexdigest() if file else None


def fit_method(
    name: str,
    scenario: Scenario,
    A: Matrix,
    B: Matrix,
    mask: Mask | None = None,
    backgrounds: Backgrounds | None = None,
    uncertain: UncertainTransport | None = None,
    colour_matrix: ColourMatrix | None = None,
    **options: float,
) -> Method:
    """Fit a method to a scene, on one thread: the bits then do not depend on the number of cores.

    A is (M, N), B (M, L), the mask (rows, columns), True where the wall is used, the backgrounds
    are photographs with the monitor off, (rows, columns, 3) each. An uncertain scene and the
    options are for methods whose entry in `METHODS` takes them. It warns of a user's own callable
    that takes no mask. A PeriscopyError says that the callable takes no keyword colour_matrix where
    one is given, raised an error or returned no method, a ValueError that one of `METHODS` cannot
    be fitted to A and B.
    """
    from threadpoolctl import threadpool_limits

    fit = find_method(name)
    if backgrounds and not _takes(fit, "backgrounds"):
        shapes = scenario.hidden_shape, scenario.channel_gain, mask, scenario.photograph_shape
        B, backgrounds = observation_of(A, *shapes, backgrounds).joined(B), None
    if mask is not None and not _takes(fit, "mask"):
        warnings.warn(
            f"method '{name}' takes no keyword mask: it sees the pixels that are left out as black",
            stacklevel=2,
        )
        mask = None
    if colour_matrix is not None and not _takes(fit, "colour_matrix"):
        raise PeriscopyError(f"method '{name}' takes no keyword colour_matrix; add one")
    given: dict[str, Any] = {"mask": mask, "colour_matrix": colour_matrix, "uncertain": uncertain}
    given["backgrounds"] = backgrounds or None
    keywords = {keyword: each for keyword, each in given.items() if each is not None}
    with threadpool_limits(1), own_errors(name, "cannot be fitted"):
        method = fit(scenario, A, B, **keywords, **options)
    if not callable(getattr(method, "reconstruct", None)):
        raise PeriscopyError(
            f"method '{name}' makes an object of type {type(method).__name__}, which has no "
            "reconstruct(photograph); add one"
        )
    return method


def without_addresses(message: str) -> str:
    """Return a message on one line, without addresses of objects, which differ from run to run."""
    return " ".join(re.sub(r"0x[0-9a-f]{6,}", "0x...", message).split())


@contextmanager
def own_errors(name: str, what: str) -> Iterator[None]:
    """Turn any error of a user's own method into a PeriscopyError that says where it arose.

    It names the method, the consequence `what` (such as "cannot be fitted"), the error, and the
    last line of the method's file in its traceback. Errors of `METHODS` and a lack of memory pass.
    """
    try:
        yield
    except MemoryError:  # says more about the machine than about the method
        raise
    except MethodError as error:
        if name in METHODS:
            raise
        file = _file(name)
        frames = traceback.extract_tb(error.__traceback__)
        lines = [f.lineno for f in frames if file and Path(f.filename).resolve() == file.resolve()]
        where = f" ({file.name}:{lines[-1]})" if file and lines else ""
        raise PeriscopyError(
            f"method '{name}' {what}: {type(error).__name__}: {error}{where}"
        ) from error


def image_by(
    method: Method, photograph: Image, hidden_shape: tuple[int, int]
) -> NDArray[np.float32]:
    """Reconstruct from a photograph, (rows, columns, 3), and check the image by `promised`."""
    return promised(method.reconstruct(photograph), hidden_shape)


def promised(image: Any, hidden_shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return a method's image as float32; a ValueError unless (R, C, 3), real and finite."""
    values = np.asarray(image)
    if values.shape != (*hidden_shape, 3) or values.dtype.kind not in "iuf":
        raise ValueError(
            f"returned {values.dtype} of shape {values.shape} instead of real numbers of shape "
            f"{(*hidden_shape, 3)}"
        )
    with np.errstate(over="ignore"):  # infinities are counted
        single: NDArray[np.float32] = values.astype(np.float32)
    if not np.isfinite(single).all():
        wrong = np.count_nonzero(~np.isfinite(single))
        raise ValueError(f"returned NaN or infinite values, {wrong} of {single.size}")
    return single


class OwnMethod(StillMethod[np.float64]):
    """A user's own method; its report rescales each channel to the best fit."""

    def __init__(self, A: Matrix, B: Matrix | None = None, *, method: Method, **observed: Any):
        super().__init__(A, **observed)
        self.method = method
        self._A = self.observation.used_transport(A)
        self._Q, _ = ambient_basis(self.observation, B, profiles=True)

    def _fitted_anew(self, mask: Mask | None, backgrounds: Mapping[str, Image]) -> Self:  # noqa: ARG002
        raise PeriscopyError(
            "the photograph has another mask, or other monitor-off photographs, than the method "
            "was fitted with; pass mask= and backgrounds= to fit_method"
        )

    @of_all
    def solve(self, photograph: Image) -> Solution[np.float64]:
        """Return the method's image; a ValueError unless it is (R, C, 3), real and finite.

        The method sees the pixels that its mask excludes as black.
        """
        photograph = blackened(photograph, self.observation.mask)
        image = image_by(self.method, photograph, self.hidden_shape).astype(np.float64)
        return Solution(image, np.zeros(3), 0.0)

    def projected_transport(self) -> TransportOperator | None:
        """Return A⊥ of the pixels used; None where B explains all of A."""
        with suppress(InputError):
            return TransportOperator(self._A, self._Q)
        return None

    @of_all
    def report(self, photograph: Image, solution: Solution[np.float64]) -> Report:
        """Return the residual and its warnings; see `StillMethod`."""
        if (transport := self.projected_transport()) is None:
            return Report()
        y = transport.project_out(self.observation.vectorized(photograph))
        light = transport @ self.observation.mixed(solution.image)
        gains = np.sum(light * y, axis=0) / np.maximum(np.sum(light**2, axis=0), 1e-100)
        report = super().report(photograph, replace(solution, image=solution.image * gains))
        return replace(report, numbers=report.residual.numbers() if report.residual else {})


def _takes(fit: Factory, keyword: str) -> bool:
    """Return whether a callable accepts a keyword beside scenario, A and B."""
    try:
        inspect.signature(fit).bind(None, None, None, **{keyword: None})
    except TypeError:
        return False
    return True


def _place(name: str) -> str:
    """Return the module, or the file, of a user's own method: the name before its colon."""
    place, _, attribute = name.rpartition(":")
    if not (place and attribute):
        guess = did_you_mean(name, METHODS)
        raise PeriscopyError(
            f"no method '{name}'; {f'{guess} ' if guess else ''}use "
            f"{', '.join(METHODS)}, or your own as module:callable or path/to/file.py:callable"
        )
    return place


def _file(name: str) -> Path | None:
    """Find the file of a user's own method, where its module has one."""
    place = _place(name)
    file = place if place.endswith(".py") else _definitions(name).get("__file__")
    return Path(file) if file else None


def _definitions(name: str) -> dict[str, Any]:
    """Return what the module, or the file, of a user's own method defines.

    No other code can import what a file defines, so that pickle sends its definitions along with
    its objects, to workers that have no such file.
    """
    place = _place(name)
    path = Path(place).resolve()
    is_file = path.suffix == ".py"
    if is_file and path.exists() and not path.is_file():  # a pipe could be waited for without end
        raise PeriscopyError(f"method '{name}': {path.name} is no regular file; name a file")
    sys.path.insert(0, str(path.parent))
    try:
        if is_file:
            return runpy.run_path(place, run_name=f"{path.stem} of {path}")
        return vars(import_module(place))
    except MethodError as error:  # whatever the user's own code raises
        raise PeriscopyError(
            f"method '{name}' cannot be imported: {type(error).__name__}: {error}"
        ) from error
    finally:
        sys.path.remove(str(path.parent))
