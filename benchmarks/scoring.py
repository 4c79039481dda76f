"""What a recovered image is worth, and how sure a suite's mean is.

Every metric uses the truth: each channel is multiplied by the one factor that fits the truth best,
and clipped to [0, 1], before anything is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import periscopy_sim as ps
from periscopy_sim.methods import promised

DRAWS = 2000
LEVEL = 0.95

METRICS = ("psnr", "registered", "ssim")
"""PSNR in dB, PSNR after the best shift of at most two patches in dB, and SSIM."""


def scores(image: Any, truth: NDArray[np.floating[Any]]) -> dict[str, float]:
    """Return the metrics of a recovered image, (R, C, 3), by name.

    SSIM is scikit-image's, of linear light with a range of 1, over windows of 7 x 7 patches, the
    mean of the channels.

    Raises
    ------
    ValueError
        If the image is no finite (R, C, 3) array of real numbers; the message says what it is.
    """
    from skimage.metrics import structural_similarity

    estimate = promised(image, (truth.shape[0], truth.shape[1]))
    matched = ps.gain_matched(estimate, truth)
    similarity = structural_similarity(matched, truth, data_range=1.0, channel_axis=2)
    return {
        "psnr": ps.psnr_gain_matched(estimate, truth),
        "registered": ps.registered(estimate, truth).psnr,
        "ssim": float(similarity),
    }


def interval(
    values: ArrayLike, geometries: Sequence[int], seed: int = 0
) -> tuple[float, float, float]:
    """Return the mean of a suite's cells and its 95 % confidence interval, (mean, low, high).

    A bootstrap in two stages: geometries are drawn with replacement, then cells within each, for
    cells of one geometry share its luck. Of few geometries such an interval is too narrow.

    Parameters
    ----------
    values
        (K,) of the cells.
    geometries
        (K,) number of each cell's geometry.
    seed
        Of the draws.

    Raises
    ------
    ValueError
        If there is no cell, or values and geometries differ in number.
    """
    values, groups = np.asarray(values, np.float64), np.asarray(geometries)
    if values.size == 0 or values.shape != groups.shape:
        raise ValueError(f"{values.shape} values of {groups.shape} geometries; give one each")
    rng = np.random.default_rng(seed)
    cells = [values[groups == group] for group in np.unique(groups)]
    totals, counts = np.zeros(DRAWS), np.zeros(DRAWS)
    for _ in cells:  # as many geometries a draw as there are
        chosen = rng.integers(len(cells), size=DRAWS)
        for number, group in enumerate(cells):
            drawn = chosen == number
            picks = rng.integers(group.size, size=(np.count_nonzero(drawn), group.size))
            totals[drawn] += group[picks].sum(axis=1)
            counts[drawn] += group.size
    means = totals / counts
    low, high = np.quantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(values.mean()), float(low), float(high)
