"""The scene as plain arrays: what the camera sees of the wall, what the hidden patches are."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError, did_you_mean

Array = NDArray[np.float64]

RULER_ERROR = "_error"
"""Ends the name of a ``<default>`` that says how well the one before that ending is known."""

CALIBRATED = "calibrated_covariance"
"""Names the ``<default>`` in which a calibration says how well it knows the parameters."""

POINT = 1e-6
"""Side of a pixel that counts as a point, in metres."""

LIFT = 1e-4
"""Height of points just off the wall, over the diagonal of what the camera sees of it."""


@dataclass(frozen=True)
class EmissionProfile:
    """Angular emission of an LCD: radiance relative to the normal's, after [15].

    The exponents are those of the cosines of the vertical and the horizontal angle; 0 and 0 is
    Lambertian.
    """

    vertical: float = 0.0
    horizontal: float = 0.0

    def __call__(self, across: Array, up: Array, normal: Array) -> Array:
        """Evaluate the profile for directions given by their components along the monitor's axes.

        They are broadcastable, of any positive scale; the result is 1 along the normal, 0 behind
        the monitor.
        """
        lit = normal > 0
        ahead = np.where(lit, normal, 1.0)
        cos_vertical = ahead / np.hypot(ahead, up)
        cos_horizontal = ahead / np.hypot(ahead, across)
        return np.where(lit, cos_vertical**self.vertical * cos_horizontal**self.horizontal, 0.0)


@dataclass(frozen=True, eq=False)
class Occluder:
    """A shape that may block light; `name` is its id in the scene file.

    Of a triangle mesh `vertices` are (V, 3) positions in metres and `faces` (F, 3) vertex indices,
    of a cylinder or a disk those of a fine polygon's; of any other shape both are None. `bounds`,
    (2, 3), are the lower and the upper corner of the box about it, where they are known.
    """

    name: str
    vertices: Array | None
    faces: NDArray[np.int64] | None
    bounds: Array | None = None


@dataclass(frozen=True)
class SceneDocument:
    """What a scene file and those that it includes declare, and the values given instead.

    `defaults` maps the name of each ``<default>`` to its value, the first of that name, whatever
    was `given`. `files` are the scene and every file that exists and belongs to it, each once, in
    the order of the text.
    """

    path: Path
    given: Mapping[str, str] = field(default_factory=dict)
    defaults: Mapping[str, str] = field(default_factory=dict)
    files: tuple[Path, ...] = ()
    folders: tuple[Path, ...] = ()  # where the files of plugins are searched, in this order
    missing: tuple[str, ...] = ()  # names of includes, spectra and folders that are nowhere
    units: Mapping[str, str] = field(default_factory=dict)
    """m or degrees, of the ``<default>``s that move or turn something"""

    @property
    def values(self) -> dict[str, str]:
        """The values in force: those given, else the defaults."""
        return {**self.defaults, **self.given}

    @property
    def errors(self) -> dict[str, str]:
        """The ``<default>``s that are standard errors, each with the one that it is of."""
        ends = {name: name.removesuffix(RULER_ERROR) for name in self.defaults}
        return {name: of for name, of in ends.items() if of != name and of in self.defaults}

    def undeclared(self, name: str) -> SceneError:
        """Return the error of a parameter that is not declared, with what may be meant."""
        known = [each for each in self.defaults if each != CALIBRATED and each not in self.errors]
        meant = did_you_mean(name, self.defaults) or f"it declares {', '.join(known) or 'none'}"
        return SceneError(f"scene '{self.path}' declares no parameter '{name}'; {meant}")


@dataclass(frozen=True, eq=False)
class Scenario:
    """One camera, one relay wall, one hidden monitor and what stands between them.

    M is the number of pixels of the photograph, N the number of patches of the hidden image; both
    are row-major with row 0 at the top.

    Attributes
    ----------
    document
        The Mitsuba scene file: its place, what it declares, and values given for that.
    photograph_shape
        (rows, columns) of the photograph.
    hidden_shape
        (rows, columns) of the hidden image.
    wall_points
        (M, 3) points that the pixels' centres see, in metres.
    wall_normals
        (M, 3) unit normals, towards the camera.
    wall_reflectance
        (3,) albedo of a diffuse wall; None for another material.
    channel_gain
        (3,) the wall's colour, mean 1: a photograph's channel c is channel_gain[c] * A @ f[:, c].
    patch_centers
        (N, 3) centres in metres.
    patch_normals
        (N, 3) unit normals of the emitting side.
    patch_across, patch_up
        (N, 3) edge vectors in metres along a viewer's right and up; their cross product's norm is
        the patch's area.
    mirrored
        Whether the monitor's u coordinate runs to a viewer's left, so that the columns run
        against it.
    emission
        The monitor's angular profile where a closed form is known, else None.
    occluders
        Every shape but the wall and the monitor.
    wall_relief
        How far the wall's shape, seen or not, reaches into the room out of the plane that is seen,
        in metres: there it might cast shadows.
    lights
        Names of the emitters beside the monitor's, whose light is not in A.
    loader
        Loads the scene file at other values; see `at`.
    """

    document: SceneDocument = field(repr=False)
    photograph_shape: tuple[int, int]
    hidden_shape: tuple[int, int]
    wall_points: Array = field(repr=False)
    wall_normals: Array = field(repr=False)
    wall_reflectance: Array | None
    channel_gain: Array
    patch_centers: Array = field(repr=False)
    patch_normals: Array = field(repr=False)
    patch_across: Array = field(repr=False)
    patch_up: Array = field(repr=False)
    mirrored: bool
    emission: EmissionProfile | None
    occluders: tuple[Occluder, ...] = field(repr=False)
    wall_relief: float = 0.0
    lights: tuple[str, ...] = ()
    loader: "Callable[[Mapping[str, str]], Scenario] | None" = field(default=None, repr=False)

    def at(self, **values: str | float) -> "Scenario":
        """Return the same scene with other values for its file's ``<default>``s.

        Values that are not named stay. Where they move, turn or stretch the camera, the monitor,
        meshes or a plain rectangular wall, and no shape comes near the camera's view, their arrays
        move in a few milliseconds, without rays; anything else loads the file anew.

        Raises
        ------
        SceneError
            If the file declares no such parameter, or there is no such scene, see `load_scenario`.
        ValueError
            If the scenario was made of arrays, not of a file.
        """
        if self.loader is None:
            raise ValueError("this scenario has no scene file to load at other values")
        given = {name: str(value) for name, value in values.items()}
        return self.loader({**self.parameters, **given})

    def __repr__(self) -> str:
        """Return its file, sizes and parameters on one line."""
        given = "".join(f", {name}={value}" for name, value in self.parameters.items())
        (rows, columns), (R, C) = self.photograph_shape, self.hidden_shape
        return (
            f"Scenario('{self.path}', {R}x{C} patches, {rows}x{columns} pixels, "
            f"{len(self.occluders)} occluders{given})"
        )

    @property
    def path(self) -> Path:
        """The Mitsuba scene file."""
        return self.document.path

    @property
    def parameters(self) -> Mapping[str, str]:
        """Values given for the file's ``<default>``s."""
        return self.document.given

    @property
    def transport_shape(self) -> tuple[int, int]:
        """(M, N), the shape of the light transport matrix."""
        return len(self.wall_points), len(self.patch_centers)


