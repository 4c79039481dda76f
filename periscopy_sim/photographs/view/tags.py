"""Square markers on the wall, AprilTag or ArUco, found in a photograph by OpenCV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.view.homography import Array

FAMILIES = (
    "APRILTAG_36h11", "APRILTAG_25h9", "APRILTAG_16h5", "APRILTAG_36h10", "4X4_1000", "5X5_1000",
    "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL",
)  # fmt: skip
"""OpenCV's names of the families that are looked for; 4X4_1000 holds those of 4X4_50 and so on."""

ROUNDS = 3
SAMPLES = 32
INSET = 0.12
"""Of a side of a tag at each end, which is left out where lines are put through its edges."""

FEWEST = 2
"""Tags that tell the view of the wall: one could be turned in any way."""


@dataclass(frozen=True, eq=False)
class SeenTags:
    """The tags of a list that a photograph shows.

    Attributes
    ----------
    family
        Which family they are of, one of `FAMILIES`.
    places
        (k,) their places in the list.
    corners
        (k, 4, 2) column and row of their corners, clockwise; the first pixel's centre is at
        (0.5, 0.5).
    """

    family: str
    places: NDArray[np.int64]
    corners: Array


def find_tags(photograph: NDArray[Any], ids: Sequence[int] | NDArray[np.int64]) -> SeenTags:
    """Find tags by their numbers, in a linear (rows, columns, 3) photograph.

    The family is that of which most of the tags are seen.

    Raises
    ------
    PhotographError
        If a tag is seen twice, or fewer than `FEWEST` are seen; the message says which tags of
        which families are.
    """
    picture = _as_seen(photograph)
    found = {family: _detected(picture, family) for family in FAMILIES}
    wanted = {int(number) for number in ids}
    family = max(FAMILIES, key=lambda name: len(wanted & set(found[name][0])))
    numbers, corners = found[family]
    for number in sorted(wanted):
        if numbers.count(number) > 1:
            middles = [c.mean(axis=0).round().astype(int).tolist() for c, n in
                       zip(corners, numbers, strict=True) if n == number]  # fmt: skip
            raise PhotographError(
                f"tag {number} is seen {len(middles)} times, at columns and rows "
                f"{' and '.join(map(str, middles))}; cover all but one"
            )
    seen = [place for place, number in enumerate(ids) if int(number) in numbers]
    if len(seen) < FEWEST:
        told = [f"{', '.join(map(str, sorted(n)))} ({name})" for name, (n, _) in found.items() if n]
        raise PhotographError(
            f"of the tags {', '.join(str(int(n)) for n in ids)}, {len(seen)} are seen, and "
            f"{FEWEST} at least are needed; "
            f"seen are {'; '.join(told) or 'none of any family'}: check their numbers, the "
            "light on them, and that each has a white border"
        )
    grey, modules = photograph.mean(axis=2, dtype=np.float64), _dictionary(family).markerSize + 2
    places = [corners[numbers.index(int(ids[place]))] for place in seen]
    return SeenTags(
        family,
        np.array(seen),
        np.array([refined_corners(grey, each, modules) for each in places]),
    )


def _as_seen(photograph: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a photograph as 8 bits of grey, in steps even to the eye, up to its brightest."""
    grey = photograph.mean(axis=2)
    white = float(np.percentile(grey, 99.5))
    lightness = np.sqrt(np.clip(grey / (white if white > 0 else 1), 0, 1))
    return np.asarray(np.rint(255 * lightness), np.uint8)


def _detected(picture: NDArray[np.uint8], family: str) -> tuple[list[int], list[Array]]:
    """Return numbers and corners of a family's tags, to a pixel or so."""
    import cv2

    dictionary = _dictionary(family)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(picture)
    if numbers is None:
        return [], []
    # OpenCV's first pixel has its centre at (0, 0).
    places = [np.asarray(c, np.float64).reshape(4, 2) + 0.5 for c in corners]
    return np.ravel(numbers).tolist(), places


def _dictionary(family: str) -> Any:
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{family}"))


def refined_corners(grey: Array, corners: Array, modules: int) -> Array:
    """Return the corners of a tag where lines through its four edges meet, (4, 2).

    OpenCV's own refinement leaves half a pixel. Across each edge light is sampled from within the
    black border to the white one; the place where it steps is told by its integral, whatever the
    lens blurs, as long as it blurs evenly. This is of linear light.

    Parameters
    ----------
    grey
        (rows, columns) linear light.
    corners
        (4, 2) column and row to within a pixel or so, clockwise.
    modules
        Squares of the tag's grid along its side, border included.
    """
    from scipy.ndimage import map_coordinates

    for _ in range(ROUNDS):
        ends = np.roll(corners, -1, axis=0)
        lines = []
        for start, end, across in zip(corners, ends, np.roll(ends, -1, axis=0), strict=True):
            direction = (end - start) / np.linalg.norm(end - start)
            outward = np.array([direction[1], -direction[0]])
            module = abs((across - end) @ outward) / modules
            reach = np.clip(0.5 * module, 1.0, 4.0)
            along = np.linspace(INSET, 1 - INSET, SAMPLES)[:, np.newaxis]
            middle = start + along * (end - start)
            offsets = np.linspace(-reach, reach, SAMPLES)
            places = middle[:, np.newaxis] + offsets[:, np.newaxis] * outward - 0.5
            profile = map_coordinates(grey, [places[..., 1], places[..., 0]], order=1)
            inside, beyond = profile[:, :1], profile[:, -1:]
            with np.errstate(divide="ignore", invalid="ignore"):
                rise = (profile - inside) / (beyond - inside)
            shift = reach - np.trapezoid(rise, offsets, axis=1)
            steps = (beyond > inside)[:, 0] & np.isfinite(shift) & (np.abs(shift) < reach)
            if np.count_nonzero(steps) < SAMPLES // 2:
                return corners
            edge = middle[steps] + shift[steps, np.newaxis] * outward
            # A line normal . x = distance, by total least squares.
            normal = np.linalg.svd(edge - edge.mean(axis=0))[2][1]
            lines.append((normal, normal @ edge.mean(axis=0)))
        before = [lines[-1], *lines[:-1]]
        corners = np.array([
            np.linalg.solve(np.stack([a[0], b[0]]), np.array([a[1], b[1]]))
            for a, b in zip(before, lines, strict=True)
        ])  # fmt: skip
    return corners
