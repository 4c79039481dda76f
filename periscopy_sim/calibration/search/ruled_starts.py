"""Where to begin where a ruler knows all parameters: at its word, or elsewhere within its errors.

A scene that is wrong by all errors of a ruler at once leaves much that no small move explains: it
passes for what the model lacks, the photograph counts for little, and a descent ends where it
began. Other places that the ruler allows lie nearer to the best. At a low resolution they are cheap
to look at, and slopes reach farther.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values, Visit
from periscopy_sim.calibration.parameters import BOX
from periscopy_sim.calibration.search.levenberg_marquardt import descend
from periscopy_sim.errors import SceneError

PLACES, MOST_PLACES = 8, 32
"""Looked at for each parameter, and at most."""

DRAWN = 256
"""Places drawn at most: those that are not physical are passed over."""

DESCENTS = 3
"""One from the ruler's word, the others from the best places."""

DESCENT_ITERATIONS = 4
"""Of each, at most."""


def places_looked_at(parameters: int) -> int:
    """Return how many places are looked at before the descents."""
    return min(PLACES * parameters, MOST_PLACES)


def ends_from_ruler(
    level: ResolutionLevel, start: Values, steps: Values, visit: Visit, attempt: int = 0
) -> list[Values]:
    """Return where descents end, (P,) each, from the start and from places that the ruler allows.

    The places are drawn from the ruler's errors about the start (Sobol's sequence); descents, as
    in `descend`, follow on those with the best evidence. All that is visited is passed to `visit`.
    What is not physical is left out, the start alone raises a SceneError. A later attempt draws
    others, and leaves out the start.
    """
    places = _drawn(level, start, visit, attempt)
    ends = []
    if attempt == 0:
        _, end = descend(level, start, steps, 5 * steps, DESCENT_ITERATIONS, visit)
        ends.append(end.values)
    for place in places[: DESCENTS - len(ends)]:
        with suppress(SceneError):
            _, end = descend(level, place, steps, 5 * steps, DESCENT_ITERATIONS, visit)
            ends.append(end.values)
    return ends


def _drawn(level: ResolutionLevel, start: Values, visit: Visit, attempt: int) -> list[Values]:
    """Return places within the ruler's errors, those of the best evidence first."""
    from scipy.stats import norm, qmc

    count = places_looked_at(len(start))
    even = qmc.Sobol(len(start), rng=np.random.default_rng(level.seed + attempt)).random(DRAWN)
    places = start + level.prior.errors * np.clip(norm.ppf(even), -BOX, BOX)
    looked: list[tuple[float, int]] = []
    for k, place in enumerate(places):
        if len(looked) == count:
            break
        with suppress(SceneError):
            evidence = level.judged(place).evidence
            visit(place, evidence)
            looked.append((evidence, k))
    return [places[k] for _, k in sorted(looked)]
