"""Homographies: how one plane is seen in another."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def project(homography: NDArray[np.floating[Any]], points: Array) -> Array:
    """Return (n, 2) points of a plane where a (3, 3) homography sends them."""
    image = points @ homography[:, :2].T + homography[:, 2]
    projected: Array = image[:, :2] / image[:, 2:]
    return projected


def depths(homography: Array, points: Array) -> Array:
    """Return (n,) third homogeneous coordinates of images; their sign changes at the horizon."""
    ahead: Array = points @ homography[2, :2] + homography[2, 2]
    return ahead


def fit_homography(source: Array, target: Array) -> Array:
    """Return the (3, 3) homography that sends (n, 2) source points to target points, n >= 4.

    This is the normalized direct linear transform (Hartley and Zisserman, *Multiple View Geometry*,
    2nd edition, algorithm 4.2). It is exact for exact points, and the start of a refinement for
    others. It has length 1, and is positive at the source's centroid.
    """
    (before, x), (after, y) = _normalized(source), _normalized(target)
    rows = np.zeros((2 * len(x), 9))
    rows[0::2, 0:3] = rows[1::2, 3:6] = np.column_stack([x, np.ones(len(x))])
    rows[0::2, 6:9] = -y[:, :1] * rows[0::2, 0:3]
    rows[1::2, 6:9] = -y[:, 1:] * rows[1::2, 3:6]
    normalized = np.linalg.svd(np.linalg.qr(rows, mode="r"))[2][-1].reshape(3, 3)
    homography = np.linalg.solve(after, normalized @ before)
    homography *= np.sign(depths(homography, source.mean(axis=0)[np.newaxis])[0]) or 1
    return np.asarray(homography / np.linalg.norm(homography))


def are_on_a_line(points: Array, tolerance: float) -> bool:
    """Return whether (n, 2) points lie on a line, or in one point.

    So they do if their root mean square distance from the line that fits them best is at most
    `tolerance` times their spread along it.
    """
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(len(spread) < 2 or spread[1] <= tolerance * spread[0])


def _normalized(points: Array) -> tuple[Array, Array]:
    """Return the similarity that centres points and makes their mean distance sqrt(2), and them."""
    center = points.mean(axis=0)
    distance = np.linalg.norm(points - center, axis=1).mean()
    scale = np.sqrt(2) / distance if distance > 0 else 1.0
    similarity = np.array(
        [[scale, 0, -scale * center[0]], [0, scale, -scale * center[1]], [0, 0, 1]]
    )
    return similarity, scale * (points - center)
