"""Marks on a plane wall: points that were clicked, and square tags that hang in any way."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.extras import require
from periscopy_sim.numerics import Array
from periscopy_sim.photographs.wall_view import fit_homography, project

FAMILIES = (
    "APRILTAG_36h11", "APRILTAG_25h9", "APRILTAG_16h5", "APRILTAG_36h10", "4X4_1000", "5X5_1000",
    "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL",
)  # fmt: skip
"""OpenCV's names of the families searched; 4X4_1000 holds those of 4X4_50 and so on."""


def find_tags(
    photograph: NDArray[Any], ids: Sequence[int] | NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array]:
    """Find tags by their numbers in a linear (rows, columns, 3) photograph.

    Return (k,) indices in `ids` of the tags that the photograph shows, and (k, 4, 2) columns and
    rows of their corners, clockwise; the first pixel's centre is at (0.5, 0.5). The tags are of one
    family: that with most of these numbers in the photograph. A PhotographError lists the tags of
    every family that it shows, if these are none of them or one is there twice.
    """
    grey = photograph.mean(axis=2, dtype=np.float64)
    white = float(np.percentile(grey, 99.5))
    lightness = np.sqrt(np.clip(grey / (white if white > 0 else 1), 0, 1))
    picture = np.rint(255 * lightness).astype(np.uint8)
    tags_of = {family: _detected(picture, family) for family in FAMILIES}
    wanted = {int(number) for number in ids}
    family = max(FAMILIES, key=lambda name: len(wanted & set(tags_of[name][0])))
    numbers, corners, modules = tags_of[family]
    if twice := [number for number in sorted(wanted) if numbers.count(number) > 1]:
        raise PhotographError(f"the photograph shows tag {twice[0]} twice; cover all but one")
    places = [place for place, number in enumerate(ids) if int(number) in numbers]
    if not places:
        shown = [f"{sorted(n)} ({name})" for name, (n, *_) in tags_of.items() if n]
        raise PhotographError(
            f"the photograph shows none of the tags {sorted(wanted)}, but "
            f"{', '.join(shown) or 'none of any family'}: check their numbers, the light on them, "
            "and that each has a white border"
        )
    rough = [corners[numbers.index(int(ids[place]))] for place in places]
    return np.array(places), np.array([_refined(grey, each, modules) for each in rough])


def _detected(picture: NDArray[np.uint8], family: str) -> tuple[list[int], list[Array], int]:
    """Return numbers and corners, to a pixel or so, of a family's tags, and modules a side."""
    aruco = require("cv2").aruco
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{family}"))
    corners, numbers, _ = aruco.ArucoDetector(dictionary).detectMarkers(picture)
    # OpenCV's first pixel has its centre at (0, 0).
    places = [np.asarray(c, np.float64).reshape(4, 2) + 0.5 for c in corners]
    numbers = [] if numbers is None else np.ravel(numbers).tolist()
    return numbers, places, dictionary.markerSize + 2


def _refined(grey: Array, corners: Array, modules: int, samples: int = 32) -> Array:
    """Return a tag's corners, (4, 2), known to a pixel or so, where lines through its edges meet.

    OpenCV's own refinements are 0.3 to 1.1 pixels off. Linear light is sampled across each edge;
    the integral of its rise from the black border to the white one locates the step, whatever the
    blur of the lens, if that is even. `modules` squares lie along the tag's side, border included;
    the lines, through `samples` points, leave out 0.12 of the side at each end.
    """
    from scipy.ndimage import map_coordinates

    for _ in range(3):  # the samples' places follow the corners, which start a pixel off
        ends = np.roll(corners, -1, axis=0)
        lines = []
        for start, end, across in zip(corners, ends, np.roll(ends, -1, axis=0), strict=True):
            direction = (end - start) / np.linalg.norm(end - start)
            outward = np.array([direction[1], -direction[0]])
            module = abs((across - end) @ outward) / modules
            reach = np.clip(0.5 * module, 1.0, 4.0)  # pixels: past the blur, not to the next edge
            along = np.linspace(0.12, 0.88, samples)[:, np.newaxis]
            middle = start + along * (end - start)
            offsets = np.linspace(-reach, reach, samples)
            places = middle[:, np.newaxis] + offsets[:, np.newaxis] * outward - 0.5
            profile = map_coordinates(grey, [places[..., 1], places[..., 0]], order=1)
            inside, beyond = profile[:, :1], profile[:, -1:]
            with np.errstate(divide="ignore", invalid="ignore"):
                rise = (profile - inside) / (beyond - inside)
            # A rise from 0 to 1 at s has the integral reach - s over [-reach, reach]; even blur
            # adds on one side of s what it takes on the other.
            shift = reach - np.trapezoid(rise, offsets, axis=1)
            steps = (beyond > inside)[:, 0] & np.isfinite(shift) & (np.abs(shift) < reach)
            if np.count_nonzero(steps) < samples // 2:
                return corners
            edge = middle[steps] + shift[steps, np.newaxis] * outward
            # A line normal . x = distance, by total least squares.
            normal = np.linalg.svd(edge - edge.mean(axis=0))[2][1]
            lines.append((normal, normal @ edge.mean(axis=0)))
        corners = np.array([
            np.linalg.solve(np.stack([a[0], b[0]]), np.array([a[1], b[1]]))
            for a, b in zip(lines[-1:] + lines[:-1], lines, strict=True)
        ])  # fmt: skip
    return corners


