import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import periscopy_sim as ps
from periscopy_sim.live.room import on_rectangle, pose_of


def test_photograph_seen_squarely_is_shown_pixel_by_pixel():
    scene = ps.load_scenario("plate", (3, 4), photograph=(10, 12))
    frame = scene.view.frame
    local = (scene.view.centers - frame.center) @ np.stack([frame.across, frame.up]).T
    pixels = np.random.default_rng(0).integers(0, 256, (10, 12, 3), np.uint8)
    image, low, high = on_rectangle(local, pixels)
    np.testing.assert_array_equal(image[..., :3], pixels)
    assert (image[..., 3] == 255).all()
    np.testing.assert_allclose((low + high) / 2, local.mean(axis=0), atol=1e-6)


def test_photograph_of_an_oblique_camera_covers_what_it_sees():
    """A trapezoid of the wall: its corners are missing from the rectangle about it."""
    v, u = np.mgrid[0:20, 0:20] / 19 - 0.5
    local = np.stack([u * (1 + 0.5 * v), -v], axis=-1).reshape(-1, 2)
    pixels = np.broadcast_to(np.arange(20, dtype=np.uint8)[:, None, None], (20, 20, 3))
    image, _, _ = on_rectangle(local, pixels)
    seen = image[..., 3] == 255
    assert seen[-1].all() and not seen[0, 0] and not seen[0, -1] and seen[0, 10]
    assert image[0, 10, 0] == 0 and image[-1, 10, 0] == 19


def test_pose_turns_an_image_upright():
    w, x, y, z = pose_of(np.array([2.0, 0, 0]), np.array([0, 0, 0.5]))
    turn = Rotation.from_quat([x, y, z, w])
    np.testing.assert_allclose(turn.apply([1, 0, 0]), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turn.apply([0, 1, 0]), [0, 0, -1], atol=1e-12)
    assert turn.magnitude() == pytest.approx(np.pi / 2)
