"""A calibration as `periscopy calibrate` prints it, and results as its JSON files have them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from periscopy_sim.cli.output import say

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration
    from periscopy_sim.calibration.silhouette.result import Silhouette


def calibration_record(result: Calibration) -> dict[str, Any]:
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
        "path": [vars(visited) for visited in result.path],
    }


def silhouette_record(solution: Silhouette) -> dict[str, Any]:
    """Return a silhouette as its JSON file has it."""
    plane = solution.plane
    return {
        "shape": solution.name,
        "trusted": not solution.doubts,
        "doubts": solution.doubts,
        "rectangle": {"corner": plane.corner, "across": plane.across, "down": plane.down},
        "opaque": ["".join("#" if cell else "." for cell in row) for row in solution.opaque],
        "opacities": solution.opacities,
        "cells_seen": int(solution.seen.sum()),
        "cells_decided": solution.decided,
        "unexplained_open": solution.unexplained_open,
        "unexplained": solution.unexplained,
        "starts": solution.starts,
        "starts_agreeing": solution.agreeing,
        "evidence": solution.evidence,
    }


def say_calibration(result: Calibration, units: Mapping[str, str]) -> None:
    """Print what is unexplained, the parameters, the gain and the colour matrix.

    `units` are those of the parameters that have one.
    """
    from periscopy_sim.model.residual import percentages

    before, after = percentages(*result.unexplained)
    verdict = "" if result.moved else "; the measured values explain as much, and stay"
    say(f"unexplained in calibration: {before} % by the measured scene, {after} % now{verdict}")
    if result.overdispersion > 1:
        say(
            f"the photograph counts 1/{result.overdispersion:g} of what its noise allows: it shows "
            "something that the scene lacks"
        )
    width = max(len(p.name) for p in result.parameters)
    for p in result.parameters:
        source = "by the photograph" if p.determined else "by the ruler"
        unit = units.get(p.name, "")
        say(
            f"{p.name:{width}}  {_rounded(p.value, p.standard_error)} {unit}  measured "
            f"{_rounded(p.start, p.ruler_error)}  {source if p.trusted else 'not to be trusted'}"
        )
    if result.uncertain.names:
        say(f"errors count those of what stays: {', '.join(result.uncertain.names)}")
    say(f"smooth gain over the wall: {result.gain.min():.2f} to {result.gain.max():.2f}")
    if result.colour_matrix is not None:
        rows = "; ".join(" ".join(f"{m:.2f}" for m in row) for row in result.colour_matrix)
        say(f"colour matrix, from the monitor's to the camera's: {rows}")


def _rounded(value: float, error: float) -> str:
    """Return a value and its standard error, which has two digits."""
    digits = max(0, 1 - int(f"{error:e}".partition("e")[2]))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def say_silhouette(solution: Silhouette) -> None:
    """Print what the mask looks like and how far it is to be believed."""
    from periscopy_sim.model.residual import percentages

    for row in solution.opaque:
        say("  " + "".join("##" if cell else " ." for cell in row))
    say(
        f"of {solution.opaque.size} cells the photograph shows the shadows of {solution.seen.sum()}"
    )
    without, with_it = percentages(solution.unexplained_open, solution.unexplained)
    say(f"unexplained: {without} % of the photograph without it, {with_it} % with it")
    if solution.starts:
        say("silhouette and image may both be shifted, against each other")
