"""The view of a plane wall: marks on it, the map to a photograph, and that map fitted to the marks.

Marks are points that were clicked, or square tags that hang in any way.

Least squares over the marks' places in the photograph. F tests of nested models decide how many
coefficients of the lens are fitted, and whether a mark is wrong: they compare what a further
coefficient, or one mark less, takes off the sum of squares with the rest of that sum.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError, SceneError, require
from periscopy_sim.numerics import Array
from periscopy_sim.view import Geometry, WallFrame

FLATNESS = 1e-3
"""Distance of wall points from a plane, over a film pixel's size, that counts as flat."""


def project(homography: NDArray[np.floating[Any]], points: Array) -> Array:
    """Return (n, 2) points of a plane where a (3, 3) homography sends them."""
    image = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(image[:, :2] / image[:, 2:])


def fit_homography(source: Array, target: Array) -> Array:
    """Return the (3, 3) homography that sends (n, 2) source points to target points, n >= 4.

    This is the normalized direct linear transform (Hartley and Zisserman, *Multiple View Geometry*,
    2nd edition, algorithm 4.2), exact for exact points. The homography has norm 1, and its third
    coordinate is positive at the source's centroid.
    """
    before, after = _normalizing(source), _normalizing(target)
    x, y = project(before, source), project(after, target)
    # y ~ H x: (h1 - y1 h3)·x = 0 and (h2 - y2 h3)·x = 0 of the rows h of H. The null vector of
    # these rows is H; their R alone has it too, at 9 x 9 whatever the number of points.
    rows = np.zeros((2 * len(x), 9))
    rows[0::2, 0:3] = rows[1::2, 3:6] = np.column_stack([x, np.ones(len(x))])
    rows[0::2, 6:9] = -y[:, :1] * rows[0::2, 0:3]
    rows[1::2, 6:9] = -y[:, 1:] * rows[1::2, 3:6]
    normalized = np.linalg.svd(np.linalg.qr(rows, mode="r"))[2][-1].reshape(3, 3)
    homography = np.linalg.solve(after, normalized @ before)
    homography *= np.sign(homography[2] @ [*source.mean(axis=0), 1]) or 1
    return np.asarray(homography / np.linalg.norm(homography))


def similarity(center: Array, scale: float) -> Array:
    """Return the (3, 3) homography that subtracts a (2,) centre and divides by a scale."""
    return np.array([[1, 0, -center[0]], [0, 1, -center[1]], [0, 0, scale]]) / scale


def _normalizing(points: Array) -> Array:
    """Return the similarity that centres points and makes their mean distance sqrt(2)."""
    distance = np.linalg.norm(points - points.mean(axis=0), axis=1).mean()
    return similarity(points.mean(axis=0), distance / np.sqrt(2) or 1.0)


