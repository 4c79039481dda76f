import numpy as np
import pytest
from periscopy_sim.analytic.shadow import connected_parts, is_convex

from periscopy_sim.calibration.silhouette.plane import (
    cell_mesh,
    fitted_cells,
    mask_plane,
    rectangles,
    require_coarse,
)
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from tests.calibration.silhouette.conftest import FLAG, HIDDEN


def test_it_is_the_rectangle_that_was_declared(plane):
    corners = plane.at(np.array([[0.0, 0.0], [1.0, 1.0]]))
    np.testing.assert_allclose(corners, [[0.47, 0.57, 0.31], [0.55, 0.57, 0.23]], atol=1e-6)
    assert plane.sides == pytest.approx((0.08, 0.08), abs=1e-6)


def test_a_turned_one_is_in_its_own_plane(scene):
    plane = mask_plane(load_scenario(scene, HIDDEN, {"turn": "30"}), "card")
    assert plane.sides == pytest.approx((0.08, 0.08), abs=1e-6)
    assert plane.across[1] / plane.across[0] == pytest.approx(np.tan(np.pi / 6), rel=1e-4)


def test_a_thick_shape_has_it_in_its_middle_parallel_to_the_wall(scene, tmp_path):
    thick = tmp_path / "thick.xml"
    thick.write_text(
        scene.read_text().replace('"rectangle" id="card"', '"cube" id="card"').replace(
            '<scale value="$size"/>', '<scale x="0.03" y="0.05" z="0.02"/>'
        )
    )  # fmt: skip
    plane = mask_plane(load_scenario(thick, HIDDEN), "card")
    # The way from the middle of the monitor to that of the wall goes aslant through 4 cm of it.
    aslant = 0.04 * np.array([0.29 - 0.27, 0.74 - 0.228]) / 1.03
    assert plane.sides == pytest.approx(np.array([0.1, 0.06]) + aslant, abs=1e-5)
    assert plane.corner[1] == pytest.approx(0.57, abs=1e-6)
    assert abs(plane.across[1]) + abs(plane.down[1]) < 1e-6


def test_it_tells_at_which_part_of_the_way_it_stands(plane, scenario):
    assert plane.part(scenario) == pytest.approx(0.46 / 1.03, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("wall", {}, "'wall' is no occluder"),
        ("monitor", {}, "'monitor' is no occluder"),
        ("crad", {}, "did you mean 'card'"),
        ("zebra", {}, "the occluders are"),
        ("card", {"depth": "1.05"}, "reaches through the wall"),
        ("card", {"depth": "-0.1"}, "behind the monitor"),
        ("card", {"shift": "2"}, "casts no shadow"),
        ("card", {"turn": "64"}, "edge on"),
    ],
)
def test_what_can_be_no_mask_is_told_of(scene, name, values, message):
    with pytest.raises(SceneError, match=message):
        mask_plane(load_scenario(scene, HIDDEN, values), name)


def test_cells_are_square_and_not_finer_than_pixels(plane, scenario):
    assert fitted_cells(plane) == (16, 16)
    require_coarse(scenario, plane, (8, 8))
    with pytest.raises(SceneError, match="ask for 13x13 at most"):
        require_coarse(scenario, plane, (16, 16))
    with pytest.raises(SceneError, match="two cells at least"):
        require_coarse(scenario, plane, (1, 1))


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


def test_its_parts_are_convex_and_share_no_vertex(plane):
    mesh = cell_mesh(plane, FLAG)
    parts = connected_parts(mesh.vertices, mesh.faces)
    assert len(parts) == len(rectangles(FLAG))
    assert all(is_convex(vertices, faces) for vertices, faces in parts)
