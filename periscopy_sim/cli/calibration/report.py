"""A calibration as `periscopy calibrate` prints it, and as its JSON file has it."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.cli.output import say
from periscopy_sim.numerics.percentages import percentages

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration, Parameter

TIED = 0.9
"""Correlation of two parameters' errors from which the pair is named."""

PAIRS = 3
"""Most tied pairs that are named."""

EVEN = 0.02
"""Gain over the wall, less 1, from which it is named."""

FAR = 2.0
"""Standard deviations from its measured value from which a value is marked: one in 20 right ones
is as far."""


def as_record(result: Calibration) -> dict[str, Any]:
    """Return a calibration as its JSON file has it."""
    held = result.uncertain
    return {
        "trusted": result.trusted,
        "doubts": result.doubts,
        "better_than_start": result.moved,
        "parameters": {
            p.name: {
                "start": p.start,
                "value": p.value,
                "statistical_error": p.statistical_error,
                "standard_error": p.standard_error,
                "ruler_error": p.ruler_error,
                "determined": p.determined,
            }
            for p in result.parameters
        },
        "uncertain": {
            name: {
                "value": value,
                "standard_error": error,
                "moves": dict(zip(result.values, moves, strict=True)),
            }
            for name, value, error, moves in zip(
                held.names, held.values, held.standard_errors, result.moves.T, strict=True
            )
        },
        "correlation": {
            name: dict(zip(result.values, row, strict=True))
            for name, row in zip(result.values, result.correlation, strict=True)
        },
        "unexplained_before": result.noise_before,
        "unexplained": result.noise,
        "overdispersion": result.overdispersion,
        "gain": {"least": result.gain.min(), "largest": result.gain.max()},
        "colour_matrix": result.colour_matrix,
        "path": [
            {
                "photograph_shape": visited.photograph_shape,
                "hidden_shape": visited.hidden_shape,
                "values": visited.values,
                "evidence": visited.evidence,
            }
            for visited in result.path
        ],
    }


def say_calibration(result: Calibration) -> None:
    """Print what is unexplained, the parameters, and what hardly tells them apart."""
    before, after = percentages(*result.unexplained)
    verdict = "" if result.moved else "; the measured values explain as much, and stay"
    say(f"unexplained: {before} % of the photograph by the measured scene, {after} % now{verdict}")
    width = max(len(p.name) for p in result.parameters)
    for p in result.parameters:
        far = abs(p.ruler_errors_off)
        mark = f"  <-- {far:.1f} standard errors off" if far > FAR else ""
        say(
            f"{p.name:{width}}  {p.value:10.4g} ± {p.standard_error:.2g}"
            f"  measured {p.start:.4g} ± {p.ruler_error:.2g}  {_source(p)}{mark}"
        )
    if tied := _tied(result):
        say(f"hardly told apart (correlation of their errors): {tied}")
    if result.uncertain.names:
        say(f"errors count those of what stays: {', '.join(result.uncertain.names)}")
    if np.abs(result.gain - 1).max() > EVEN:
        say(f"smooth gain over the wall: {result.gain.min():.2f} to {result.gain.max():.2f}")
    if result.colour_matrix is not None:
        rows = "; ".join(" ".join(f"{m:.2f}" for m in row) for row in result.colour_matrix)
        say(f"colour matrix, from the monitor's to the camera's: {rows}")


def _source(p: Parameter) -> str:
    """Return whether the photograph or the ruler knows a parameter."""
    if not p.trusted:
        return "not to be trusted"
    return "by the photograph" if p.determined else "by the ruler"


def _tied(result: Calibration) -> str:
    """Return the pairs of parameters whose errors are correlated most, as a list."""
    names = list(result.values)
    pairs = [
        (
            abs(result.correlation[j, k]),
            f"{names[j]} and {names[k]} ({result.correlation[j, k]:.2f})",
        )
        for j, k in combinations(range(len(names)), 2)
    ]
    return ", ".join(text for size, text in sorted(pairs, reverse=True)[:PAIRS] if size >= TIED)
