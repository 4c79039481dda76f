"""Generate the props in ``scenes/ambient/meshes`` (metres, z up).

Run ``python scenes/make_ambient_meshes.py`` to write them again. Each mesh has one material; a prop
of two materials is two meshes in the same frame. Props stand on z = 0 and are placed by the scenes.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from make_meshes import MICROMETRE_DECIMALS, box, circle, skin, union_of_parts
from numpy.typing import ArrayLike, NDArray

Points = NDArray[np.float64]
Interval = tuple[float, float]
Mesh = Any  # trimesh.Trimesh, imported only when a mesh is built

MESH_FOLDER = Path(__file__).parent / "ambient" / "meshes"


def boxes(*extents: tuple[Interval, Interval, Interval]) -> Mesh:
    """Union of boxes, each over intervals in x, y and z."""
    return union_of_parts([box(*extent) for extent in extents])


def lathe(profile: Sequence[tuple[float, float]], points: int = 32) -> Mesh:
    """Turn a profile of (radius, height) pairs about the z axis and close it at both ends."""
    radii, heights = np.array(profile).T
    cosine, sine = circle(points)
    level = np.broadcast_to(heights[:, None, None], (len(heights), points, 1))
    rings = np.concatenate(
        [radii[:, None, None] * cosine, radii[:, None, None] * sine, level], axis=-1
    )
    return skin(rings, np.array([0, 0, heights[0]]), np.array([0, 0, heights[-1]]))


def rod(start: ArrayLike, end: ArrayLike, radii: Interval, points: int = 10) -> Mesh:
    """Round rod between two points, with its radius at either."""
    ends = np.array([start, end], dtype=np.float64)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    side = np.cross(along, [1.0, 0.0, 0.0] if abs(along[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    cosine, sine = circle(points)
    around = cosine * side + sine * np.cross(along, side)
    rings = ends[:, None] + np.array(radii)[:, None, None] * around
    return skin(rings, ends[0], ends[1])


# -- furniture ---------------------------------------------------------------------------------


def table() -> Mesh:
    """Table 1.6 m x 0.75 m x 0.75 m; the origin is on the floor below the middle of its back."""
    leg = 0.05
    legs = [
        ((x, x + leg), (y, y + leg), (0.0, 0.72)) for x in (-0.77, 0.72) for y in (-0.73, -0.07)
    ]
    apron = [((-0.74, 0.74), (y, y + 0.02), (0.63, 0.72)) for y in (-0.72, -0.05)]
    return boxes(((-0.8, 0.8), (-0.75, 0.0), (0.72, 0.75)), *legs, *apron)


def stand() -> Mesh:
    """Two posts with a rail and feet that hold the poster board outdoors; front face at y = 0."""
    posts = [((x - 0.02, x + 0.02), (0.0, 0.04), (0.0, 1.4)) for x in (-0.45, 0.45)]
    feet = [((x - 0.02, x + 0.02), (-0.25, 0.45), (0.0, 0.04)) for x in (-0.45, 0.45)]
    return boxes(*posts, *feet, ((-0.45, 0.45), (0.005, 0.035), (0.35, 0.39)))


def seat() -> Mesh:
    """Plain chair, 0.42 m wide, its seat at 0.45 m, that faces +y."""
    legs = [
        ((x, x + 0.035), (y, y + 0.035), (0.0, 0.44)) for x in (-0.21, 0.175) for y in (-0.2, 0.185)
    ]
    posts = [((x, x + 0.035), (-0.22, -0.19), (0.44, 0.88)) for x in (-0.21, 0.175)]
    slats = [((-0.21, 0.21), (-0.215, -0.195), (z, z + 0.06)) for z in (0.60, 0.71, 0.82)]
    return boxes(*legs, *posts, *slats, ((-0.21, 0.21), (-0.2, 0.22), (0.44, 0.47)))


def bookcase() -> Mesh:
    """Bookcase 0.9 m x 0.3 m x 1.8 m with five shelves, open towards -y; back at y = 0."""
    sides = [((x, x + 0.025), (-0.3, 0.0), (0.0, 1.8)) for x in (-0.45, 0.425)]
    shelves = [((-0.43, 0.43), (-0.3, 0.0), (z, z + 0.025)) for z in np.linspace(0.08, 1.775, 6)]
    return boxes(*sides, *shelves, ((-0.45, 0.45), (-0.015, 0.0), (0.0, 1.8)))


def books(colour: int) -> Mesh:
    """Every third book of the bookcase's upper shelves, from the given one on."""
    rng = np.random.default_rng(7)
    all_books = []
    for shelf in np.linspace(0.08, 1.775, 6)[:5] + 0.025:
        x = -0.42
        while x < rng.uniform(0.15, 0.38):
            width, height, depth = rng.uniform([0.018, 0.19, 0.14], [0.05, 0.29, 0.22])
            all_books.append(((x, x + width), (-0.26, -0.26 + depth), (shelf, shelf + height)))
            x += width + 0.002
    return boxes(*all_books[colour::3])


