"""The scene that a photograph was explained with, where its parameters are known to some error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.uncertain_scene.displacement import Displacement
from periscopy_sim.reconstruction.uncertain_scene.uncertain_transport import UncertainTransport

Array = NDArray[np.float64]

MOVED = 1.0
"""Of the errors that are left, from which a parameter is told to have moved."""

NAMED = 3
"""Parameters named, at most, the farthest moved first."""

TEMPERED = 10.0
"""Overdispersion from which what is left is told to be more than the uncertain parameters make."""


@dataclass(frozen=True, eq=False)
class FoundScene:
    """A scene of uncertain parameters, as one photograph found it.

    Attributes
    ----------
    uncertain
        What was known before.
    displacement
        What the photograph told.
    fitted
        The method, fitted to the scene there.
    """

    uncertain: UncertainTransport
    displacement: Displacement
    fitted: Any

    @property
    def values(self) -> Array:
        """(P,) of the parameters."""
        return self.uncertain.at(self.displacement.moved)

    @property
    def covariance(self) -> Array:
        """(P, P) of the parameters, the photograph counted in."""
        L = self.uncertain.directions
        return np.asarray(L @ self.displacement.covariance @ L.T)

    @property
    def standard_errors(self) -> Array:
        """(P,) of the parameters, the photograph counted in."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def told(self) -> dict[str, Any]:
        """Return the parameters before and after, for a summary."""
        held = self.uncertain.held
        rows = zip(
            self.uncertain.names,
            self.uncertain.values.tolist(),
            self.uncertain.standard_errors.tolist(),
            self.values.tolist(),
            self.standard_errors.tolist(),
            strict=True,
        )
        return {
            "held": held,
            "photograph_counts_for": 0.0 if held else 1 / self.displacement.overdispersion,
            "parameters": {
                name: {
                    "value": value,
                    "standard_error": error,
                    "value_found": found,
                    "standard_error_found": left,
                }
                for name, value, error, found, left in rows
            },
        }

    @property
    def remark(self) -> str:
        """Return what moved, for a user; empty where the parameters are held."""
        if self.uncertain.held:
            return ""
        moves = self.values - self.uncertain.values
        sizes = np.abs(moves) / self.standard_errors
        told = [
            f"{self.uncertain.names[k]} moved by {moves[k]:.2g} ± {self.standard_errors[k]:.1g}"
            for k in np.argsort(-sizes)
            if sizes[k] > MOVED
        ]
        if not told:
            moved = (
                "the photograph moves no uncertain parameter by more than its error; the standard "
                "errors count what theirs do to the image"
            )
        else:
            more = f" and {len(told) - NAMED} more" if len(told) > NAMED else ""
            moved = (
                f"the scene fits better with {', '.join(told[:NAMED])}{more}: the image is of that "
                "scene, and its standard errors count what is left of theirs"
            )
        κ = self.displacement.overdispersion
        if κ < TEMPERED:
            return moved
        return (
            f"{moved}; what is left has {κ:.0f} times the energy of noise where it is strongest, "
            "so the photograph counted for 1 over that: more of the scene is wrong, or by more, "
            "and the image's standard errors do not count that"
        )
