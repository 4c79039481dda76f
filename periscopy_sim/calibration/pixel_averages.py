"""Light averaged over pixels, from light that is known at single points of the wall."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from periscopy_sim.hidden import Size
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.storage.pictures import MAJORITY, coverage


def footprints(pixels: Mask, across: int = 1, paint: Array | None = None) -> Any:
    """Return averages over M pixels of light in their middles, (M, M), sparse.

    The wall's `paint`, (M, 1), is in the light, and does not count where light is compared.

    The mean over a square of side h exceeds the light in its middle by h²/24 (∂²/∂x² + ∂²/∂y²), up
    to the fourth order; neighbours a pixel apart give these derivatives. For means
    of n x n points, n = `across`, the correction is n² times smaller.
    """
    index = np.full(pixels.shape, -1)
    index[pixels] = np.arange(np.count_nonzero(pixels))
    curvature = sparse.csr_array((index.max() + 1,) * 2, dtype=np.float32)
    for lines in (index, index.T):
        triples = np.stack([lines[:-2], lines[1:-1], lines[2:]])
        before, middle, after = triples[:, (triples >= 0).all(axis=0)]
        for other, weight in ((before, 1), (middle, -2), (after, 1)):
            weights = np.full(len(middle), weight / 24 / across**2, np.float32)
            curvature += sparse.csr_array((weights, (middle, other)), shape=curvature.shape)
    if paint is not None and len(paint) > 1:
        over, under = (sparse.diags_array(each[:, 0]) for each in (paint, 1 / paint))
        curvature = over @ curvature @ under
    return sparse.csr_array(curvature + sparse.eye_array(*curvature.shape), dtype=np.float32)


def averages(pixels: Mask, shape: Size, across: int = 1, paint: Array | None = None) -> Any:
    """Return averages over larger pixels of light in the middles of F pixels, (M, F), sparse.

    They are those of `averaged_photograph`, of which the mask leaves M: so a photograph and A are
    averaged alike, also where borders of the pixels, or of the mask, do not meet.
    """
    rows, columns = (coverage(*sizes) for sizes in zip(shape, pixels.shape, strict=True))
    parts = sparse.kron(sparse.csr_array(rows), sparse.csr_array(columns), format="csr")
    parts = parts[:, np.flatnonzero(pixels)]
    whole = parts.sum(axis=1)
    inside = np.flatnonzero(whole > MAJORITY)
    means = sparse.diags_array(1 / whole[inside]) @ parts[inside]
    return sparse.csr_array(means.astype(np.float32) @ footprints(pixels, across, paint))
