"""How well a calibration knows the parameters of the scene that it wrote, carried in that scene.

A ``<default>`` that nothing refers to, and Mitsuba passes over, tells the parameters, their
where the ruler has them, standard errors and the correlations of these, each with itself and those
before it:

    <default name="calibrated_covariance"
             value="trusted; dx = 0.0012 from 0 +- 0.0004: 1; turn = -0.8 from -1 +- 0.5: 0.31 1"/>

Of a silhouette that is not to be trusted there is the first word alone.
The ruler's errors stay where they are: a second calibration starts from the ruler's word again, not
from what the same photograph has said already.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.prior import start_values
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.document import CALIBRATED, read_document
from periscopy_sim.scenario import Scenario

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration

Array = NDArray[np.float64]

MARKS = {True: "trusted", False: "not trusted"}
"""What the text begins with, by whether the calibration is to be believed."""

SAME = 1e-6
"""Of a parameter's standard error, or of its size: what is nearer is the value as written."""

_ENTRY = re.compile(r"\s*(\S+)\s*=\s*(\S+)\s*(?:from\s+(\S+)\s*)?\+-\s*(\S+)\s*:\s*(.*)")


@dataclass(frozen=True, eq=False)
class SceneCovariance:
    """Parameters of a scene, (P,), as a calibration left them, and their covariance, (P, P).

    `ruled` is where the ruler has them: where the calibration began.
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    trusted: bool
    ruled: Array

    @classmethod
    def of(cls, found: Calibration) -> SceneCovariance:
        """Return that of a calibration, what it held at uncertain values among the parameters."""
        held = found.uncertain
        errors = np.array([p.standard_error for p in found.parameters])
        joint = np.diag(np.concatenate([errors, held.standard_errors]) ** 2)
        count = len(errors)
        joint[:count, :count] = found.correlation * np.outer(errors, errors)
        joint[:count, count:] = found.moves * held.standard_errors
        joint[count:, :count] = joint[:count, count:].T
        return cls(
            (*found.values, *held.names),
            np.array([*found.values.values(), *held.values]),
            joint,
            found.trusted,
            np.array([*(p.start for p in found.parameters), *held.values]),
        )

    @property
    def directions(self) -> Array:
        """(P, K) L, L Lᵀ the covariance: its principal axes, each parameter over its error.

        Rounding may leave it with axes of no or a negative variance; these are left out.
        """
        errors = np.sqrt(np.diag(self.covariance))
        variances, axes = np.linalg.eigh(self.covariance / np.outer(errors, errors))
        kept = variances > SAME
        return np.asarray(errors[:, None] * axes[:, kept] * np.sqrt(variances[kept]))

    def changed(self, path: Path, given: Mapping[str, str]) -> list[str]:
        """Return which parameters are not, or are not given, as they were calibrated."""
        defaults = read_document(path).defaults
        errors = np.sqrt(np.diag(self.covariance))
        return [
            name
            for name, value, error in zip(self.names, self.values, errors, strict=True)
            if not _is(given.get(name, defaults.get(name, "")), value, SAME * (abs(value) + error))
        ]

    def text(self) -> str:
        """Return it as the scene carries it; see the module."""
        errors = np.sqrt(np.diag(self.covariance))
        correlation = np.clip(self.covariance / np.outer(errors, errors), -1, 1)
        entries = [MARKS[self.trusted]]
        for k, name in enumerate(self.names):
            row = " ".join(f"{each:.6g}" for each in correlation[k, :k])
            where = f"{self.values[k]:.9g} from {self.ruled[k]:.9g}"
            entries.append(f"{name} = {where} +- {errors[k]:.6g}: {row} 1")
        return "; ".join(re.sub(" +", " ", entry) for entry in entries)


def scene_covariance(path: Path) -> SceneCovariance | None:
    """Return the covariance that a scene file carries; None if it carries none.

    A SceneError says that it cannot be read.
    """
    text = read_document(path).defaults.get(CALIBRATED)
    if text is None:
        return None
    mark, *entries = text.split(";")
    try:
        trusted = {words: known for known, words in MARKS.items()}[mark.strip()]
        matches = [_ENTRY.fullmatch(entry) for entry in entries]
        parts = [match.groups() for match in matches if match is not None]
        rows = [np.array(row.split(), np.float64) for *_, row in parts]
        told = [(value, error, ruled or value) for _, value, ruled, error, _ in parts]
        numbers = np.array(told, np.float64).reshape(-1, 3)
        sizes = [len(row) for row in rows]
        right = len(parts) == len(entries) and sizes == list(range(1, len(rows) + 1))
        right = right and (len(parts) > 0 or not trusted)
        if not (right and np.isfinite(numbers).all() and (numbers[:, 1] > 0).all()):
            raise ValueError
        lower = np.array([np.pad(row, (0, len(rows) - len(row))) for row in rows])
        lower = lower.reshape(len(rows), len(rows))
        if not (np.abs(lower) <= 1).all() or (np.diag(lower) != 1).any():
            raise ValueError
    except (KeyError, ValueError):
        raise SceneError(
            f"scene '{path}': its <default> '{CALIBRATED}' is damaged; leave that line out, or "
            "calibrate again"
        ) from None
    correlation = lower + np.tril(lower, -1).T
    covariance = correlation * np.outer(numbers[:, 1], numbers[:, 1])
    names = tuple(name for name, *_ in parts)
    return SceneCovariance(names, numbers[:, 0], covariance, trusted, numbers[:, 2])


def ruled_values(path: Path, names: Sequence[str], given: Mapping[str, str]) -> Array:
    """Return where the ruler has some parameters of a scene, (P,), as `start_values` refuses them.

    That is as given, else where the calibration began that left them as they are, or as they are.
    """
    values = start_values(path, names, given)
    known = scene_covariance(path)
    if known is not None:
        left = set(known.names) - {*given, *known.changed(path, {})}
        ruled = dict(zip(known.names, known.ruled, strict=True))
        values = np.array(
            [ruled[n] if n in left else v for n, v in zip(names, values, strict=True)]
        )
    return values


def is_calibrated(scenario: Scenario) -> bool:
    """Return whether a scene carries a calibration that can be read, and has the values found."""
    try:
        known = scene_covariance(scenario.path)
    except SceneError:
        return False
    return (
        known is not None
        and len(known.names) > 0
        and not known.changed(scenario.path, scenario.parameters)
    )


def _is(text: str, value: float, tolerance: float) -> bool:
    """Return whether a text is a number near a value."""
    try:
        return abs(float(text) - value) <= tolerance
    except ValueError:
        return False
