"""Photographs of the wall with the monitor off: ambient light as it is, on the wall as it is.

    b_k = ρ (B e_k) + n_k

They need not be of the very light of the photograph, nor of its exposure. Each of their channels is
one more column of B, for every channel of a photograph, its strength c_k to be found: what the
ambient light has that no point lights have (edges of shadows, near lamps), and what paint does to
it, is projected out with the rest.

Their own noise comes along. What is left of a photograph has the variance σ² + Σ c_k² σ_k², so it
is counted wherever noise is found from what is left (as by every method here), and so are the
standard errors. As the c_k are those that leave least, a background photograph of much noise counts
for little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]
Backgrounds: TypeAlias = Sequence[Image] | Mapping[str, Image]
"""Photographs with the monitor off, (rows, columns, 3) or (M, 3) each; messages call them by their
names, or by number."""

FLAT = 1e-6
"""Of a photograph's largest value: what changes less over the wall is no photograph."""

SAME = 1e-10
"""1 less the cosine of two photographs' angle, below which they are one; noise of 80 dB makes
5e-9."""


def named(backgrounds: Backgrounds | None) -> dict[str, Image]:
    """Return background photographs by name."""
    if backgrounds is None:
        return {}
    if isinstance(backgrounds, Mapping):
        return dict(backgrounds)
    if np.ndim(backgrounds[0] if len(backgrounds) else 0) == 1:
        raise ValueError("backgrounds are a sequence of photographs, (rows, columns, 3) each")
    count = len(backgrounds)
    return {f"background photograph {k} of {count}": b for k, b in enumerate(backgrounds, 1)}


def check_background(planes: Array, name: str) -> None:
    """Refuse what is no photograph of a lit wall: (3, M') without light or without any change."""
    if not planes.max(initial=0) > 0:
        raise ValueError(f"{name}: no value is positive where the wall is used")
    if not np.ptp(planes, axis=1).max() > FLAT * planes.max():
        raise ValueError(f"{name}: is the same everywhere; a photograph of a wall never is")


def check_distinct(planes: Array, columns: Image, names: Sequence[str]) -> None:
    """Refuse photographs, (K, 3, M'), one of which is a background, (M', 3 L), but for exposure."""
    rows = planes.reshape(-1, planes.shape[-1])
    sizes = np.linalg.norm(rows, axis=1)[:, None] * np.linalg.norm(columns, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosines = np.abs(rows @ columns) / sizes
    same = (cosines.reshape(len(planes), 3, len(names), 3) > 1 - SAME).diagonal(axis1=1, axis2=3)
    if same.all(axis=-1).any():
        name = names[int(np.argmax(same.all(axis=-1).any(axis=0)))]
        raise ValueError(
            f"{name}: is the photograph itself; give one of the same wall with the monitor off"
        )
