"""How well a calibration knows the parameters of the scene that it wrote, carried in that scene.

The scene declares a ``<default>`` that nothing refers to and Mitsuba ignores. It lists the
parameters, their measured values, their standard errors, and the correlations of each with those
before it and itself:

    <default name="calibrated_covariance"
             value="trusted; dx = 0.0012 from 0 +- 0.0004: 1; turn = -0.8 from -1 +- 0.5: 0.31 1"/>

A silhouette that is not trusted writes the first word alone. The errors of the measured values stay
in the scene: a second calibration starts from the measured values again, not from what the same
photograph has contributed already.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from periscopy_sim.errors import SceneError
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.limits import number_of
from periscopy_sim.scene import CALIBRATED, SceneDocument

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
