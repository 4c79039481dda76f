"""What `periscopy calibrate` says of a calibration, to its user and in its JSON file."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.cli.output import say, warn
from periscopy_sim.numerics.percentages import percentages

if TYPE_CHECKING:
    from periscopy_sim.calibration.result import Calibration, Parameter

MOST = 0.3
"""Part of a parameter's standard error from which an uncertain parameter is named for it."""

TIED = 0.9
"""Correlation of two parameters' errors from which the photograph hardly tells them apart."""

PAIRS = 3
"""Of those that are tied the most, named."""

EVEN = 0.02
"""Part by which a gain over the wall differs from 1 where it is told."""

FAR = 2.0
"""Ruler's errors from where the ruler has it, from which a value is marked: of 20 that are right,
one is as far. Beyond `trust.FARTHEST` it is not believed."""

RARELY = 0.05
"""Of calibrations of right numbers: those that are told that too many are far off."""

LESS_SURE = 1.2
"""Times the ruler's error from which a value is less sure than before."""


def told(found: Calibration) -> dict[str, Any]:
    """Return a calibration as it is written to JSON."""
    held = found.uncertain
    return {
        "trusted": found.trusted,
        "doubts": found.doubts,
        "better_than_start": found.moved,
        "parameters": {
            p.name: {
                "start": p.start,
                "value": p.value,
                "statistical_error": p.statistical_error,
                "standard_error": p.standard_error,
                "ruler_error": _finite(p.ruler_error),
                "scale": _finite(p.scale),
                "half_width_searched": p.spread,
                "determined": p.determined,
            }
            for p in found.parameters
        },
        "uncertain": {
            name: {
                "value": value,
                "standard_error": error,
                "moves": dict(zip(found.values, moves, strict=True)),
            }
            for name, value, error, moves in zip(
                held.names, held.values, held.standard_errors, found.moves.T, strict=True
            )
        },
        "correlation": {
            p.name: dict(zip(found.values, row, strict=True))
            for p, row in zip(found.parameters, found.correlation, strict=True)
        },
        "unexplained_before": found.noise_before,
        "unexplained": found.noise,
        "discrepancy": found.discrepancy,
        "overdispersion": found.overdispersion,
        "gain": {"least": found.gain.min(), "largest": found.gain.max()},
        "path": [
            {
                "photograph_shape": visited.photograph_shape,
                "hidden_shape": visited.hidden_shape,
                "values": visited.values,
                "evidence": [e if np.isfinite(e) else None for e in visited.evidence.tolist()],
            }
            for visited in found.path
        ],
    }


def _finite(value: float) -> float | None:
    """Return a number as JSON has it, which knows no infinite ones."""
    return value if np.isfinite(value) else None


def say_found(found: Calibration, *, has_backgrounds: bool) -> None:
    """Print the parameters, and warn of those that neither photograph nor ruler knows."""
    from periscopy_sim.calibration.whitening import STRUCTURED

    width = max(len(p.name) for p in found.parameters)
    for k, p in enumerate(found.parameters):
        blame = _largest(found, k)
        alone = f" (± {p.statistical_error:.2g} alone" + (f"; most by {blame})" if blame else ")")
        ruler = f" ± {p.ruler_error:.2g} by the ruler" if np.isfinite(p.ruler_error) else ""
        far = abs(p.ruler_errors_off)
        mark = f"  <-- {far:.1f} of the ruler's errors off" if far > FAR else ""
        say(
            f"{p.name:{width}}  {p.value:10.4g} ± {p.standard_error:.2g}"
            f"{alone if found.uncertain.names else ''}, from {p.start:.4g}{ruler}: {_standing(p)}"
            f"{mark}"
        )
        if not p.determined and not ruler:
            warn(_open(found, k, blame))
    for remark in filter(None, (_tied(found), _far(found), _displaced(found))):
        say(remark)
    if found.uncertain.names:
        held = ", ".join(found.uncertain.names)
        say(f"held where they are, their errors in those above: {held}")
    else:
        say("these errors hold if all else in the scene is right; see --uncertain")
    before, after = percentages(*found.unexplained)
    size = "{}x{}".format(*found.residual.shape[:2])
    say(f"unexplained: {before} % of the photograph ({size}) at the start, {after} % now")
    if np.abs(found.gain - 1).max() > EVEN:
        say(
            f"a smooth gain over the wall was found beside these: {found.gain.min():.2f} to "
            f"{found.gain.max():.2f} times the monitor's light, as a lens, bounced light or the "
            "monitor's falloff with angle makes it"
        )
    if found.discrepancy > STRUCTURED:
        likely = "" if has_backgrounds else "perhaps uneven paint (--monitor-off); "
        say(
            "not all of that is noise: at some scale it is "
            f"{found.discrepancy:.0f} times as strong as noise, for which values and errors allow: "
            f"{likely}"
            "periscopy reconstruct with this scene maps it (residual.png)"
        )
    else:
        say(f"nothing in that is more than {found.discrepancy:.1f} times as strong as noise")
    if not found.moved and all(p.value == p.start for p in found.parameters):
        say("no other values explain it better than those at the start, which stay")
    elif not found.moved:
        say("that is no more than chance gains: the values at the start explain it as well")


