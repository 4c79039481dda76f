import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import periscopy_sim as ps
from periscopy_sim.live.room import _frame_of, _nearest_pixels, _pose


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


def test_pose_turns_an_image_upright():
    w, x, y, z = _pose(np.array([2.0, 0, 0]), np.array([0, 0, 0.5]))
    turn = Rotation.from_quat([x, y, z, w])
    np.testing.assert_allclose(turn.apply([1, 0, 0]), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turn.apply([0, 1, 0]), [0, 0, -1], atol=1e-12)
    assert turn.magnitude() == pytest.approx(np.pi / 2)
