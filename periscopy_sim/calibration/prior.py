"""What is known of a scene's parameters before the photograph: measured values and their errors."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from periscopy_sim.calibration.scene_covariance import scene_covariance
from periscopy_sim.errors import SceneError
from periscopy_sim.geometry import Geometry
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.limits import LARGEST, SMALLEST, number_of
from periscopy_sim.numerics.validation import listed
from periscopy_sim.scene import RULER_ERROR, SceneDocument

Free = str | Sequence[str] | Mapping[str, float | None]
"""Names of free parameters, or names with the errors of their measured values."""


@dataclass(frozen=True, eq=False)
class UncertainParameters:
    """``<default>``s of a scene fixed at values, (U,), that have standard errors, (U,)."""

    names: tuple[str, ...]
    values: Array
    standard_errors: Array


FARTHEST = 3.0
"""Standard deviations within which a ruler errs (all but 3 in 1000); a search's longest step."""

TRIES = 100
"""Draws of a number that a scene may reject before the error is raised."""


def read_by_ruler(scenario: Geometry, seed: Sequence[int]) -> dict[str, float]:
    """Draw what a ruler reads of every number that declares an error: normal errors, by name.

    A number that the scene rejects, such as a board's negative thickness, is drawn again; if the
    scene rejects all draws, a SceneError is raised.
    """
    errors, rng = free_parameters(scenario.document), np.random.default_rng(seed)
    read: dict[str, float] = {}
    true = start_values(scenario.document, tuple(errors))
    for (name, error), value in zip(errors.items(), true, strict=True):
        for _ in range(TRIES):
            number = float(f"{value + error * rng.standard_normal():.6g}")
            with suppress(SceneError):
                scenario.at(**read, **{name: number})
                read[name] = number
                break
        else:
            raise SceneError(
                f"{name} = {value:g} with errors of {error:g}: the scene '{scenario.path}' rejects "
                f"{TRIES} draws; declare a smaller error"
            )
    return read


def uncertain_parameters(
    document: SceneDocument, free: Sequence[str], errors: Mapping[str, float] | None
) -> UncertainParameters:
    """Return uncertain parameters of a scene by their standard errors; `free` are others.

    None are all others whose error is known: by a calibration that the scene carries, or a ruler.
    A SceneError says that one is not declared, no finite number, free, or its error not positive.
    """
    if errors is None:
        known, carried = declared_errors(document), scene_covariance(document)
        if carried is not None:
            changed = carried.changed(document)
            pairs = zip(carried.names, carried.errors.tolist(), strict=True)
            known |= {name: error for name, error in pairs if name not in changed}
        errors = {name: error for name, error in known.items() if error > 0 and name not in free}
    names = tuple(errors)
    for name in names:
        if name in free:
            raise SceneError(f"'{name}' is both free and uncertain: free it or hold it")
        check_error(name, errors[name])
    values = start_values(document, names) if names else np.empty(0)
    return UncertainParameters(names, values, np.array(list(errors.values()), np.float64))


def start_values(document: SceneDocument, free: Sequence[str]) -> Array:
    """Return where parameters of a scene start, (P,): as given, or at their defaults.

    A SceneError says that none is free, one is not declared, or no finite number.
    """
    path, values = document.path, document.values
    declared = {n: text for n, text in document.defaults.items() if n not in document.errors}
    numbers = {name: text for name, text in declared.items() if np.isfinite(number_of(text))}
    known = ", ".join(f"{name} ({value})" for name, value in numbers.items()) or "none"
    if not free:
        raise SceneError(
            "no parameter is free; name some, or declare the errors of their measured values, such "
            f"as {_declaration('NAME')}; scene '{path}' declares {known}"
        )
    for name in free:
        if name not in document.defaults:
            raise document.undeclared(name)
        if name not in numbers or not np.isfinite(number_of(values[name])):
            raise SceneError(
                f"{name}={values[name]}: a free parameter is a finite number and no error; scene "
                f"'{path}' declares {known}"
            )
    return np.array([float(values[name]) for name in free])


def _declaration(name: str) -> str:
    """Return the tag that declares a parameter's error, as an example."""
    return f'<default name="{name}{RULER_ERROR}" value="0.005"/>'


def ruled_values(document: SceneDocument, names: Sequence[str]) -> Array:
    """Return the measured values of a scene's parameters, (P,), checked as by `start_values`.

    They are the given ones, else those from which the calibration that wrote the scene began,
    unless the scene has other values by now, else the scene's.
    """
    values = start_values(document, names)
    known = scene_covariance(document)
    if known is None:
        return values
    ruled = dict(zip(known.names, known.ruled, strict=True))
    changed = {*document.given, *known.changed(document)}
    pairs = zip(names, values, strict=True)
    return np.array([v if name in changed else ruled.get(name, v) for name, v in pairs])


def distant_parameters(document: SceneDocument) -> list[str]:
    """Return a scene's calibrated numbers that are more than `FARTHEST` from the measured ones."""
    known, errors = scene_covariance(document), declared_errors(document)
    columns = () if known is None else zip(known.names, known.values, known.ruled, strict=True)
    return [n for n, end, start in columns if abs(end - start) > FARTHEST * errors.get(n, np.inf)]


def declared_errors(document: SceneDocument) -> dict[str, float]:
    """Return the ruler's errors that a scene declares, or that are given instead, by name.

    A SceneError says that one is no number from 0 on, or of nothing that the scene declares.
    """
    path, errors = document.path, {}
    for name, text in document.values.items():
        if not name.endswith(RULER_ERROR):
            continue
        error = number_of(text)
        if name not in document.errors or (error and not SMALLEST <= error <= LARGEST):
            raise SceneError(
                f"scene '{path}': '{name}' is {text}; give a standard deviation from {SMALLEST:g} "
                f"to {LARGEST:g} of a declared '{name.removesuffix(RULER_ERROR)}', or 0"
            )
        errors[document.errors[name]] = error
    return errors


def free_parameters(
    document: SceneDocument, free: Free | None = None, held: Collection[str] = ()
) -> dict[str, float]:
    """Return the names of the free parameters, each with the error of its measured value.

    Errors that are not named are those that the scene declares. If `free` is None, all parameters
    of a declared error above 0 are free, except those in `held`.

    Raises
    ------
    SceneError
        If an error is neither named nor declared, or not positive and finite.
    """
    declared = declared_errors(document)
    if free is None:
        return {name: e for name, e in declared.items() if e > 0 and name not in held}
    errors: dict[str, float] = {}
    for name in listed(free):
        error = free[name] if isinstance(free, Mapping) else None
        if error is None and name not in declared:
            start_values(document, [name])
            raise SceneError(
                f"scene '{document.path}' declares no error of '{name}'; give the standard "
                f"deviation of its measured value: {name}=0.005, or in the scene "
                f"{_declaration(name)}"
            )
        errors[name] = declared[name] if error is None else float(error)
        check_error(name, errors[name])
    return errors


def check_error(name: str, error: float) -> None:
    """Raise a SceneError unless a parameter's standard error is positive and in range."""
    if not SMALLEST <= error <= LARGEST:
        raise SceneError(
            f"standard error {error:g} of '{name}': give one from {SMALLEST:g} to {LARGEST:g}"
        )