def globe_foot() -> Mesh:
    """Foot and stem of a globe lamp whose globe of radius 0.11 m sits at 0.30 m."""
    return lathe(
        [(0.08, 0.0), (0.08, 0.012), (0.02, 0.03), (0.012, 0.05), (0.012, 0.17), (0.03, 0.195)]
    )


LAMP_HEAD = np.array([-0.22, 0.0, 0.46])
"""Centre of the reading lamp's bulb, from its foot."""


def reading_lamp() -> Mesh:
    """Foot and two arms of a reading lamp that leans towards -x, up to `LAMP_HEAD`."""
    elbow = (0.12, 0.0, 0.34)
    neck = LAMP_HEAD + np.array([0.02, 0.0, 0.09])
    return union_of_parts(
        [
            lathe([(0.09, 0.0), (0.09, 0.02), (0.015, 0.03)]),
            rod((0.0, 0.0, 0.02), elbow, (0.009, 0.009)),
            rod(elbow, neck, (0.008, 0.008)),
            lathe([(0.016, -0.01), (0.016, 0.01)]).apply_translation(elbow),
        ]
    )


def lamp_shade() -> Mesh:
    """Conical metal shade of the reading lamp, open below; the bulb is at its origin."""
    inside = [(0.03, 0.082), (0.042, 0.08), (0.091, -0.06)]
    outside = [(0.095, -0.06), (0.045, 0.085), (0.03, 0.09)]
    return lathe(inside + outside)


# -- buildings ---------------------------------------------------------------------------------

WALL_HEIGHT, WALL_THICKNESS = 2.6, 0.3
SILL, LINTEL = 0.8, 2.2


