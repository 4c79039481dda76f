from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.calibration import mask_depth
from periscopy_sim.calibration.mask_depth import Depth
from periscopy_sim.calibration.masks import MaskPlane
from periscopy_sim.calibration.prior import scene_covariance
from periscopy_sim.calibration.silhouette import recover_silhouette, write_masked_scene
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.load import load_geometry
from periscopy_sim.rendering.scene_files import read_document
from tests.scenes.silhouette import FLAG, HIDDEN, silhouette

FREE = {"depth_error": "0.08"}


@pytest.fixture
def free(scene):
    scenario = load_geometry(scene, HIDDEN, FREE)
    return Depth.of(scenario, "card", MaskPlane.of(scenario, "card"))


def test_a_depth_errs_as_the_numbers_that_move_the_shape_towards_the_wall(free, scenario, plane):
    assert free.ruler_error == pytest.approx(0.08 / 0.57, rel=1e-3)
    assert free.slopes == pytest.approx({"shift": 0, "depth": 0.57}, rel=1e-3, abs=1e-6)
    assert min(free.scales) == pytest.approx(np.exp(-2 * 0.08 / 0.57), rel=1e-3)
    known = Depth.of(scenario, "card", plane)
    assert known.scales == [1.0] and known.error == known.ruler_error == 0
    assert known.values == {"shift": 0} and not known.parameters


def test_a_plane_moves_as_the_errors_say_and_its_cells_are_found_again(free, plane):
    deeper = free.plane(1.1)
    away = np.array([0, 0.057, 0])
    np.testing.assert_allclose(deeper.corner, plane.corner + away, atol=1e-4)
    spot = np.zeros((8, 8))
    spot[2, 3] = 1.0
    (row, column), other = (2.5 / 8, 3.5 / 8), (16, 16)
    seen = deeper.seen_through(plane, free.monitor, spot, other)
    expected = free.monitor + 1.1 * (plane.points(np.array([column, row])) - free.monitor)
    brightest = np.add(np.unravel_index(seen.argmax(), other), 0.5)[::-1] / 16
    assert np.linalg.norm(deeper.points(brightest) - expected) < 0.08 / 16


class Bowl:
    """An end whose objective is least at a distance of 1.17."""

    def __init__(self, scale):
        self.scale = scale
        self.objective = 1000 * (np.log(scale / 1.17) / 0.1) ** 2 / 2


def test_the_least_objective_is_found_with_the_error_of_its_curvature(free):
    end, depth = free.refined(Bowl(1.0), lambda scale, _: Bowl(scale), lambda _: None)
    assert depth.scale == end.scale == pytest.approx(1.17, rel=mask_depth.KNOWN)
    assert depth.error == pytest.approx(1.17 * 0.1 / np.sqrt(1000), rel=0.05)


def test_depths_whose_shadows_are_out_of_view_are_left_out(free):
    def at(scale):
        if scale > 1 or nowhere:
            raise SceneError("no shadow")
        return [Bowl(scale)]

    nowhere = False
    ends = free.scanned(at)
    assert ends[0].scale == 1 and len(ends) == len(free.scales) // 2 + 1
    nowhere = True
    with pytest.raises(SceneError):
        free.scanned(at)


def test_the_file_has_the_plane_at_its_depth_and_the_depth_has_the_only_error(
    scene, free, tmp_path
):
    depth = replace(free, scale=1.2, error=0.036)
    moved = depth.plane(1.2)
    solution = replace(silhouette(moved, np.ones((1, 8), bool)), depth=depth)
    file, mesh = tmp_path / "masked.xml", tmp_path / "masked.ply"
    document = read_document(scene, FREE)
    write_masked_scene(document, solution, file, mesh, mesh.name)
    ours = MaskPlane.of(load_geometry(file, HIDDEN), "card")
    np.testing.assert_allclose(ours.corner, moved.corner, atol=1e-6)
    np.testing.assert_allclose(ours.across, moved.across, atol=1e-6)
    known, values = scene_covariance(read_document(file)), read_document(file).values
    assert float(values["depth"]) == pytest.approx(1.2 * 0.57, rel=1e-3)
    assert known.names == ("card_scale",) and known.errors == pytest.approx([0.03])
    assert float(values["depth_error"]) == float(values["shift_error"]) == 0
    far = MaskPlane.of(load_geometry(file, HIDDEN, {"card_scale": "1.1"}), "card")
    away = ours.corner - depth.monitor
    np.testing.assert_allclose(far.corner - depth.monitor, 1.1 * away, atol=1e-6)


@pytest.mark.thorough
def test_known_pictures_show_the_depth(scene, photographs, images):
    values = {"depth": "0.5", "size": "0.035", **FREE}
    solution = recover_silhouette(
        photographs, scene, HIDDEN, "card", FLAG.shape, shown=images, parameters=values
    )
    (depth,) = solution.parameters
    assert depth.name == "depth" and abs(depth.value - 0.57) < min(0.01, 4 * depth.standard_error)
    assert np.mean(solution.opaque == FLAG) > 0.95
