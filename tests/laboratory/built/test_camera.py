"""Cameras as they are measured, against pinholes and rectangles."""

import numpy as np
import pytest

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.document import load_laboratory
from periscopy_sim.laboratory.scene_parts import corners_seen
from tests.laboratory.built.conftest import CAMERA, MONITOR, PERSPECTIVE, WALL


def test_rectified_picture_shows_its_rectangle(built):
    points = built(WALL, CAMERA, MONITOR).wall_points.reshape(12, 16, 3)
    x = 0.30 + 0.48 * (np.arange(16) + 0.5) / 16
    z = 0.12 + 0.30 * (11.5 - np.arange(12)) / 12
    expected = np.stack(np.broadcast_arrays(x, 1.1, z[:, None]), axis=2)
    np.testing.assert_allclose(points, expected, atol=3e-6)


def test_perspective_picture_is_that_of_a_pinhole(built):
    points = built(WALL, PERSPECTIVE % "target: [60 cm, 25 cm]", MONITOR).wall_points.reshape(
        12, 16, 3
    )
    eye, target = np.array([1.2, 0.1, 0.4]), np.array([0.6, 1.1, 0.25])
    ahead = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(ahead, [0, 0, 1])
    right /= np.linalg.norm(right)
    rays = points - eye
    seen = rays @ np.stack([right, np.cross(right, ahead), ahead], axis=1)
    across = np.tan(np.radians(10)) * (2 * (np.arange(16) + 0.5) / 16 - 1)
    up = np.tan(np.radians(10)) * 12 / 16 * (1 - 2 * (np.arange(12) + 0.5) / 12)
    np.testing.assert_allclose(points[..., 1], 1.1, atol=3e-6)
    np.testing.assert_allclose(seen[..., 0] / seen[..., 2], np.tile(across, (12, 1)), atol=3e-6)
    np.testing.assert_allclose(seen[..., 1] / seen[..., 2], np.tile(up, (16, 1)).T, atol=3e-6)


def test_corners_are_those_that_mitsuba_sees(built, tmp_path):
    """The centres of a picture of 2 x 2 pixels are the corners of one half as wide."""
    camera = PERSPECTIVE % "target: [60 cm, 25 cm], roll: 7 deg"
    points = built(WALL, camera, MONITOR, hidden=(1, 1), photograph=(2, 2)).wall_points
    half = np.degrees(2 * np.arctan(np.tan(np.radians(10)) / 2))
    narrow = (tmp_path / "lab.yaml").read_text().replace("view: 20 deg", f"view: {half} deg")
    (tmp_path / "narrow.yaml").write_text(narrow)
    expected = corners_seen(load_laboratory(tmp_path / "narrow.yaml").camera, 1.1)
    np.testing.assert_allclose(points[[0, 1, 3, 2]][:, [0, 2]], expected, atol=3e-6)


def test_camera_that_sees_beyond_the_wall_is_refused(built):
    camera = PERSPECTIVE.replace("20 deg", "120 deg") % "target: [-9 m, 25 cm]"
    with pytest.raises(ConfigurationError, match=r"lab.yaml: camera: .* beyond the wall's horizon"):
        built(WALL, camera, MONITOR)
