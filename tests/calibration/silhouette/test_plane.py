import numpy as np
import pytest

from periscopy_sim.calibration.masks import MaskPlane
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import load_scenario
from tests.scenes.silhouette import HIDDEN


def test_it_is_the_rectangle_that_was_declared(plane, scenario):
    corners = plane.points(np.array([[0.0, 0.0], [1.0, 1.0]]))
    np.testing.assert_allclose(corners, [[0.47, 0.57, 0.31], [0.55, 0.57, 0.23]], atol=1e-6)
    assert plane.sides == pytest.approx((0.08, 0.08), abs=1e-6)
    assert plane.fraction(scenario) == pytest.approx(0.46 / 1.03, rel=1e-5)
    rows, offsets = plane.rows_of_projection()
    np.testing.assert_allclose(corners @ rows.T + offsets, [[0, 0, 0], [1, 1, 0]], atol=1e-9)


def test_a_turned_one_is_in_its_own_plane(scene):
    plane = MaskPlane.of(load_scenario(scene, HIDDEN, {"turn": "30"}), "card")
    assert plane.sides == pytest.approx((0.08, 0.08), abs=1e-6)
    assert plane.across[1] / plane.across[0] == pytest.approx(np.tan(np.pi / 6), rel=1e-4)


@pytest.mark.parametrize(
    ("kind", "name", "values"),
    [
        ("rectangle", "wall", {}),
        ("rectangle", "crad", {}),
        ("sphere", "card", {}),
        ("cube", "card", {}),
        ("rectangle", "card", {"depth": "1.05"}),
        ("rectangle", "card", {"depth": "-0.1"}),
        ("rectangle", "card", {"turn": "66"}),
    ],
)
def test_what_can_be_no_mask_raises(scene, tmp_path, kind, name, values):
    file = tmp_path / "scene.xml"
    file.write_text(scene.read_text().replace('"rectangle" id="card"', f'"{kind}" id="card"'))
    with pytest.raises(SceneError, match=f"'{name}' is n"):
        MaskPlane.of(load_scenario(file, HIDDEN, values), name)


def test_cells_are_square_and_not_finer_than_pixels(plane, scenario):
    assert plane.square_cells() == (16, 16)
    assert plane.pixels_a_cell(scenario, (8, 8)) == pytest.approx(0.01 / (0.011 * 0.57 / 1.03))
    for cells in ((16, 16), (1, 1)):
        with pytest.raises(SceneError):
            plane.pixels_a_cell(scenario, cells)
