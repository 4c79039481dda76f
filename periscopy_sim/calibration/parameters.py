"""How far the photograph feels each of the parameters of a scene that are free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values
from periscopy_sim.errors import SceneError

STEP, SPREAD = 0.05, 0.4
"""Relative changes of the transport matrix: by the step of a difference, and over the half width of
the box that is searched, where shadows have moved by about their own size."""

DOUBLINGS = 40
"""From a millionth of a unit: beyond, a parameter is not seen."""

HALVINGS = 4
"""Of the box that is searched, where a ruler knows a parameter, to the first move that is tried."""

BOX = 3.0
"""Ruler's errors beyond which nothing is searched."""

GROWTH = 1.2
"""Of the change, by doubling, below which it grows no more: a turn comes round again."""


def scales_and_spreads(level: ResolutionLevel, start: Values) -> tuple[Values, Values]:
    """Return how far each parameter must move from its start to change A by `STEP` and by `SPREAD`.

    All are (P,). Where a ruler knows a parameter, its spread is at most `BOX` of the ruler's
    errors, and its scale follows from what it changes there, infinite if nothing. A SceneError is
    raised if the start is not physical, or where no ruler knows a parameter that changes nothing
    that the photograph shows.
    """
    A = level.matrix(start)
    scales, spreads = np.empty(len(start)), np.empty(len(start))
    for k, name in enumerate(level.names):
        farthest = BOX * level.prior.errors[k]
        offset = np.zeros(len(start))
        reached, spread = 0.0, np.nan
        scale = np.nan
        smallest = 1e-6 if np.isinf(farthest) else farthest / 2**HALVINGS
        for doubling in range(DOUBLINGS):
            offset[k] = min(smallest * 2.0**doubling, farthest)
            change = _change(level, A, start, offset)
            if change is None or (reached >= STEP and change < GROWTH * reached):
                break
            reached, spread = change, offset[k]
            if np.isnan(scale) and change >= STEP:
                scale = offset[k] if doubling else offset[k] * STEP / change
            if change >= SPREAD or offset[k] == farthest:
                break
        if np.isfinite(farthest):
            # The ruler speaks where the photograph does not.
            spread = farthest if np.isnan(spread) else spread
            scale = (spread * STEP / reached if reached else np.inf) if np.isnan(scale) else scale
        elif np.isnan(spread):
            raise SceneError(
                f"scene '{level.path}': '{name}' cannot be moved from {start[k]:g}, where no value "
                "beside it makes a scene; hold it, or start it elsewhere"
            )
        elif reached == 0:
            raise SceneError(
                f"scene '{level.path}': the photograph cannot see '{name}', however it is moved "
                f"from {start[k]:g}; start it elsewhere, or hold it"
            )
        elif np.isnan(scale):
            raise SceneError(
                f"scene '{level.path}': the photograph cannot see '{name}': moved by up to "
                f"{spread:.3g}, it changes the light transport by {100 * reached:.2g} %; hold it"
            )
        scales[k], spreads[k] = scale, spread
    return scales, spreads


def _change(
    level: ResolutionLevel, A: NDArray[np.float32], start: Values, offset: Values
) -> float | None:
    """Return the relative change of A, to either side; None where neither is physical."""
    for sign in (1, -1):
        try:
            return float(np.linalg.norm(level.matrix(start + sign * offset) - A)) / float(
                np.linalg.norm(A)
            )
        except SceneError:
            continue
    return None
