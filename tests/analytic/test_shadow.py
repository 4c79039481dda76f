import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

from periscopy_sim.analytic.shadow import connected_parts, is_convex, lit_points

CUBE = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
L_OUTLINE = np.array([[1, 1], [1, 3], [0, 3], [0, 0], [3, 0], [3, 1]]) / 10
HEXAGON = np.stack([np.cos(np.pi / 3 * np.arange(6)), np.sin(np.pi / 3 * np.arange(6))], axis=1)
# Every corner of the two outlines is seen from corner 0.
FAN = np.array([[0, k, k + 1] for k in range(1, 5)])


def solid(points):
    """Outward triangles of the convex hull of points that are all its corners."""
    hull = ConvexHull(points)
    a, b, c = points[hull.simplices].swapaxes(0, 1)
    inward = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) < 0
    faces = hull.simplices.astype(np.int64)
    faces[inward] = faces[inward, ::-1]
    return points, faces


def prism(outline):
    """Closed outward triangles over one of the two outlines."""
    near, far = (np.column_stack([outline, np.full(6, z)]) for z in (0.0, 0.5))
    k, after = np.arange(6), np.roll(np.arange(6), -1)
    walls = np.stack([k, after, k + 6, after, after + 6, k + 6], axis=1).reshape(-1, 3)
    return np.concatenate([near, far]), np.concatenate([FAN[:, ::-1], FAN + 6, walls])


def sorted_grid(count):
    points = np.stack(np.meshgrid(*[np.linspace(-1, 1, count)] * 2), axis=-1).reshape(-1, 2)
    return points[np.argsort(points[:, 0], kind="stable")]


def cast(points, source, *parts):
    starts = np.cumsum([0] + [len(part) for part in parts])
    return lit_points(points, source[:2], source[2], np.concatenate(parts), starts)


def test_solids_and_flat_polygons_are_convex_or_not():
    rng = np.random.default_rng(0)
    on_sphere = rng.normal(size=(40, 3))
    on_sphere /= np.linalg.norm(on_sphere, axis=1, keepdims=True)
    assert is_convex(*solid(CUBE))
    assert is_convex(*solid(on_sphere))
    assert is_convex(*prism(HEXAGON))
    assert is_convex(prism(HEXAGON)[0][:6], FAN)
    assert not is_convex(*prism(L_OUTLINE))
    assert not is_convex(prism(L_OUTLINE)[0][:6], FAN)


def test_an_open_solid_is_not_convex():
    vertices, faces = solid(CUBE)
    for missing in range(len(faces)):
        assert not is_convex(vertices, np.delete(faces, missing, axis=0))


def test_a_shallow_dent_is_found():
    vertices, faces = solid(np.concatenate([CUBE, [[0.5, 0.5, 1.1]]]))
    assert is_convex(vertices, faces)
    vertices[8, 2] = 1 - 1e-4
    assert not is_convex(vertices, faces)


def test_triangles_without_an_area_are_convex():
    assert is_convex(np.ones((3, 3)), np.array([[0, 1, 2]]))
    assert is_convex(np.array([[0.0, 0, 0], [1, 1, 1], [3, 3, 3]]), np.array([[0, 1, 2]]))


@pytest.mark.parametrize("seed", range(20))
def test_thin_solids_rounded_to_single_precision_stay_convex(seed):
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    vertices, faces = solid(CUBE * [0.3, 0.2, 0.001])
    rounded = np.float32(vertices @ turn.T + [1.0, 0.5, 0.2])
    assert is_convex(np.float64(rounded), faces)


def test_parts_are_split_by_shared_vertices_and_unused_vertices_are_dropped():
    vertices, faces = solid(CUBE)
    both = np.concatenate([vertices, [[9.0, 9.0, 9.0]], vertices])
    mixed = np.random.default_rng(1).permutation(np.concatenate([faces, faces + 9]))
    parts = connected_parts(both, mixed)
    assert len(parts) == 2
    for part_vertices, part_faces in parts:
        np.testing.assert_array_equal(part_vertices, vertices)
        assert sorted(map(tuple, part_faces)) == sorted(map(tuple, faces))


@pytest.mark.parametrize("count", [3, 4, 12, 60])
def test_the_shadow_is_the_convex_hull_of_the_projection(count):
    rng = np.random.default_rng(count)
    points = rng.uniform(-3, 3, (4000, 2))
    points = points[np.argsort(points[:, 0])]
    vertices = rng.uniform([-0.5, -0.5, 0.2], [0.5, 0.5, 0.8], (count, 3))
    source = np.array([0.3, -0.2, 1.5])
    t = source[2] / (source[2] - vertices[:, 2:])
    shadow = Delaunay(source[:2] + t * (vertices[:, :2] - source[:2]))
    dark = shadow.find_simplex(points) >= 0
    assert dark.any()
    repeated = np.concatenate([vertices, vertices, (vertices[:1] + vertices[1:2]) / 2])
    for part in (vertices, repeated):
        np.testing.assert_array_equal(cast(points, source, part), ~dark)


@pytest.mark.parametrize("seed", range(5))
def test_corners_in_line_and_in_any_order_do_not_matter(seed):
    lattice = np.array([[x, y, 0.5] for x in (-2, -1, 1, 2) for y in (-2, -1, 1, 2)]) / [8, 8, 1]
    points = sorted_grid(8)
    part = np.random.default_rng(seed).permutation(lattice)
    beside = np.abs(points).max(axis=1) > 0.5
    np.testing.assert_array_equal(cast(points, np.array([0.0, 0.0, 1.0]), part), beside)


def test_no_part_leaves_everything_lit():
    assert cast(sorted_grid(3), np.array([0, 0, 1.0]), np.empty((0, 3))).all()


def test_a_flat_part_seen_edge_on_casts_no_shadow():
    square = np.array([[-0.1, 0, 0.3], [0.1, 0, 0.3], [0.1, 0, 0.5], [-0.1, 0, 0.5]])
    assert cast(sorted_grid(8), np.array([0.05, 0.0, 1.0]), square).all()


@pytest.mark.parametrize("turn", np.linspace(0, 1, 20))
def test_triangles_that_share_an_edge_leave_no_bright_seam(turn):
    # The square's diagonal runs through points of the grid.
    square = np.array([[-1, -1, 0.5], [1, -1, 0.5], [1, 1, 0.5], [-1, 1, 0.5]])
    linear = Rotation.from_euler("z", turn).as_matrix()
    points = sorted_grid(20) @ linear[:2, :2].T
    points = points[np.argsort(points[:, 0])]
    halves = (square[[0, 1, 2]] @ linear.T, square[[0, 2, 3]] @ linear.T)
    assert not cast(points, np.array([0.0, 0.0, 1.0]), *halves).any()
