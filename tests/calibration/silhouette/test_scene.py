import numpy as np
import pytest

from periscopy_sim.calibration.masks import MaskPlane
from periscopy_sim.calibration.prior import scene_covariance
from periscopy_sim.calibration.silhouette import cell_mesh, write_masked_scene
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scenario import load_scenario
from tests.scenes.silhouette import FLAG, HIDDEN, SCENE, silhouette


def test_only_the_shape_is_replaced_and_its_place_and_material_stay(scene, plane, tmp_path):
    copy, mesh = tmp_path / "masked.xml", tmp_path / "masked.ply"
    write_masked_scene(read_document(scene), silhouette(plane, FLAG), copy, mesh, "a & $turn.ply")
    text = copy.read_text("utf-8").strip()
    before, after = SCENE.split('<shape type="rectangle" id="card">')
    assert text.partition('<shape type="ply" id="card">')[0].endswith(before.partition(">")[2])
    assert text.endswith(after[after.index("</shape>") :].strip())
    assert 'value="a &amp; \\$turn.ply"' in text
    assert '<rotate z="1" angle="$turn"/>' in text
    assert '<rgb name="reflectance" value="0.1"/>' in text


def test_a_shape_of_an_included_file_raises(plane, tmp_path):
    copy, mesh = tmp_path / "masked.xml", tmp_path / "masked.ply"
    path = tmp_path / "outer.xml"
    path.write_text('<scene version="3.0.0"><include filename="inner.xml"/></scene>')
    (tmp_path / "inner.xml").write_text(SCENE)
    with pytest.raises(SceneError, match="'card'"):
        write_masked_scene(read_document(path), silhouette(plane, FLAG), copy, mesh, mesh.name)


def corners_of(path, values):
    scenario = load_scenario(path, HIDDEN, values)
    vertices = next(o.vertices for o in scenario.scene.occluders if o.name == "card")
    return vertices[np.lexsort(vertices.round(6).T)]


def test_the_mask_moves_with_the_parameters_of_the_shape(flagged):
    here, there = (corners_of(flagged, {"shift": shift}) for shift in (0, 0.03))
    np.testing.assert_allclose(there - here, np.tile([0.03, 0, 0], (len(here), 1)), atol=1e-6)


def test_a_mask_of_a_moved_and_turned_shape_stands_where_its_plane_does(scene, tmp_path):
    values = {"shift": "0.01", "turn": "20", "size": "0.05"}
    plane = MaskPlane.of(load_scenario(scene, HIDDEN, values), "card")
    path, mesh = tmp_path / "moved.xml", tmp_path / "moved.ply"
    solution = silhouette(plane, np.ones((1, 8), bool))
    write_masked_scene(read_document(scene, values), solution, path, mesh, mesh.name)
    ours = corners_of(path, {})  # the values are its defaults
    expected = plane.points(np.array([[0.0, 0], [0, 1], [1, 0], [1, 1]]))
    np.testing.assert_allclose(ours, expected[np.lexsort(expected.round(6).T)], atol=1e-6)


@pytest.mark.parametrize("opacity", [1.0, 0.5])
def test_a_scene_carries_that_its_silhouette_is_not_to_be_trusted(scene, plane, tmp_path, opacity):
    path, mesh = tmp_path / "masked.xml", tmp_path / "masked.ply"
    mask = np.where(np.arange(64).reshape(8, 8) % 2, opacity, 1.0)
    solution = silhouette(plane, mask)
    write_masked_scene(read_document(scene), solution, path, mesh, mesh.name)
    known = scene_covariance(read_document(path))
    assert (known is not None and not known.trusted) == bool(solution.doubts) == (opacity < 1)


def test_the_mesh_has_the_area_of_its_cells_and_its_rectangles_share_no_vertex(plane):
    mesh = cell_mesh(plane, FLAG)
    edges = np.diff(mesh.vertices[mesh.faces], axis=1)
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2
    assert area == pytest.approx(FLAG.sum() * 0.08**2 / FLAG.size, rel=1e-6)
    np.testing.assert_allclose(mesh.vertices[:, 1], 0.57, atol=1e-7)
    assert len(mesh.faces) / 2 == len(mesh.vertices) / 4 == 6  # a rectangle for each row's run
