import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.cells.cell_mesh import cell_mesh, rectangles

from tests.calibration.silhouette.conftest import FLAG


@pytest.mark.parametrize("seed", range(5))
def test_rectangles_cover_each_opaque_cell_once(seed):
    opaque = np.random.default_rng(seed).random((7, 5)) < 0.6
    covered = np.zeros(opaque.shape, int)
    for top, bottom, left, right in rectangles(opaque):
        covered[top:bottom, left:right] += 1
    np.testing.assert_array_equal(covered, opaque)


def test_a_block_of_cells_is_one_rectangle():
    opaque = np.zeros((6, 8), bool)
    opaque[1:4, 2:7] = True
    assert rectangles(opaque) == [(1, 4, 2, 7)]
    assert rectangles(np.zeros((3, 3), bool)) == []


def test_the_mesh_has_the_area_of_its_cells_in_their_plane(plane):
    mesh = cell_mesh(plane, FLAG)
    edges = np.diff(mesh.vertices[mesh.faces], axis=1)
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2
    cell = 0.08**2 / FLAG.size
    assert area == pytest.approx(FLAG.sum() * cell, rel=1e-6)
    np.testing.assert_allclose(mesh.vertices[:, 1], 0.57, atol=1e-7)


def test_its_rectangles_share_no_vertex(plane):
    mesh = cell_mesh(plane, FLAG)
    corners = mesh.faces.reshape(len(rectangles(FLAG)), 6)  # two triangles a rectangle
    assert all(len(set(part)) == 4 for part in corners.tolist())
    assert len(np.unique(corners)) == 4 * len(corners) == len(mesh.vertices)