def _tied(found: Calibration) -> str:
    """Return which pairs of parameters the photograph hardly tells apart; empty if it does all."""
    correlations = {
        f"{a.name} and {b.name}": float(found.correlation[j, k])
        for (j, a), (k, b) in combinations(enumerate(found.parameters), 2)
    }
    sizes = {pair: abs(each) for pair, each in correlations.items() if abs(each) >= TIED}
    if not sizes:
        return ""
    tied = sorted(sizes, key=lambda pair: -sizes[pair])[:PAIRS]
    told = ", ".join(f"{pair} ({correlations[pair]:.2f})" for pair in tied)
    return (
        f"can hardly be told apart (correlation of their errors): {told}; where one of a pair is "
        "measured better, both are better known"
    )


def _far(found: Calibration) -> str:
    """Return that more values left the ruler's than right ones would; empty where not."""
    from scipy.stats import binom, norm

    far = [p.name for p in found.parameters if abs(p.ruler_errors_off) > FAR]
    count = len(found.parameters)
    if len(far) < 2 or binom.sf(len(far) - 1, count, 2 * norm.sf(FAR)) > RARELY:
        return ""
    return (
        f"of {count} values {len(far)} are more than {FAR:g} of the ruler's errors off, where one "
        f"in 20 would be: measure {', '.join(far)} again"
    )


def _displaced(found: Calibration) -> str:
    """Return which values moved farther than the photograph tells; empty where none did."""
    less = [p.name for p in found.parameters if p.standard_error > LESS_SURE * p.ruler_error]
    if not less:
        return ""
    return (
        f"less sure than by the ruler: {', '.join(less)}; they moved farther than the photograph "
        "tells, as with a hidden image that is displaced by a patch or more, which looks much the "
        "same: measure them better where its place matters"
    )


def _standing(p: Parameter) -> str:
    """Return who knows a parameter."""
    if p.determined:
        return "by the photograph"
    if not p.trusted:
        return "not to be trusted"
    if p.standard_error > LESS_SURE * p.ruler_error:
        return "less sure than by the ruler"
    return "as the ruler said" if np.isfinite(p.ruler_error) else "not determined"


def _largest(found: Calibration, k: int) -> str:
    """Return the names of the uncertain parameters that an error owes most to, two at most."""
    moves = dict(zip(found.uncertain.names, np.abs(found.moves[k]), strict=True))
    first = sorted(moves, key=lambda name: -moves[name])[:2]
    least = MOST * found.parameters[k].standard_error
    return " and ".join(name for name in first if moves[name] > least)


def _open(found: Calibration, k: int, blame: str) -> str:
    """Return why a parameter is not determined."""
    p = found.parameters[k]
    if p.statistical_error < p.scale:
        return f"the photograph would determine {p.name} if {blame} were better known"
    others = np.abs(found.correlation[k])
    others[k] = 0
    tied = int(np.argmax(others))
    if others[tied] < TIED:
        return f"the photograph does not determine {p.name}; leave it out of --free"
    return (
        f"the photograph does not determine {p.name}: it is tied to {found.parameters[tied].name} "
        f"(correlation {found.correlation[k, tied]:.2f}); leave one of them out of --free"
    )
