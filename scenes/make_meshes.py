"""Generate the meshes in ``scenes/meshes`` (metres, z up, x right as the camera faces the wall).

Run ``python scenes/make_meshes.py`` to write them again. Every mesh is a set of closed parts whose
triangles face outwards; parts overlap or touch, but no two share a vertex, so that welding equal
vertices leaves them apart.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Mesh = Any  # trimesh.Trimesh, imported only when a mesh is built

MESH_FOLDER = Path(__file__).parent / "meshes"
MICROMETRE_DECIMALS = 6


def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Mesh:
    """Axis-aligned box of 8 vertices and 12 triangles over three intervals, in metres."""
    import trimesh

    return trimesh.creation.box(bounds=np.transpose([x, y, z]))


def union_of_parts(parts: list[Mesh]) -> Mesh:
    """One mesh that keeps every part's own vertices, in the order of the list."""
    import trimesh

    return trimesh.util.concatenate(parts)


def skin(rings: Points, first_pole: Points, last_pole: Points) -> Mesh:
    """Stretch a closed surface over a row of rings and cap it with two poles.

    Parameters
    ----------
    rings : (n, m, 3) array
        n closed curves of m points, each counterclockwise about the direction of travel.
    first_pole, last_pole : (3,) arrays
        Points that close the surface before the first ring and after the last.

    Returns
    -------
    Mesh
        n m + 2 vertices and 2 n m triangles, facing outwards.
    """
    import trimesh

    n, m = rings.shape[:2]
    here = np.arange(n * m).reshape(n, m)
    there = np.roll(here, -1, axis=1)
    first, last = np.full(m, n * m), np.full(m, n * m + 1)
    triangles = np.concatenate(
        [
            np.stack([first, there[0], here[0]], axis=-1),
            np.stack([here[:-1], there[:-1], there[1:]], axis=-1).reshape(-1, 3),
            np.stack([here[:-1], there[1:], here[1:]], axis=-1).reshape(-1, 3),
            np.stack([last, here[-1], there[-1]], axis=-1),
        ]
    )
    vertices = np.concatenate([rings.reshape(-1, 3), [first_pole, last_pole]])
    return trimesh.Trimesh(vertices, triangles, process=False)


def circle(points: int) -> tuple[Points, Points]:
    """Cosines and sines, each (1, points, 1), of equally spaced angles."""
    angles = np.linspace(0.0, 2 * np.pi, points, endpoint=False)[None, :, None]
    return np.cos(angles), np.sin(angles)


@dataclass(frozen=True)
class Spine:
    """Points along a curve with its moving frame, each (n, 3): side x normal = tangent."""

    points: Points
    tangent: Points
    side: Points
    normal: Points


def arc(
    start: Points, azimuth: float, leans: tuple[float, float], length: float, s: Points, roll: float
) -> Spine:
    """Circular arc in a vertical plane.

    Parameters
    ----------
    start : (3,) array
        First point, metres.
    azimuth : float
        Direction of the plane, radians from +x towards +y.
    leans : (float, float)
        Angle from the vertical at the first and the last point, radians; the two must differ.
    length : float
        Arc length, metres.
    s : (n,) array
        Where to sample, as fractions of the length.
    roll : float
        Turn of the frame about the tangent, radians; 0 leaves the side horizontal.
    """
    lean = (leans[0] + (leans[1] - leans[0]) * s)[:, None]
    radius = length / (leans[1] - leans[0])
    outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    level = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    tangent = np.sin(lean) * outward + np.cos(lean) * up
    points = start + radius * (
        (np.cos(leans[0]) - np.cos(lean)) * outward + (np.sin(lean) - np.sin(leans[0])) * up
    )
    side = np.cos(roll) * level + np.sin(roll) * np.cross(tangent, level)
    return Spine(points, tangent, side, np.cross(tangent, side))


@dataclass(frozen=True)
class Shoot:
    """One stem and its leaf: angles in degrees, lengths in metres.

    The leans are those of the stem's foot, its end, and the leaf's tip, from the vertical.
    """

    azimuth: float
    leans: tuple[float, float, float]
    stem: float
    leaf: float
    leaf_width: float
    roll: float


SHOOTS = (
    Shoot(8, (14, 64, 128), stem=0.050, leaf=0.054, leaf_width=0.029, roll=62),
    Shoot(-20, (8, 34, 62), stem=0.066, leaf=0.058, leaf_width=0.033, roll=76),
    Shoot(55, (3, 12, -14), stem=0.106, leaf=0.063, leaf_width=0.031, roll=20),
    Shoot(155, (6, 24, 76), stem=0.096, leaf=0.066, leaf_width=0.033, roll=-72),
    Shoot(192, (16, 58, 84), stem=0.058, leaf=0.050, leaf_width=0.030, roll=-80),
    Shoot(-105, (6, 24, 10), stem=0.046, leaf=0.046, leaf_width=0.025, roll=-14),
    Shoot(-150, (10, 62, 158), stem=0.044, leaf=0.050, leaf_width=0.026, roll=-36),
)
SOIL_HEIGHT = 0.064


