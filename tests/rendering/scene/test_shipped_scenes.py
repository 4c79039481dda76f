"""The scenes that are shipped, as they are read: where the published set-up has things."""

import numpy as np
import pytest

from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.scenario import EmissionProfile
from periscopy_sim.shipped import find_scene

CHAIR = find_scene("chair")


def on_grid(points, shape):
    return points.reshape(*shape, 3)


def test_chairs_photograph_covers_the_published_field_of_view():
    seen = load_scenario(CHAIR, (1, 1))
    assert seen.photograph_shape == (126, 126)
    grid = on_grid(seen.wall_points, (126, 126))
    pixel = 0.401 / 126
    np.testing.assert_allclose(grid[-1, 0], [0.543 + pixel / 2, 1.03, 0.064 + pixel / 2], atol=1e-6)
    np.testing.assert_allclose(grid[0, -1], [0.944 - pixel / 2, 1.03, 0.465 - pixel / 2], atol=1e-6)
    np.testing.assert_allclose(np.diff(grid[..., 0], axis=1), pixel, atol=1e-6)
    np.testing.assert_allclose(np.diff(grid[..., 2], axis=0), -pixel, atol=1e-6)


@pytest.mark.parametrize("name", ["chair", "plate"])
def test_hidden_patches_cover_the_published_rectangle_of_the_screen(name):
    seen = load_scenario(find_scene(name), (29, 36), {"resolution": 36})
    across, up = seen.patch_across / 2, seen.patch_up / 2
    upper_left = on_grid(seen.patch_centers - across + up, (29, 36))
    lower_right = on_grid(seen.patch_centers + across - up, (29, 36))
    np.testing.assert_allclose(upper_left[0, 0], [0.429, 0, 0.4445], atol=1e-6)
    np.testing.assert_allclose(lower_right[-1, -1], [0.027375, 0, 0.138711], atol=1e-6)
    x = np.linspace(0.429, 0.027375, 37)
    z = np.linspace(0.4445, 0.138711, 30)
    np.testing.assert_allclose(upper_left[..., 0], np.tile(x[:-1], (29, 1)), atol=1e-6)
    np.testing.assert_allclose(upper_left[..., 2], np.tile(z[:-1, None], (1, 36)), atol=1e-6)
    np.testing.assert_allclose(lower_right[..., 0], np.tile(x[1:], (29, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.patch_areas, 0.011156 * 0.010544, rtol=1e-4)
    assert seen.emission == EmissionProfile(18, 1)


def test_plates_photograph_covers_its_published_field_of_view():
    seen = load_scenario(find_scene("plate"), (1, 1), {"resolution": 10})
    grid = on_grid(seen.wall_points, (10, 10))
    pixel = 0.04372
    np.testing.assert_allclose(grid[-1, 0], [0.521 + pixel / 2, 1.03, 0.048 + pixel / 2], atol=1e-6)
    np.testing.assert_allclose(grid[0, -1], grid[-1, 0] + [9 * pixel, 0, 9 * pixel], atol=1e-6)


def test_chair_stands_where_it_was_measured():
    (chair,) = load_scenario(CHAIR, (1, 1), {"resolution": 1}).occluders
    assert chair.name == "chair"
    low, high = chair.vertices.min(axis=0), chair.vertices.max(axis=0)
    np.testing.assert_allclose(low, [0.506, 0.594, 0.0], atol=1e-6)
    np.testing.assert_allclose(high, [0.581, 0.669, 0.317], atol=1e-6)
    assert chair.faces.shape == (7 * 12, 3)
    edges = np.linalg.norm(np.diff(chair.vertices[chair.faces], axis=1), axis=2)
    assert edges.min() > 0.003
    assert edges.max() < 0.35


def test_parameters_move_the_occluder_and_the_monitor_by_just_so_much():
    size = {"resolution": 2}
    plain = load_scenario(CHAIR, (1, 2), size)
    shift = {"occluder_dx": 0.013, "occluder_dy": "-0.05", "occluder_dz": -0.02}
    moved = load_scenario(CHAIR, (1, 2), size | shift)
    np.testing.assert_allclose(
        moved.occluders[0].vertices - plain.occluders[0].vertices,
        np.tile([0.013, -0.05, -0.02], (len(plain.occluders[0].vertices), 1)),
        atol=1e-6,
    )
    np.testing.assert_array_equal(moved.patch_centers, plain.patch_centers)
    np.testing.assert_array_equal(moved.wall_points, plain.wall_points)
    moved = load_scenario(CHAIR, (1, 2), size | {"monitor_dx": 0.005, "monitor_dz": -0.011})
    np.testing.assert_allclose(
        moved.patch_centers - plain.patch_centers, [[0.005, 0, -0.011]] * 2, atol=1e-6
    )
    np.testing.assert_array_equal(moved.occluders[0].vertices, plain.occluders[0].vertices)
    assert moved.parameters == {"resolution": "2", "monitor_dx": "0.005", "monitor_dz": "-0.011"}


def test_plants_parameter_turns_the_monitor():
    plain, turned = (
        load_scenario(find_scene("plant"), (1, 1), {"monitor_turn": angle}).patch_normals[0]
        for angle in (0, -20)
    )
    np.testing.assert_allclose(plain, [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(
        turned, [np.sin(np.radians(20)), np.cos(np.radians(20)), 0], atol=1e-6
    )


def test_plants_photograph_has_the_size_that_is_set():
    small, whole = (
        load_scenario(find_scene("plant"), (1, 1), size)
        for size in ({"width": "18", "height": "14"}, {})
    )
    assert (small.photograph_shape, whole.photograph_shape) == ((14, 18), (112, 144))
    # Each of its pixels sees what 8 x 8 of the others see.
    points = whole.wall_points.reshape(14, 8, 18, 8, 3)[:, 3:5, :, 3:5].mean(axis=(1, 3))
    np.testing.assert_allclose(small.wall_points.reshape(14, 18, 3), points, atol=1e-4)
