import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from periscopy_sim.analytic.area_transport import analytic_transport
from periscopy_sim.errors import SceneError
from periscopy_sim.scenario import Scenario
from periscopy_sim.scene import Occluder
from tests.scenes.boxes import LAMBERTIAN, Box, changed, make_scenario
from tests.scenes.irradiance import polygon_irradiance


def tilt_monitor(scenario, degrees):
    """Turn the monitor about a vertical axis through its middle."""
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix().T
    middle = scenario.hidden.centers.mean(axis=0)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn.T, middle - turn.T @ middle
    return Scenario(scenario.view, scenario.hidden.moved({"monitor": motion}))


@pytest.mark.parametrize("degrees", [0, 25])
def test_an_unoccluded_lambertian_monitor_matches_lamberts_contour_formula(degrees):
    scenario = tilt_monitor(make_scenario(film=(3, 4), emission=LAMBERTIAN), degrees)
    A = analytic_transport(scenario)
    for i, point in enumerate(scenario.view.centers):
        for j, center in enumerate(scenario.hidden.centers):
            across, up = scenario.hidden.across[j] / 2, scenario.hidden.up[j] / 2
            corners = center + np.array([-across - up, across - up, across + up, up - across])
            irradiance = polygon_irradiance(point, scenario.view.center_normals[i], corners)
            assert A[i, j] == pytest.approx(0.8 / np.pi * irradiance, rel=1e-4)


def bent(values, amount=1e-4):
    """Vary values of points or patches across their first axis."""
    return values + amount * np.sin(np.arange(len(values)))[:, None] * [0, 1, 0]


def at(y):
    return (Box([0.45, y, 0.25], [0.1, 0.1, 0.1]).occluder("stool"),)


SCENE = make_scenario(at(0.5))  # which the model can treat
FOLDED = (
    SCENE.hidden.centers * [1, 0, 1] + [0, 0.2, 0] * np.array([0, 1.25, 0, 0, 1.25, 0])[:, None]
)
FINE = SCENE.hidden["monitor"].gauss  # of a surface that is not flat
BALLS = tuple(Box([0.45, 0.5, 0.25], [0.1] * 3).occluder(f"ball{k}") for k in range(22))
REFUSALS = [
    ({"view": {"reflectance": None}}, "'wall' is not diffuse"),
    ({"view": {"points": bent(SCENE.view.centers)[:, None]}}, "'wall' is not one plane"),
    ({"view": {"normals": bent(SCENE.view.center_normals)[:, None]}}, "'wall' is not one plane"),
    ({"scene": {"emission": {"monitor": None}}}, "'monitor' has no closed angular profile"),
    ({"monitor": {"centers": FOLDED, "curved": FINE}}, "'monitor' hides parts of itself"),
    ({"scene": {"occluders": (Occluder("ball", None, None),)}}, "'ball' has no triangles"),
    ({"monitor": {"curved": FINE}, "scene": {"occluders": BALLS}}, "'ball21' is one of 264"),
]


@pytest.mark.parametrize(("change", "words"), REFUSALS)
def test_what_the_model_cannot_treat_is_refused_by_name(change, words):
    with pytest.raises(SceneError, match=words) as refusal:
        analytic_transport(changed(SCENE, **change))
    assert "room.xml" in str(refusal.value)
    assert "render_transport" in str(refusal.value)