def vase() -> Mesh:
    """Vase turned on a lathe: foot, belly, waist, flared rim, and soil just below it."""
    from scipy.interpolate import CubicSpline

    outer_heights = np.linspace(0.0, 0.070, 36)
    outer_radii = CubicSpline([0.0, 0.024, 0.053, 0.070], [0.019, 0.031, 0.0175, 0.026])(
        outer_heights
    )
    rim_and_soil = np.array([[0.0257, 0.0708], [0.0246, 0.0708], [0.0165, SOIL_HEIGHT]])
    radii, heights = np.concatenate([np.stack([outer_radii, outer_heights], -1), rim_and_soil]).T
    cosine, sine = circle(48)
    rings = np.concatenate(
        [
            radii[:, None, None] * cosine,
            radii[:, None, None] * sine,
            np.broadcast_to(heights[:, None, None], (heights.size, 48, 1)),
        ],
        axis=-1,
    )
    return skin(rings, np.zeros(3), np.array([0.0, 0.0, SOIL_HEIGHT]))


def stem(spine: Spine) -> Mesh:
    """Round stem along a spine, thinning from 1.6 mm to 1.0 mm in radius."""
    cosine, sine = circle(12)
    radius = np.linspace(0.0016, 0.0010, len(spine.points))[:, None, None]
    across = cosine * spine.side[:, None] + sine * spine.normal[:, None]
    return skin(spine.points[:, None] + radius * across, spine.points[0], spine.points[-1])


def leaf(spine: Spine, fraction: Points, width: float) -> Mesh:
    """Pointed leaf along a spine: a flattened ellipse, 1 mm thick, whose edges curl up.

    Parameters
    ----------
    spine : Spine
        Midrib, n points with both ends.
    fraction : (n,) array
        Their fractions of the midrib's length, from 0 to 1.
    width : float
        Greatest width, metres.
    """
    thickness, cup = 0.001, 0.25
    outline = fraction**0.7 * (1 - fraction)
    half_width = (width / 2 * outline / outline.max())[1:-1, None, None]
    half_thickness = thickness / 2 * np.sqrt(half_width / half_width.max())
    cosine, sine = circle(20)
    rings = (
        spine.points[1:-1, None]
        + half_width * cosine * spine.side[1:-1, None]
        + (half_thickness * sine + cup * half_width * cosine**2) * spine.normal[1:-1, None]
    )
    return skin(rings, spine.points[0], spine.points[-1])


def shoot(form: Shoot) -> list[Mesh]:
    """Stem and leaf of one shoot; the leaf begins a little before the stem ends."""
    azimuth, roll = np.radians(form.azimuth), np.radians(form.roll)
    foot_lean, end_lean, tip_lean = np.radians(form.leans)
    outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    foot = 0.007 * outward + [0.0, 0.0, SOIL_HEIGHT - 0.003]
    stalk = arc(foot, azimuth, (foot_lean, end_lean), form.stem, np.linspace(0, 1, 14), 0.0)
    fraction = np.linspace(0, 1, 26)
    midrib = arc(stalk.points[-2], azimuth, (end_lean, tip_lean), form.leaf, fraction, roll)
    return [stem(stalk), leaf(midrib, fraction, form.leaf_width)]


def plant() -> Mesh:
    """Potted plant, a curved, non-convex occluder about 0.16 m wide and 0.22 m high.

    Returns
    -------
    Mesh
        15 closed parts: the vase, then a stem and a leaf for each of the seven shoots. The origin
        is the centre of the vase's foot.
    """
    return union_of_parts([vase(), *(part for form in SHOOTS for part in shoot(form))])


MESHES: dict[str, Callable[[], Mesh]] = {"plant": plant}


def build(name: str) -> Mesh:
    """Build the named mesh, rounded to a micrometre so that every platform writes the same bytes.

    Raises
    ------
    KeyError
        If ``name`` is not one of ``MESHES``.
    """
    mesh = MESHES[name]()
    mesh.vertices = np.round(mesh.vertices, MICROMETRE_DECIMALS)
    return mesh


def main() -> None:
    """Write every mesh as a binary PLY file of vertices and triangles."""
    MESH_FOLDER.mkdir(exist_ok=True)
    for name in MESHES:
        path = MESH_FOLDER / f"{name}.ply"
        build(name).export(path, vertex_normal=False)
        print(path)


if __name__ == "__main__":
    main()
