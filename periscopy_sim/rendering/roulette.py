"""Russian roulette: where a path of little weight ends, without a bias."""

from __future__ import annotations

from typing import Any

ROULETTE = 5
"""Surfaces after which paths may end."""

SURVIVAL = 0.95
"""Largest chance to go on from there."""


def survivors(surface: Any, throughput: Any, number: Any, active: Any) -> tuple[Any, Any]:
    """Return the throughput of those that go on, and which they are, in Dr.Jit arrays.

    `surface` is how many a path has met, the number is uniform in (0, 1).
    """
    import drjit as dr

    strongest = dr.max(throughput)
    chance = dr.select(surface >= ROULETTE, dr.minimum(strongest, SURVIVAL), 1)
    active &= (strongest > 0) & (number < chance)
    return throughput * dr.rcp(dr.select(active, chance, 1)), active
