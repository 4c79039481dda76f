import numpy as np
import pytest

from periscopy_sim.analytic import point_light
from tests.scenes.boxes import make_scenario

FILM = (5, 7)
CENTER = np.array([0.74, 1.03, 0.26])
GRID = np.array([[0.3, 1.2, -0.4], [-2.0, 0.5, 1.0], [0.0, 3.0, 0.0]])
# In the coordinates of `make_scenario`, whose field of view has this middle.
LIGHTS = CENTER + np.array([[0.3, -1.2, -0.4], [-2.0, -0.5, 1.0], [0.0, -3.0, 0.0]])


def loop_response(lights, points, normals):
    """Eq. 4, one light and one point after the other."""
    response = np.zeros((len(points), len(lights)))
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        for j, light in enumerate(lights):
            away = [a - c for a, c in zip(light, point, strict=True)]
            height = sum(a * n for a, n in zip(away, normal, strict=True))
            response[i, j] = max(height, 0) / sum(a * a for a in away) ** 1.5
    return response


def random_surface(count, seed=0):
    """Points of a bumpy surface with unit normals of their own."""
    rng = np.random.default_rng(seed)
    points = np.array([30.0, -20.0, 10.0]) + rng.uniform(-1, 1, (count, 3))
    normals = rng.normal(size=(count, 3))
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def test_response_equals_eq_4_in_loops():
    points, normals = random_surface(40)
    lights = points[:25] + np.random.default_rng(1).normal(size=(25, 3)) * 3
    expected = loop_response(lights, points, normals)
    assert (expected == 0).sum() > 100 and (expected > 0).sum() > 100
    response = point_light.point_light_response(lights, points, normals)
    np.testing.assert_allclose(response, expected, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_light_on_any_point_of_the_wall_is_refused(seed):
    points, normals = random_surface(30, seed)
    for point in points:
        lights = np.stack([[31.0, -20.0, 25.0], point])
        with pytest.raises(ValueError, match="lies on the wall"):
            point_light.point_light_response(lights, points, normals)


def test_paper_grid_is_the_half_open_one_of_the_paper():
    sideways = [-3.0, -2.25, -1.5, -0.75, 0.0, 0.75, 1.5, 2.25]
    away = [1.0, 1.75, 2.5, 3.25, 4.0, 4.75, 5.5, 6.25]
    expected = [(x, y, z) for x in sideways for y in away for z in sideways]
    grid = point_light.paper_grid()
    assert grid.shape == (512, 3)
    np.testing.assert_array_equal(grid, expected)


def test_lights_stand_about_the_centre_of_the_field_of_view():
    scenario = make_scenario(film=FILM)
    np.testing.assert_allclose(
        point_light.point_light_backgrounds(scenario, GRID),
        loop_response(LIGHTS, scenario.view.centers, scenario.view.center_normals),
        rtol=1e-12,
    )


@pytest.mark.parametrize("grid", [np.ones(3), np.ones((4, 2)), GRID * [1, 0, 1], GRID * np.nan])
def test_grid_that_is_no_list_of_positions_before_the_wall_is_refused(grid):
    with pytest.raises(ValueError, match=r"a grid of lights is \(L, 3\)"):
        point_light.point_light_backgrounds(make_scenario(film=FILM), grid)