@dataclass(frozen=True, eq=False)
class WallPoints:
    """Points of the wall, and where they were clicked in a photograph.

    Attributes
    ----------
    pixels
        (n, 2) column and row; the first pixel's centre is at (0.5, 0.5). For a camera's raw file
        they are the sensor's, as viewers show them.
    positions
        (n, 3) in metres, in the scene's coordinates.
    names
        Names of the points in messages; empty for numbers.
    source
        Name of the list in messages.
    """

    pixels: Array
    positions: Array
    names: Sequence[str] = ()
    source: str = "points"


@dataclass(frozen=True, eq=False)
class WallTags:
    """Tags on the wall, turned in any way.

    Attributes
    ----------
    ids
        (n,) their numbers, each once.
    centers
        (n, 3) in metres, in the scene's coordinates.
    sizes
        (n,) sides of their black squares, in metres.
    source
        Name of the list in messages.
    """

    ids: NDArray[np.int64]
    centers: Array
    sizes: Array
    source: str = "tags"

    def __post_init__(self) -> None:
        """Reject a number that is listed twice, and sizes that are not positive."""
        if len(np.unique(self.ids)) < len(self.ids) or not (self.sizes > 0).all():
            raise PhotographError(
                f"{self.source}: list each tag once, with the positive size of its side in metres"
            )


@dataclass(frozen=True, eq=False)
class Marks:
    """Marks in the wall's plane, and where a photograph shows them.

    A point has one place, p = 1; a square tag has four, its corners, turned by an unknown angle.
    Its arms reach from its centre to each corner before the turn; those of a point are 0.
    """

    pixels: Array  # (n, p, 2) column and row
    centers: Array  # (n, 2) metres across and up
    arms: Array  # (n, p, 2) metres
    names: Sequence[str]  # in messages

    @classmethod
    def of_points(cls, pixels: Array, points: Array, names: Sequence[str]) -> "Marks":
        """Return (n, 2) pixels and their (n, 2) points of the wall, in metres, as marks."""
        return cls(pixels[:, np.newaxis], points, np.zeros((len(points), 1, 2)), names)

    @classmethod
    def of_tags(cls, corners: Array, centers: Array, sizes: Array, names: Sequence[str]) -> "Marks":
        """Return square tags as marks: (n, 4, 2) corners clockwise, (n, 2) centres, (n,) sides."""
        unit = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]])
        return cls(corners, centers, sizes[:, np.newaxis, np.newaxis] * unit, names)

    def __len__(self) -> int:
        """Return the number of marks."""
        return len(self.names)

    @property
    def are_tags(self) -> bool:
        """Whether the marks are tags."""
        return len(self.pixels[0]) > 1

    def turned(self, angles: Array) -> Array:
        """Return (n, p, 2) places on the wall of marks turned by (n,) angles in radians."""
        cos, sin = np.cos(angles)[:, np.newaxis], np.sin(angles)[:, np.newaxis]
        x, y = np.moveaxis(self.arms, -1, 0)
        turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        return np.asarray(self.centers[:, np.newaxis] + turned)

    def without(self, mark: int) -> "Marks":
        """Return all marks but one."""
        pixels, centers, arms = (
            np.delete(each, mark, axis=0) for each in (self.pixels, self.centers, self.arms)
        )
        return Marks(pixels, centers, arms, [n for k, n in enumerate(self.names) if k != mark])

    def as_points(self) -> "Marks":
        """Return the marks as points: the middle of each tag, where its diagonals meet."""
        if not self.are_tags:
            return self
        middles = [
            project(fit_homography(arms, pixels), np.zeros((1, 2)))[0]
            for arms, pixels in zip(self.arms, self.pixels, strict=True)
        ]
        return Marks.of_points(np.array(middles), self.centers, self.names)
