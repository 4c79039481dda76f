import numpy as np
import pytest

from periscopy_sim.analytic.point_light import point_light_response
from periscopy_sim.dataset.samples import lamp_light


def wall(count=57, seed=0):
    rng = np.random.default_rng(seed)
    points = np.stack([rng.uniform(-1, 1, count), np.zeros(count), rng.uniform(-1, 1, count)], 1)
    normals = np.stack([0.2 * rng.standard_normal(count), np.ones(count), np.zeros(count)], 1)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_lamps_add_up_as_eq_4_tells_each_scaled_to_its_mean(count):
    rng = np.random.default_rng(count)
    points, normals = wall()
    lamps = rng.uniform(-2, 2, (count, 3)) + np.array([0, 3, 0])
    powers = rng.random((count, 3))
    response = point_light_response(lamps, points, normals)
    expected = (response / response.mean(axis=0)) @ powers
    np.testing.assert_allclose(lamp_light(lamps, powers, points, normals), expected, rtol=1e-10)


def test_mean_is_the_sum_of_the_powers_and_lamps_behind_the_wall_are_dark():
    points, normals = wall()
    powers = np.array([[1.0, 2, 3], [4, 5, 6]])
    found = lamp_light(np.array([[0.0, 2, 0], [0, -50, 0]]), powers, points, normals)
    np.testing.assert_allclose(found.mean(axis=0), powers[0])
    both = lamp_light(np.array([[0.0, 2, 0], [1, 1, 1]]), powers, points, normals)
    np.testing.assert_allclose(both.mean(axis=0), powers.sum(axis=0))