def pixel_edges(points: Array, normals: Array, shape: tuple[int, int]) -> Array:
    """Return the edges, (M, 2, 3) down and across, of pixels whose centres are the (M, 3) points.

    Pixels of a lone row or column count as square, a lone pixel as a point.
    """
    rows, columns = shape
    grid, normal = points.reshape(*shape, 3), normals.reshape(*shape, 3)
    if rows > 1:
        down = np.asarray(np.gradient(grid, axis=0))
    if columns > 1:
        across = np.asarray(np.gradient(grid, axis=1))
    elif rows > 1:
        across = np.cross(normal, down)
    else:
        across = POINT * np.cross(normal, np.eye(3)[np.abs(normals[0]).argmin()])
    if rows == 1:
        down = np.cross(normal, across)
    return np.stack([down, across], axis=2).reshape(-1, 2, 3)


def rises(points: Array, normals: Array, shape: tuple[int, int]) -> Array:
    """Return how far the pixels next to each rise above its tangent plane, (M,), at least 0.

    Rays that start lower may start behind a wall that bends towards the room.
    """
    grid, normal = points.reshape(*shape, 3), normals.reshape(*shape, 3)
    height = np.zeros(shape)
    for axis in (0, 1):
        p, n, h = (np.swapaxes(each, 0, axis) for each in (grid, normal, height))
        step = np.diff(p, axis=0)
        np.maximum(h[:-1], np.sum(step * n[:-1], axis=-1), out=h[:-1])
        np.maximum(h[1:], -np.sum(step * n[1:], axis=-1), out=h[1:])
    return height.ravel()


def corners(bounds: Array) -> Array:
    """Return the corners, (8, 3), of a box given by its lower and its upper corner, (2, 3)."""
    return np.stack(np.meshgrid(*bounds.T), axis=-1).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class WallFrame:
    """Axes of the camera's field of view on the wall, about the wall points' centroid (metres).

    They are orthonormal: the photograph's columns run along across, as far as the wall's plane
    allows; the normal points into the room; up completes them.
    """

    center: Array
    across: Array
    normal: Array
    up: Array


def wall_frame(
    points: Array, normals: Array, photograph_shape: tuple[int, int] | None = None
) -> WallFrame:
    """Orient the field of view by the photograph's own rows and columns.

    Points (M, 3) are in metres, normals (M, 3) of unit length. A photograph shape of None, or of a
    single column, takes the horizontal direction of the wall (z up) as across.
    """
    center = points.mean(axis=0)
    normal = normals.mean(axis=0)
    normal /= np.linalg.norm(normal)
    rows, columns = photograph_shape or (1, 1)
    if columns > 1:
        grid = points.reshape(rows, columns, 3)
        across = (grid[:, -1] - grid[:, 0]).mean(axis=0)
    else:
        vertical = np.array([0.0, 0.0, 1.0])
        across = np.cross(vertical, normal)
        if np.linalg.norm(across) < 1e-6:
            across = np.array([1.0, 0.0, 0.0])
    across = across - (across @ normal) * normal
    across /= np.linalg.norm(across)
    up = np.cross(across, -normal)
    return WallFrame(center, across, normal, up)