def wall_with_windows(centers: Sequence[float], half_width: float = 0.8) -> Mesh:
    """Wall along y, 9 m long, with windows; its inside is at x = 0, its outside at x = -0.3."""
    x = (-WALL_THICKNESS, 0.0)
    edges = [-4.5, *(c + s for c in centers for s in (-half_width, half_width)), 4.5]
    piers = [(x, (a, b), (SILL, LINTEL)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return boxes((x, (-4.5, 4.5), (-0.2, SILL)), (x, (-4.5, 4.5), (LINTEL, WALL_HEIGHT)), *piers)


def window_frames(centers: Sequence[float], half_width: float = 0.8) -> Mesh:
    """Frames of the windows, each with a mullion and a transom, and their sills."""
    x, bar = (-0.16, -0.10), 0.05
    parts = []
    for c in centers:
        low, high = c - half_width, c + half_width
        uprights = [(low, low + bar), (c - bar / 2, c + bar / 2), (high - bar, high)]
        levels = [(SILL, SILL + bar), (1.75, 1.75 + bar), (LINTEL - bar, LINTEL)]
        parts += [(x, y, (SILL, LINTEL)) for y in uprights] + [(x, (low, high), z) for z in levels]
        parts.append(((-0.1, 0.08), (low - 0.05, high + 0.05), (SILL - 0.03, SILL + 0.01)))
    return boxes(*parts)


def door() -> Mesh:
    """Door leaf in its frame, 0.95 m x 2.1 m, on a wall at y = 0 that is seen from -y."""
    jambs = [((x, x + 0.07), (-0.03, 0.0), (0.0, 2.12)) for x in (-0.52, 0.45)]
    head = ((-0.52, 0.52), (-0.03, 0.0), (2.05, 2.12))
    leaf = ((-0.45, 0.45), (-0.015, 0.0), (0.0, 2.05))
    panels = [((-0.36, 0.36), (-0.025, 0.0), z) for z in ((0.15, 0.9), (1.05, 1.95))]
    handle = ((0.36, 0.44), (-0.07, -0.015), (1.0, 1.02))
    return boxes(*jambs, head, leaf, *panels, handle)


def pillar() -> Mesh:
    """Round pillar, 3 m high, with base and capital."""
    return lathe(
        [
            (0.34, 0.0), (0.34, 0.18), (0.29, 0.22), (0.31, 0.28), (0.23, 0.36), (0.21, 2.55),
            (0.25, 2.58), (0.22, 2.62), (0.33, 2.84), (0.36, 2.86), (0.36, 3.0),
        ]
    )  # fmt: skip


def arch() -> Mesh:
    """Pointed arch of stone along x between pillars 2.4 m apart, springing from z = 0."""
    span, ring, depth = 1.2, 0.32, 0.25
    # Either half is an arc about the opposite springing.
    angle = np.linspace(0.0, np.pi / 3, 17)
    half = np.stack([2 * span * np.cos(angle) - span, 2 * span * np.sin(angle)], axis=1)
    curve = np.concatenate([half, (half * [-1, 1])[-2::-1]])
    outer = curve * [1 + ring / span, 1 + ring / (2 * span * np.sin(np.pi / 3))]
    corners = [np.insert(c, 1, y, axis=1) for c, y in
               ((curve, -depth), (outer, -depth), (outer, depth), (curve, depth))]  # fmt: skip
    rings = np.stack(corners, axis=1)
    return skin(rings, rings[0].mean(axis=0), rings[-1].mean(axis=0))


def pew() -> Mesh:
    """Church bench, 1.6 m long in x, that faces +y."""
    ends = [((x, x + 0.05), (-0.25, 0.25), (0.0, 0.8)) for x in (-0.8, 0.75)]
    back = ((-0.78, 0.78), (-0.22, -0.18), (0.35, 0.9))
    return boxes(*ends, back, ((-0.78, 0.78), (-0.2, 0.22), (0.42, 0.46)))


def street_lamp() -> Mesh:
    """Street lamp, 4.2 m high, its head towards -x."""
    return union_of_parts(
        [
            lathe([(0.09, 0.0), (0.09, 0.5), (0.05, 0.55), (0.035, 4.1)]),
            rod((0.0, 0.0, 4.05), (-0.8, 0.0, 4.2), (0.03, 0.03)),
            box((-1.25, -0.7), (-0.1, 0.1), (4.15, 4.24)),
        ]
    )


def bench() -> Mesh:
    """Park bench, 1.6 m long in x, that faces -y."""
    legs = [((x, x + 0.06), (-0.22, 0.22), (0.0, 0.42)) for x in (-0.65, 0.59)]
    seat_slats = [((-0.8, 0.8), (y, y + 0.1), (0.42, 0.45)) for y in (-0.24, -0.12, 0.0, 0.12)]
    back = [((-0.8, 0.8), (0.22, 0.25), (z, z + 0.1)) for z in (0.55, 0.70)]
    posts = [((x, x + 0.06), (0.22, 0.27), (0.3, 0.8)) for x in (-0.65, 0.59)]
    return boxes(*legs, *seat_slats, *back, *posts)


# -- plants and snow ---------------------------------------------------------------------------


def leaves(centers: Points, sizes: Points, seed: int) -> Mesh:
    """Diamond-shaped leaves about centres (n, 3), with sizes (n,), turned at random."""
    import trimesh

    rng = np.random.default_rng(seed)
    along, across = rng.normal(size=(2, len(centers), 3))
    across -= along * (np.sum(along * across, 1) / np.sum(along**2, 1))[:, None]
    along, across = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (along, across))
    along, across = along * sizes[:, None], 0.6 * across * sizes[:, None]
    corners = np.stack(
        [centers + along, centers + across, centers - along, centers - across], axis=1
    )
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = (4 * np.arange(len(centers))[:, None, None] + halves).reshape(-1, 3)
    return trimesh.Trimesh(corners.reshape(-1, 3), triangles, process=False)


def ball(rng: np.random.Generator, count: int) -> Points:
    """Points (count, 3) in the outer part of the unit ball."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * rng.uniform(0.5, 1.0, (count, 1))


def tree_crown() -> Mesh:
    """Crown of a broad-leaved tree, 5 m high: leaves about the ends of its boughs."""
    rng = np.random.default_rng(3)
    clouds = [center + radius * ball(rng, 170) * [1, 1, 0.8] for center, radius in BOUGHS]
    centers = np.concatenate(clouds)
    return leaves(centers, rng.uniform(0.09, 0.17, len(centers)), seed=4)


def _boughs() -> list[tuple[Points, float]]:
    rng = np.random.default_rng(5)
    turns = np.arange(11) * 2.4  # near the golden angle
    reach = np.array([0.2, 0.6, 0.9, 1.0, 1.2, 1.2, 1.3, 1.25, 1.2, 1.1, 1.1])
    heights = np.linspace(4.3, 2.3, 11)
    ends = np.stack([reach * np.cos(turns), reach * np.sin(turns), heights], axis=1)
    return list(zip(ends, rng.uniform(0.65, 0.9, 11), strict=True))


BOUGHS = _boughs()
"""End and radius of leaf of each bough of the tree."""


def tree_trunk() -> Mesh:
    """Trunk and boughs of the tree whose leaves are `tree_crown`."""
    trunk = lathe([(0.24, 0.0), (0.17, 0.25), (0.14, 1.6), (0.09, 3.2), (0.03, 4.2)], points=14)
    limbs = [
        rod((0.0, 0.0, 1.4 + 0.5 * (end[2] - 2.0)), end, (0.06, 0.02), points=6)
        for end, _ in BOUGHS[1:]
    ]
    return union_of_parts([trunk, *limbs])


def hedge() -> Mesh:
    """Leaves of a clipped hedge, 4 m x 0.8 m x 1.3 m, about the middle of its foot."""
    rng = np.random.default_rng(9)
    half = np.array([2.0, 0.4, 0.65])
    points = rng.uniform(-1, 1, (1800, 3)) * half
    # Push each point to the face that is nearest; fewer leaves on the ends than on the long sides.
    nearest = np.argmin(half - np.abs(points), axis=1)
    row = np.arange(len(points))
    points[row, nearest] = np.sign(points[row, nearest]) * half[nearest]
    points += rng.normal(scale=0.035, size=points.shape) + np.array([0, 0, half[2]])
    return leaves(points, rng.uniform(0.05, 0.10, len(points)), seed=10)


def spruce() -> Mesh:
    """Spruce, 5 m high: seven tiers of drooping boughs, a star of eleven points each."""
    tiers = []
    cosine, sine = circle(44)
    star = 1 + 0.28 * np.cos(11 * np.linspace(0, 2 * np.pi, 44, endpoint=False))[None, :, None]
    for number, foot in enumerate(np.linspace(0.35, 3.9, 7)):
        radius, height = 1.35 * (1 - foot / 5.0) + 0.12, 1.3 - 0.05 * number
        fraction = np.array([0.45, 1.0, 0.75, 0.35, 0.12])[:, None, None]
        level = foot + height * np.array([0.12, 0.0, 0.22, 0.55, 0.85])[:, None, None]
        wave = star if number % 2 else star[:, ::-1].take(np.arange(-2, 42) % 44, axis=1)
        reach = radius * fraction * (1 + (wave - 1) * fraction)
        sag = level - 0.35 * (wave - 1) * fraction
        rings = np.concatenate([reach * cosine, reach * sine, sag], axis=-1)
        bottom, top = [0, 0, foot + 0.2 * height], [0, 0, foot + height]
        tiers.append(skin(rings, np.array(bottom), np.array(top)))
    return union_of_parts(tiers)


def snow_height(x: Points, y: Points) -> Points:
    """Height of the snow above the ground: drifts, and banks shovelled up on either side."""
    drifts = 0.07 * np.sin(0.9 * x + 0.5 * y) + 0.05 * np.sin(1.7 * y - 0.6 * x + 1.0)
    bank = np.zeros_like(x)
    for x0, y0, rx, ry, height in SNOW_BANKS:
        bank += height * np.exp(-(((x - x0) / rx) ** 2) - ((y - y0) / ry) ** 2)
    lumps = 0.02 * np.sin(5.1 * x + 1.3 * np.sin(3.7 * y)) * np.sin(4.3 * y + np.sin(2.9 * x))
    return 0.12 + drifts + bank + lumps * (1 + 2 * bank)


SNOW_BANKS = (
    (1.85, 0.5, 0.7, 1.3, 0.85),
    (-1.3, 1.3, 0.8, 1.2, 0.55),
    (-2.8, 5.0, 1.6, 1.2, 0.8),
    (3.5, 4.5, 2.0, 1.0, 0.6),
    (0.7, 2.2, 1.6, 0.5, 0.35),
)
"""Centre, half-widths and height of each bank: x, y, across x, across y, height."""


def snow() -> Mesh:
    """Snow-covered ground, 80 m x 80 m, its vertices denser near the middle."""
    import trimesh

    n = 81
    t = np.linspace(-1, 1, n)
    spread = 5.0 * t + 35.0 * t**5
    x, y = np.meshgrid(spread + 0.7, spread + 1.0)
    vertices = np.stack([x, y, snow_height(x, y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1))[..., None, None]
    halves = np.array([[0, 1, n + 1], [0, n + 1, n]])
    triangles = (corner + halves).reshape(-1, 3)
    return trimesh.Trimesh(vertices, triangles, process=False)


MESHES: dict[str, Callable[[], Mesh]] = {
    "arch": arch,
    "bench": bench,
    "bookcase": bookcase,
    "books_blue": lambda: books(0),
    "books_cream": lambda: books(1),
    "books_red": lambda: books(2),
    "door": door,
    "globe_foot": globe_foot,
    "hedge": hedge,
    "lamp_shade": lamp_shade,
    "pew": pew,
    "pillar": pillar,
    "reading_lamp": reading_lamp,
    "seat": seat,
    "snow": snow,
    "spruce": spruce,
    "stand": stand,
    "street_lamp": street_lamp,
    "table": table,
    "tree_crown": tree_crown,
    "tree_trunk": tree_trunk,
    "wall_one_window": lambda: wall_with_windows([0.0]),
    "wall_two_windows": lambda: wall_with_windows([-1.1, 1.1], 0.7),
    "window_frame": lambda: window_frames([0.0]),
    "window_frames": lambda: window_frames([-1.1, 1.1], 0.7),
}


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
    MESH_FOLDER.mkdir(parents=True, exist_ok=True)
    for name in MESHES:
        path = MESH_FOLDER / f"{name}.ply"
        build(name).export(path, vertex_normal=False)
        print(path)


if __name__ == "__main__":
    main()
