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
    areas = np.linalg.norm(np.cross(seen.patch_across, seen.patch_up), axis=1)
    np.testing.assert_allclose(areas, 0.011156 * 0.010544, rtol=1e-4)
    assert seen.emission == EmissionProfile(18, 1)


def boxes(name, **parameters):
    """Corners (2, 3) of each occluder's box, by name; each occluder is that box and no less."""
    found = {}
    seen = load_scenario(find_scene(name), (1, 1), {"resolution": 1, **parameters})
    for occluder in seen.occluders:
        low, high = occluder.vertices.min(axis=0), occluder.vertices.max(axis=0)
        assert len(np.unique(occluder.vertices, axis=0)) == 8 and len(occluder.faces) == 12
        a, b, c = occluder.vertices[occluder.faces].swapaxes(0, 1) - low
        volume = np.einsum("ni,ni", a, np.cross(b, c)) / 6
        np.testing.assert_allclose(volume, np.prod(high - low), rtol=1e-3)  # outwards, whole
        found[occluder.name] = np.stack([low, high])
    return found


def filled_millimetres(parts, origin, shape):
    """Which of the 1 mm cells from an origin have their middle in any box."""
    filled = np.zeros(shape, bool)
    for box in parts.values():
        low, high = 1000 * (box - origin)
        cells = (np.arange(n) + 0.5 for n in shape)
        x, y, z = ((at > a) & (at < b) for at, a, b in zip(cells, low, high, strict=True))
        filled |= x[:, None, None] & y[:, None] & z
    return filled


def test_chair_fills_the_published_millimetres_and_no_others():
    """Cells of 1 mm over the chair's 75 x 75 x 317, drawn part by part from the table."""
    shape, seat_top = (75, 75, 317), 242
    expected = np.zeros(shape, bool)
    expected[:, :, seat_top - 4 : seat_top] = True
    expected[:, 70:75, seat_top : seat_top + 75] = True
    for x in (slice(0, 15), slice(60, 75)):
        for y in (slice(0, 5), slice(70, 75)):
            expected[x, y, :seat_top] = True
    expected[15:60, :5, seat_top - 75 : seat_top - 60] = True
    filled = filled_millimetres(boxes("chair"), [0.506, 0.594, 0], shape)
    np.testing.assert_array_equal(filled, expected)


def test_chair_turns_and_stretches_as_one_about_the_middle_of_its_seats_top():
    given = {"occluder_turn": 30, "occluder_stretch_x": 1.1, "occluder_stretch_z": 0.9}
    size, pivot = {"resolution": 1}, np.array([0.5435, 0.6315, 0.242])
    plain, moved = (load_scenario(CHAIR, (1, 1), size | more).occluders for more in ({}, given))
    cos, sin = np.cos(np.radians(30)), np.sin(np.radians(30))
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    for before, after in zip(plain, moved, strict=True):
        expected = pivot + ((before.vertices - pivot) * [1.1, 1, 0.9]) @ turn.T
        np.testing.assert_allclose(after.vertices, expected, atol=1e-6)
