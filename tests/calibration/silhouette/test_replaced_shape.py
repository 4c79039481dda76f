from dataclasses import replace

import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.masked_scene import local_coordinates, write_masked_scene
from periscopy_sim.calibration.silhouette.replaced_shape import with_mesh

from periscopy_sim.calibration.scene_covariance import is_calibrated, scene_covariance
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from tests.calibration.silhouette.conftest import FLAG, HIDDEN, SCENE, silhouette


def test_only_the_shape_is_replaced_and_its_place_and_material_stay(scene):
    text = with_mesh(scene, "card", "a & b.ply", {}, scene.parent)
    before, after = SCENE.split('<shape type="rectangle" id="card">')
    assert text.startswith(before)
    assert text.endswith(after[after.index("</shape>") :])
    assert 'value="a &amp; b.ply"' in text
    assert '<rotate z="1" angle="$turn"/>' in text
    assert '<rgb name="reflectance" value="0.1"/>' in text


def test_numbers_of_the_plugin_go(scene):
    text = with_mesh(scene, "ball", "ball.ply", {}, scene.parent)
    assert "radius" not in text
    assert "center" not in text


def test_a_shape_is_left_out_whole(empty):
    assert [occluder.name for occluder in empty.occluders] == ["ball"]


def test_a_shape_of_an_included_file_is_told_of(tmp_path):
    path = tmp_path / "outer.xml"
    path.write_text('<scene version="3.0.0"><include filename="inner.xml"/></scene>')
    (tmp_path / "inner.xml").write_text(SCENE)
    with pytest.raises(SceneError, match="'card' is not written in this file itself"):
        with_mesh(path, "card", None, {}, tmp_path)


def corners_of(path, values):
    scenario = load_scenario(path, HIDDEN, values)
    vertices = next(o.vertices for o in scenario.occluders if o.name == "card")
    return vertices[np.lexsort(vertices.round(6).T)]


def test_the_mask_moves_with_the_parameters_of_the_shape(flagged):
    here, there = (corners_of(flagged, {"shift": shift}) for shift in (0, 0.03))
    np.testing.assert_allclose(there - here, np.tile([0.03, 0, 0], (len(here), 1)), atol=1e-6)


def test_a_mask_found_in_a_moved_and_turned_shape_stands_where_it_was_found(scene, tmp_path):
    from periscopy_sim.calibration.silhouette.cells.mask_plane import mask_plane

    values = {"shift": "0.01", "turn": "20", "size": "0.05"}
    plane = mask_plane(load_scenario(scene, HIDDEN, values), "card")
    path, mesh = tmp_path / "moved.xml", tmp_path / "moved.ply"
    write_masked_scene(scene, silhouette(plane, np.ones_like(FLAG)), values, path, mesh, mesh.name)
    found = corners_of(path, {})  # the values are its defaults
    expected = plane.at(np.array([[0.0, 0], [0, 1], [1, 0], [1, 1]]))
    np.testing.assert_allclose(found, expected[np.lexsort(expected.round(6).T)], atol=1e-6)


@pytest.mark.parametrize("agreeing", [0, 9])
def test_a_scene_carries_that_its_silhouette_is_not_to_be_trusted(scene, plane, tmp_path, agreeing):
    path, mesh = tmp_path / "found.xml", tmp_path / "found.ply"
    found = replace(silhouette(plane, FLAG), agreeing=agreeing)
    write_masked_scene(scene, found, {}, path, mesh, mesh.name)
    known = scene_covariance(path)
    assert (known is not None and not known.trusted) == bool(found.doubts) == (agreeing == 0)
    assert not is_calibrated(load_scenario(path, HIDDEN))


def test_a_shape_scaled_to_nothing_is_told_of(tmp_path):
    flat = tmp_path / "flat.xml"
    flat.write_text(SCENE.replace('<scale value="$size"/>', '<scale x="0.04" y="0.04" z="0"/>'))
    with pytest.raises(SceneError, match="scales it to nothing"):
        local_coordinates(flat, "card", {})