@dataclass(frozen=True, eq=False)
class WallView:
    """The view of a plane through a lens: a homography, then radial distortion.

    A point q = `homography` (u, v, 1) of the undistorted picture, in columns and rows of pixels of
    which the first has its centre at (0.5, 0.5), appears at c + (q - c) (1 + k1 r^2 + k2 r^4),
    where r is its distance from the centre c over `radius` (Brown 1966, without decentring).
    """

    homography: Array = field(repr=False)  # (3, 3), of metres in the plane
    center: Array  # (2,) column and row of the lens's axis, in pixels
    radius: float  # half of the picture's diagonal, in pixels
    distortion: tuple[float, ...] = ()  # (k1, k2), (k1,) or ()

    def pixels_of(self, points: Array) -> Array:
        """Return column and row in the photograph of (n, 2) points of the plane, in metres."""
        offset, square = self._from_axis(points)
        factor = 1 + sum(k * square ** (n + 1) for n, k in enumerate(self.distortion))
        return np.asarray(self.center + offset * factor)

    def shows(self, points: Array) -> bool:
        """Return whether points lie ahead of the camera, and its lens does not fold the picture."""
        if (points @ self.homography[2, :2] + self.homography[2, 2] <= 0).any():
            return False
        square = self._from_axis(points)[1]
        # d/dr of r (1 + k1 r² + k2 r⁴): where it is not positive, the picture folds back.
        slope = 1 + sum((2 * n + 3) * k * square ** (n + 1) for n, k in enumerate(self.distortion))
        return bool(np.all(slope > 0))

    def _from_axis(self, points: Array) -> tuple[Array, Array]:
        """Return (n, 2) undistorted offsets from the axis, and r^2, (n, 1)."""
        offset = project(self.homography, points) - self.center
        return offset, np.sum((offset / self.radius) ** 2, axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class WallPlane:
    """A scene's plane wall: its frame, and where the film's pixels lie in it.

    `film` is the (3, 3) homography from columns and rows of the film, whose first pixel's centre is
    at (0.5, 0.5), to metres across and up in the frame.
    """

    frame: WallFrame
    shape: tuple[int, int]
    film: Array = field(repr=False)

    def coordinates(self, points: Array) -> Array:
        """Return (n, 3) metres across, up and ahead, towards the camera, of (n, 3) points."""
        axes = np.stack([self.frame.across, self.frame.up, self.frame.normal], axis=1)
        return (points - self.frame.center) @ axes

    def pixel_corners(self) -> Array:
        """Return ((rows + 1) (columns + 1), 2) corners of the film's pixels in the plane."""
        rows, columns = self.shape
        row, column = np.indices((rows + 1, columns + 1)).reshape(2, -1)
        return project(self.film, np.stack([column, row], axis=1).astype(np.float64))


def wall_plane(scenario: Geometry) -> WallPlane:
    """Return the plane of a scene's wall.

    A wall that is not plane, a camera that does not show straight lines straight, and a film of
    fewer than 2 x 2 pixels are a SceneError.
    """
    shape = scenario.photograph_shape
    where = f"scene '{scenario.path}'"
    if min(shape) < 2:
        raise SceneError(f"{where}: the film has {shape[0]}x{shape[1]} pixels; give it 2x2")
    points = scenario.view.centers
    plane = WallPlane(scenario.view.frame, shape, np.eye(3))
    across, up, ahead = plane.coordinates(points).T
    on_wall = np.stack([across, up], axis=1)
    pixel = np.linalg.norm(np.diff(on_wall.reshape(*shape, 2), axis=1), axis=2).mean()
    tolerance = FLATNESS * pixel + 1e-6 * np.abs(on_wall).max()
    if (off := np.abs(ahead).max()) > tolerance:
        raise SceneError(
            f"{where}: the wall is curved (it leaves a plane by {1e3 * off:.3g} mm), and marks "
            "rectify a plane wall alone; let the scene's camera be the photograph's, without marks"
        )
    film = np.indices(shape).reshape(2, -1).T[:, ::-1] + np.float64(0.5)  # column and row
    some = np.arange(len(film)).reshape(shape)[:: 1 + shape[0] // 16, :: 1 + shape[1] // 16].ravel()
    homography = fit_homography(film[some], on_wall[some])
    if np.abs(project(homography, film) - on_wall).max() > 10 * tolerance:
        raise SceneError(
            f"{where}: its camera does not show straight lines straight; rectify into a "
            "perspective or orthographic one"
        )
    return replace(plane, film=homography)


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


SIGNIFICANCE = 0.01
"""Rate at which a lens without distortion gets a coefficient, and right marks a bad one."""

MOST_COEFFICIENTS = 2
FEWEST_FREE = 4
"""Measurements beyond the unknowns that a fit with distortion must leave."""

CLICK_ERROR = 0.5
"""Error of a mark's coordinate in the photograph, in pixels, where no residual shows it."""

COORDINATE_ROUNDING = 1e-3
"""Error of any coordinate in the photograph, in pixels: exact marks make no test certain."""

LINE_WIDTH = 0.01
"""Width of marks over their length up to which they count as a line."""


@dataclass(frozen=True, eq=False)
class FittedView:
    """A view of the wall by least squares, with its errors.

    Without freedom, measurements beyond the unknowns, the residuals show nothing.
    """

    marks: Marks = field(repr=False)  # as they were given
    view: WallView
    places: Array = field(repr=False)  # (n, p, 2) of the marks on the wall, tags turned
    residuals: Array = field(repr=False)  # (n p, 2) pixels from the photograph's to the view's
    freedom: int
    _moves: Callable[[Array | None], Array] = field(repr=False)  # of points or marks, per unknown

    @property
    def squares(self) -> float:
        """Sum of squared residuals, in pixels^2, and what rounding adds to it."""
        return float(np.sum(self.residuals**2)) + COORDINATE_ROUNDING**2 * self.residuals.size

    @property
    def error(self) -> float:
        """Standard deviation of a mark's coordinate, in pixels; `CLICK_ERROR` without freedom."""
        return float(np.sqrt(self.squares / self.freedom)) if self.freedom else CLICK_ERROR

    @property
    def rms(self) -> float:
        """Root mean square of the residuals' lengths, in pixels."""
        return float(np.sqrt(2 * np.mean(self.residuals**2)))

    @property
    def rms_on_wall(self) -> float:
        """The same in metres on the wall."""
        on_wall = np.linalg.solve(self.slopes(), self.residuals[..., np.newaxis])
        return float(np.sqrt(2 * np.mean(on_wall**2)))

    def record(self, placement: float) -> dict[str, object]:
        """Return the numbers of the view, and the error with which it places, for metadata."""
        return {
            "view_placement": placement,
            "view_residual_pixels": self.rms,
            "view_distortion": " ".join(map(repr, self.view.distortion)) or "none",
            "view_homography": " ".join(map(repr, self.view.homography.ravel().tolist())),
        }

    def slopes(self) -> Array:
        """Return (n p, 2, 2) derivatives of pixels by metres across and up, at the marks."""
        places = self.places.reshape(-1, 2)
        size = float(np.ptp(places, axis=0).max())
        moved = _derivative(lambda step: self.view.pixels_of(places + size * step), np.zeros(2))
        return np.asarray(moved.reshape(-1, 2, 2) / size)

    def standard_error(self, points: Array) -> float:
        """Return the largest standard error, in pixels, with which (n, 2) points are placed."""
        # Of the fit's unknowns x, dx = J⁺ e of errors e in the marks' pixels, so that a point moves
        # by (dp/dx) J⁺ e: the rows' squares are variances for errors of variance 1.
        moves = self._moves(points) @ np.linalg.pinv(self._moves(None))
        squares = np.sum(moves.reshape(len(points), -1) ** 2, axis=1)
        return float(self.error * np.sqrt(squares.max()))


def fit_view(marks: Marks, size: tuple[int, int]) -> FittedView:
    """Return the view of a plane wall that fits marks best, in a photograph of (rows, columns).

    Distortion is added, k1 and then k2, where it explains the marks better at `SIGNIFICANCE` and
    leaves at least `FEWEST_FREE` measurements. A PhotographError names marks that are too few (four
    points or two tags are needed), lie on a line, make the photograph a mirror image, or disagree
    with the others: by an F test of leaving one out, at `SIGNIFICANCE` for all of them together
    (Bonferroni), from six marks on.
    """
    least, kind = (2, "tags") if marks.are_tags else (4, "points")
    if len(marks) < least:
        raise PhotographError(f"{len(marks)} {kind} do not show the view; give at least {least}")
    points = marks.as_points()
    for k in range(len(points) if kind == "points" else 0):
        others = points.without(k)
        if _on_a_line(others.centers) or _on_a_line(others.pixels[:, 0]):
            raise PhotographError(
                f"all points, or all but {points.names[k]}, lie on a line, or nearly; measure more "
                "beside it"
            )
    order = _coefficients(points, size)
    _check_each(points, size, order)
    fit = _least_squares(marks, size, order)
    if (np.linalg.det(fit.slopes()) > 0).any():  # rows run down, the wall's up runs up
        raise PhotographError(
            "the marks make the photograph a mirror image of the wall; look at the order of column "
            "and row, and at the signs of x, y and z"
        )
    return fit


def _least_squares(marks: Marks, size: tuple[int, int], order: int) -> FittedView:
    """Return the view of least squares with `order` coefficients of the lens.

    Unknown are 8 numbers of a homography, the lens's coefficients, and the angle of each tag. The
    homography is that from the wall about the marks to the picture about the lens's axis, which
    makes each unknown about 1.
    """
    from scipy.optimize import least_squares

    rows, columns = size
    center, radius = np.array([columns / 2, rows / 2]), float(np.hypot(columns, rows) / 2)
    origin = marks.centers.mean(axis=0)
    wall = similarity(origin, np.linalg.norm(marks.centers - origin, axis=1).mean() or 1.0)
    picture = similarity(center, radius)

    def view_of(solution: Array) -> WallView:
        scaled = np.append(solution[:8], 1).reshape(3, 3)
        homography = np.linalg.solve(picture, scaled @ wall)
        return WallView(
            np.asarray(homography), center, radius, tuple(map(float, solution[8 : 8 + order]))
        )

    def places_of(solution: Array) -> Array:
        return marks.turned(solution[8 + order :] if marks.are_tags else np.zeros(len(marks)))

    def pixels_of(solution: Array, points: Array | None = None) -> Array:
        on_wall = places_of(solution).reshape(-1, 2) if points is None else points
        return view_of(solution).pixels_of(on_wall)

    def residuals(solution: Array) -> Array:
        return (pixels_of(solution) - marks.pixels.reshape(-1, 2)).ravel()

    try:
        homography, angles = _start(marks)
        scaled = (picture @ homography @ np.linalg.inv(wall)).ravel()
        start = np.concatenate([scaled[:8] / scaled[8], np.zeros(order), angles])
        # Tolerances at the limit of double precision: exact marks must give an exact view.
        fit = least_squares(residuals, start, method="lm", xtol=1e-13, ftol=1e-13, gtol=1e-13)
    except (ValueError, np.linalg.LinAlgError):  # a horizon through the marks, or no homography
        raise PhotographError(
            "no view of a plane wall shows the marks like this; look at their order, and at each "
            "number"
        ) from None
    return FittedView(
        marks, view_of(fit.x), places_of(fit.x), fit.fun.reshape(-1, 2),
        fit.fun.size - fit.x.size,
        lambda points: _derivative(lambda solution: pixels_of(solution, points), fit.x),
    )  # fmt: skip


def _start(marks: Marks) -> tuple[Array, Array]:
    """Return a homography and the angles of tags to begin with; points have no angles."""
    if not marks.are_tags:
        return fit_homography(marks.centers, marks.pixels[:, 0]), np.zeros(0)
    # The largest tag shows the view but for its own turn; the other tags' middles show that.
    points, plane = marks.as_points(), np.array([1, 1j])
    largest = int(np.linalg.norm(marks.pixels[:, 2] - marks.pixels[:, 0], axis=1).argmax())
    seen = np.linalg.inv(fit_homography(marks.arms[largest], marks.pixels[largest]))
    # As complex numbers x + iy: the angle of a sum of products w z* is that of the turn which
    # brings the z nearest to the w, in least squares.
    offsets = project(seen, points.pixels[:, 0]) @ plane
    expected = (marks.centers - marks.centers[largest]) @ plane
    turn = np.angle(np.sum(expected * offsets.conj()))
    on_wall = marks.turned(np.full(len(marks), turn))[largest]
    homography = fit_homography(on_wall, marks.pixels[largest])
    back = project(np.linalg.inv(homography), marks.pixels.reshape(-1, 2)).reshape(-1, 4, 2)
    turned = (back - marks.centers[:, np.newaxis]) @ plane
    return homography, np.angle(np.sum(turned * (marks.arms @ plane).conj(), axis=1))


def _on_a_line(points: Array) -> bool:
    """Return whether (n, 2) points, three or more, lie on a line, within `LINE_WIDTH` of it."""
    length, width = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(width <= LINE_WIDTH * length)


def _derivative(function: Callable[[Array], Array], at: Array) -> Array:
    """Return the derivative of a function's ravelled values, by central differences."""
    # Unknowns are about 1, see `_least_squares`: the step balances curvature and rounding.
    steps = 1e-6 * np.eye(len(at))
    moved = [(function(at + step) - function(at - step)).ravel() / 2e-6 for step in steps]
    return np.stack(moved, axis=1)


def _p_value(simple: FittedView, rich: FittedView) -> float:
    """Return the probability that chance alone reduces the squares as much as the richer fit.

    The simpler fit has more unknowns fixed, or a mark more to explain. The ratio of what is taken
    off to the rest, each per degree of freedom, has the F distribution.
    """
    from scipy.special import fdtrc

    more = simple.freedom - rich.freedom
    gained = max(simple.squares - rich.squares, 0) / more
    return float(fdtrc(more, rich.freedom, gained / (rich.squares / rich.freedom)))


def _coefficients(points: Marks, size: tuple[int, int]) -> int:
    """Return how many coefficients of the lens the points support."""
    order = 0
    # Each point measures a column and a row; a homography has 8 unknowns, the next lens order + 1.
    while order < MOST_COEFFICIENTS and 2 * len(points) - (9 + order) >= FEWEST_FREE:
        simple, rich = (_least_squares(points, size, order + more) for more in (0, 1))
        if _p_value(simple, rich) > SIGNIFICANCE:
            break
        order += 1
    return order


def _check_each(points: Marks, size: tuple[int, int], order: int) -> None:
    """Raise if a point disagrees with the others."""
    count = len(points)
    if 2 * (count - 1) <= 8 + order:  # without one, the others fit exactly and show no error
        return
    whole = _least_squares(points, size, order)
    rest = [_least_squares(points.without(k), size, order) for k in range(count)]
    chances = [_p_value(whole, each) for each in rest]
    worst = int(np.argmin(chances))
    if chances[worst] * count >= SIGNIFICANCE:
        return
    column, row = points.pixels[worst, 0]
    off = rest[worst].view.pixels_of(points.centers[worst : worst + 1])[0] - (column, row)
    raise PhotographError(
        f"{points.names[worst]} at column {column:.1f}, row {row:.1f} lies {np.hypot(*off):.1f} "
        f"pixels from where the other {count - 1} place it (their own error is "
        f"{rest[worst].error:.2f}); measure it again, or leave it out"
    )
