import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import periscopy_sim as ps
from periscopy_sim.live.room import (
    _everything,
    _floor,
    _frame_of,
    _level_axes,
    _nearest_pixels,
    _pose,
)
from periscopy_sim.scenario import WallFrame


def test_photograph_seen_squarely_is_shown_pixel_by_pixel():
    scene = ps.load_scenario("plate", (3, 4), photograph=(10, 12))
    frame = _frame_of(scene)
    local = (scene.wall_points - frame.center) @ np.stack([frame.across, frame.up]).T
    sources, seen = _nearest_pixels(local, (10, 12))
    np.testing.assert_array_equal(sources.ravel(), np.arange(120))
    assert seen.all()


def test_photograph_of_an_oblique_camera_covers_what_it_sees():
    """A trapezoid of the wall: its corners are missing from the rectangle about it."""
    v, u = np.mgrid[0:20, 0:20] / 19 - 0.5
    local = np.stack([u * (1 + 0.5 * v), -v], axis=-1).reshape(-1, 2)
    sources, seen = _nearest_pixels(local, (20, 20))
    assert seen[-1].all() and not seen[0, 0] and not seen[0, -1] and seen[0, 10]
    assert sources[0, 10] // 20 == 0 and sources[-1, 10] // 20 == 19


def test_floor_lies_below_everything_and_ends_at_the_wall():
    scene = ps.load_scenario("chair", (3, 4), photograph=(10, 12))
    everything, frame = _everything(scene), _frame_of(scene)
    floor = _floor(everything, frame)
    np.testing.assert_allclose(floor[..., 2], everything[:, 2].min())
    away = (floor - frame.center) @ frame.normal
    assert away.min() == pytest.approx(0, abs=1e-6) and np.unique(away.round(6)).size > 5
    for axis in (0, 1):
        assert floor[..., axis].min() <= everything[:, axis].min() + 1e-6
        assert floor[..., axis].max() >= everything[:, axis].max() - 1e-6


@pytest.mark.parametrize("normal", [(0, -1, 0), (0.6, -0.8, 0), (0, -0.8, -0.6), (0, 0, -1)])
def test_level_axes_are_those_of_who_looks_at_the_wall(normal):
    """Of a ceiling, too, which has no level normal."""
    normal = np.array(normal, float)
    across = np.cross([0, 1.0, 0], normal) if normal[2] == -1 else np.cross([0, 0, 1.0], normal)
    across /= np.linalg.norm(across)
    frame = WallFrame(np.zeros(3), across, normal, np.cross(across, -normal))
    right, away = _level_axes(frame)
    np.testing.assert_allclose([right[2], away[2], right @ away], 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm([right, away], axis=1), 1)
    np.testing.assert_allclose(np.cross(right, -away), [0, 0, 1])
    if abs(normal[2]) < 1:
        assert away @ normal > 0
        np.testing.assert_allclose(right, across, atol=1e-12)


def test_pose_turns_an_image_upright():
    w, x, y, z = _pose(np.array([2.0, 0, 0]), np.array([0, 0, 0.5]))
    turn = Rotation.from_quat([x, y, z, w])
    np.testing.assert_allclose(turn.apply([1, 0, 0]), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turn.apply([0, 1, 0]), [0, 0, -1], atol=1e-12)
    assert turn.magnitude() == pytest.approx(np.pi / 2)
