import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from periscopy_sim.scenario import EmissionProfile


def on_grid(points, shape):
    return points.reshape(*shape, 3)


def test_two_sided_wall_is_seen_from_behind(room):
    two_sided = room.wall(f'<bsdf type="twosided">{room.diffuse}</bsdf>', angle=-90)
    seen = room.load(wall=two_sided)
    np.testing.assert_allclose(seen.wall_normals, np.tile([0, -1, 0], (30, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.wall_reflectance, 0.5, rtol=1e-6)


# -- the wall as the camera sees it ----------------------------------------------------------------


def test_orthographic_pixels_see_a_regular_grid_with_row_0_on_top(room):
    seen = room.load()
    assert seen.photograph_shape == (5, 6)
    x = 0.5 + 0.4 * (np.arange(6) + 0.5) / 6
    z = 0.3 - 0.4 * (np.arange(5) - 2) / 6
    grid = on_grid(seen.wall_points, (5, 6))
    np.testing.assert_allclose(grid[..., 0], np.tile(x, (5, 1)), atol=1e-6)
    np.testing.assert_allclose(grid[..., 1], 1, atol=1e-6)
    np.testing.assert_allclose(grid[..., 2], np.tile(z[:, None], (1, 6)), atol=1e-6)
    np.testing.assert_allclose(seen.wall_normals, np.tile([0, -1, 0], (30, 1)), atol=1e-6)


def test_perspective_pixels_see_what_a_pinhole_sees(room):
    origin, target, fov = np.array([1.3, -0.2, 0.6]), np.array([0.6, 1.0, 0.25]), 17.0
    camera = (
        f'<sensor type="perspective" id="camera"><float name="fov" value="{fov}"/>'
        '<string name="fov_axis" value="x"/><transform name="to_world">'
        '<lookat origin="1.3, -0.2, 0.6" target="0.6, 1, 0.25" up="0, 0, 1"/></transform>'
        '<film type="hdrfilm"><integer name="width" value="7"/>'
        '<integer name="height" value="4"/></film></sensor>'
    )
    seen = room.load(camera=camera)
    forward = (target - origin) / np.linalg.norm(target - origin)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    pixel = 2 * np.tan(np.radians(fov / 2)) / 7
    for row in range(4):
        for column in range(7):
            ray = forward + pixel * ((column - 3) * right + (1.5 - row) * up)
            hit = origin + ray * (1 - origin[1]) / ray[1]
            index = 7 * row + column
            np.testing.assert_allclose(seen.wall_points[index], hit, atol=3e-6)


# -- the hidden patches ----------------------------------------------------------------------------


def test_patches_run_from_a_viewers_upper_left(room):
    seen = room.load(hidden=(2, 3))
    x = 0.4 - 0.4 * (np.arange(3) + 0.5) / 3
    z = [0.375, 0.225]
    expected = [[x[c], 0, z[r]] for r in range(2) for c in range(3)]
    np.testing.assert_allclose(seen.patch_centers, expected, atol=1e-6)
    np.testing.assert_allclose(seen.patch_across, np.tile([-0.4 / 3, 0, 0], (6, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.patch_up, np.tile([0, 0, 0.15], (6, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.patch_normals, np.tile([0, 1, 0], (6, 1)), atol=1e-6)
    assert not seen.mirrored
    assert seen.emission == EmissionProfile(18, 1)


def test_tilted_and_scaled_monitor_carries_its_patches_along(room):
    seen = room.load(monitor=room.monitor(scale=(0.3, 0.05), turn=165, tilt=-25), hidden=(3, 2))
    turn = Rotation.from_euler("x", -25, degrees=True) * Rotation.from_euler("z", -15, degrees=True)
    right, up, normal = turn.apply([[-1, 0, 0], [0, 0, 1], [0, 1, 0]])
    np.testing.assert_allclose(seen.patch_across, np.tile(0.3 * right, (6, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.patch_up, np.tile(0.1 / 3 * up, (6, 1)), atol=1e-6)
    np.testing.assert_allclose(seen.patch_normals, np.tile(normal, (6, 1)), atol=1e-6)
    np.testing.assert_allclose(
        seen.patch_centers[0], [0.2, 0, 0.3] - 0.15 * right + 0.1 / 3 * up, atol=1e-6
    )
    areas = np.linalg.norm(np.cross(seen.patch_across, seen.patch_up), axis=1)
    np.testing.assert_allclose(areas, 0.01, rtol=1e-5)


@pytest.mark.parametrize(("flip", "turn", "width"), [(True, 0, 0.2), (False, 180, -0.2)])
def test_flipped_or_mirrored_rectangle_has_the_patches_of_a_plain_one(room, flip, turn, width):
    plain = room.load()
    other = room.load(monitor=room.monitor(flip=flip, turn=turn, scale=(width, 0.15)))
    for name in ("patch_centers", "patch_normals", "patch_across", "patch_up"):
        np.testing.assert_allclose(getattr(other, name), getattr(plain, name), atol=1e-6)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_curved_mesh_is_cut_into_patches_along_its_curve(room, flip, mirrored):
    monitor = room.curved_monitor(room.area, mirrored=mirrored, flip=flip)
    seen = room.load(monitor=monitor, hidden=(2, 8))
    assert seen.mirrored == mirrored
    # Patches of two facets each; their middles lie on the seams, 0.4 rad to either side at most.
    angle = 0.8 * ((np.arange(8) + 0.5) / 8 - 0.5)
    x, y = 0.2 - 0.5 * np.sin(angle), 0.5 - 0.5 * np.cos(angle)
    expected = [[x[c], y[c], z] for z in (0.375, 0.225) for c in range(8)]
    np.testing.assert_allclose(seen.patch_centers, expected, atol=1e-6)
    facet = 2 * 0.5 * np.sin(0.025)
    areas = np.linalg.norm(np.cross(seen.patch_across, seen.patch_up), axis=1)
    np.testing.assert_allclose(areas, 2 * facet * 0.15, rtol=1e-5)
    towards_axis = np.array([0.2, 0.5]) - seen.patch_centers[:, :2]
    assert np.all(np.sum(seen.patch_normals[:, :2] * towards_axis, axis=1) > 0.499 * np.cos(0.026))
    assert np.all(seen.patch_across[:, 0] < 0)


# -- occluders -------------------------------------------------------------------------------------


def test_shapes_without_ids_are_occluders_of_their_own(room):
    cube = (
        '<shape type="cube"><transform name="to_world"><scale value="0.01"/>{}</transform>'
        f"{room.black}</shape>"
    )
    low, high = room.load(cube.format(""), cube.format('<translate y="0.5"/>')).occluders
    assert low.name != high.name
    assert high.vertices[:, 1].min() - low.vertices[:, 1].max() == pytest.approx(0.48, abs=1e-6)
