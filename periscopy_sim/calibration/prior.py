"""What is known before the photograph: of a scene's parameters, and of how a camera mixes colours.

The scene declares a ``<default>`` that nothing refers to and Mitsuba ignores. It lists the
parameters, their measured values, their standard errors, and the correlations of each with those
before it and itself:

    <default name="calibrated_covariance"
             value="trusted; dx = 0.0012 from 0 +- 0.0004: 1; turn = -0.8 from -1 +- 0.5: 0.31 1"/>

A silhouette that is not trusted writes the first word alone. The errors of the measured values stay
in the scene: a second calibration starts from the measured values again, not from what the same
photograph has contributed already.

Raw converters publish each camera's matrix from XYZ to its channels. That matrix times an sRGB
monitor's from primaries to XYZ is the colour matrix, its rows of sum 1, as exposures are free. The
numbers are of 406 different matrices of 550 cameras in dcraw's table `adobe_coeff` (Coffin, dcraw
9.28, 2018). Half of all photographs may have the monitor's colours already, but for deviations like
cameras'. The normal prior of a row has the mean and the covariance of this mixture.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.validation import LARGEST, SMALLEST, listed, number_of
from periscopy_sim.scene import CALIBRATED, RULER_ERROR, SceneDocument
from periscopy_sim.view import Geometry

SAME = 1e-6
"""Fraction of a parameter's standard error, or of its size, within which a value is as written."""

_ENTRY = re.compile(r"\s*(\S+) = (\S+) from (\S+) \+- (\S+): (.*)")


@dataclass(frozen=True, eq=False)
class SceneCovariance:
    """Calibrated parameters of a scene, (P,), their covariance, (P, P), and measured values, (P,).

    A calibration's uncertain parameters count among them.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    trusted: bool
    ruled: Array

    @classmethod
    def none(cls) -> Self:
        """Return that of a trusted scene without calibrated parameters."""
        return cls((), np.empty(0), np.empty((0, 0)), True, np.empty(0))

    def joined(self, name: str, value: float, error: float, ruled: float) -> Self:
        """Return this with another parameter, whose error is independent of the others."""
        covariance = np.pad(self.covariance, (0, 1))
        covariance[-1, -1] = error**2
        values, ruled_values = np.append(self.values, value), np.append(self.ruled, ruled)
        return replace(
            self,
            names=(*self.names, name),
            values=values,
            covariance=covariance,
            ruled=ruled_values,
        )

    @property
    def errors(self) -> Array:
        """(P,) standard errors."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlation(self) -> Array:
        """(P, P) of the errors."""
        return np.clip(self.covariance / np.outer(self.errors, self.errors), -1, 1)

    @property
    def directions(self) -> Array:
        """(P, K) L, L Lᵀ the covariance: its principal axes, each parameter over its error.

        Axes whose variance is only rounding are left out.
        """
        variances, axes = np.linalg.eigh(self.correlation)
        kept = variances > SAME
        return np.asarray(self.errors[:, None] * axes[:, kept] * np.sqrt(variances[kept]))

    def changed(self, document: SceneDocument) -> list[str]:
        """Return the parameters of a scene that are not as calibrated."""
        texts = document.values
        tolerances = SAME * (np.abs(self.values) + self.errors)
        return [
            name
            for name, value, tolerance in zip(self.names, self.values, tolerances, strict=True)
            if not abs(number_of(texts.get(name, "")) - value) <= tolerance
        ]

    def text(self) -> str:
        """Return the text that the scene carries; see the module."""
        columns = zip(self.names, self.values, self.ruled, self.errors, strict=True)
        entries = [
            f"{name} = {value:.9g} from {start:.9g} +- {error:.6g}: "
            + " ".join(f"{each:.6g}" for each in self.correlation[k, : k + 1])
            for k, (name, value, start, error) in enumerate(columns)
        ]
        return "; ".join(["trusted" if self.trusted else "not trusted", *entries])

    @classmethod
    def parse(cls, text: str) -> SceneCovariance:
        """Return what a text holds; a ValueError says that it is damaged."""
        mark, *entries = text.split(";")
        rows = [match.groups() for match in map(_ENTRY.fullmatch, entries) if match is not None]
        numbers = np.array([row[1:4] for row in rows], np.float64).reshape(-1, 3)
        values, ruled, errors = numbers.T
        correlation = np.eye(len(rows))
        for k, row in enumerate(rows):
            correlation[k, : k + 1] = np.array(row[4].split(), np.float64).reshape(k + 1)
            correlation[: k + 1, k] = correlation[k, : k + 1]
        if not (
            mark.strip() in (["trusted", "not trusted"] if rows else ["not trusted"])
            and len(rows) == len(entries)
            and np.isfinite(numbers).all()
            and (errors > 0).all()
            and (np.abs(correlation) <= 1).all()
            and (np.diag(correlation) == 1).all()
        ):
            raise ValueError
        covariance = correlation * np.outer(errors, errors)
        names = tuple(row[0] for row in rows)
        return cls(names, values, covariance, mark.strip() == "trusted", ruled)


def scene_covariance(document: SceneDocument) -> SceneCovariance | None:
    """Return the covariance that a scene carries; None if it carries none.

    A SceneError says that it is damaged.
    """
    text = document.defaults.get(CALIBRATED)
    if text is None:
        return None
    try:
        return SceneCovariance.parse(text)
    except ValueError:
        raise SceneError(
            f"scene '{document.path}': its <default> '{CALIBRATED}' is damaged; delete that line, "
            "or calibrate again"
        ) from None


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


CAMERAS = np.array([[0.640, 0.242, 0.118], [0.069, 0.736, 0.195], [0.019, 0.230, 0.751]])
"""(3, 3) mean colour matrix, from red, green and blue to the camera's."""

COVARIANCES = 1e-4 * np.array(
    [
        [[61, -64, 3], [-64, 88, -24], [3, -24, 21]],
        [[34, -26, -8], [-26, 41, -15], [-8, -15, 23]],
        [[24, 7, -31], [7, 27, -34], [-31, -34, 65]],
    ]
)
"""(3, 3, 3) of each of its rows."""


_HALVES = (np.eye(3) - CAMERAS) / 2
MEANS, VARIANCES = CAMERAS + _HALVES, COVARIANCES + np.einsum("ci,cj->cij", _HALVES, _HALVES)
"""(3, 3) and (3, 3, 3) mean and covariance of each row of the prior."""


def row_priors(channels: int, primaries: int) -> Sequence[tuple[Array, Array] | None]:
    """Return mean, (3,), and covariance, (3, 3), of each row of a colour matrix over its sum.

    They are None for other than three channels and primaries, of which no prior is known.
    """
    known = zip(MEANS, VARIANCES, strict=True)
    return list(known) if (channels, primaries) == MEANS.shape else [None] * channels
