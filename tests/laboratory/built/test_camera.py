"""Cameras as they are measured, against pinholes and rectangles."""

import numpy as np
import pytest

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.rendering.scene.document import read_document
from tests.laboratory.built.conftest import CAMERA, MONITOR, PERSPECTIVE, WALL


def test_rectified_picture_shows_its_rectangle(built):
    points = built(WALL, CAMERA, MONITOR).wall_points.reshape(12, 16, 3)
    x = 0.30 + 0.48 * (np.arange(16) + 0.5) / 16
    z = 0.12 + 0.30 * (11.5 - np.arange(12)) / 12
    expected = np.stack(np.broadcast_arrays(x, 1.1, z[:, None]), axis=2)
    np.testing.assert_allclose(points, expected, atol=3e-6)


@pytest.mark.parametrize(
    "direction",
    [
        "target: [60 cm, 25 cm]",
        # The same, as angles.
        f"turn: {np.degrees(np.arctan2(0.6, 1.0)):.12f} deg, "
        f"tilt: {np.degrees(np.arctan2(-0.15, np.hypot(0.6, 1.0))):.12f} deg",
    ],
)
def test_perspective_picture_is_that_of_a_pinhole(built, direction):
    points = built(WALL, PERSPECTIVE % direction, MONITOR).wall_points.reshape(12, 16, 3)
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


def test_field_of_view_may_be_that_of_the_pictures_height(built, tmp_path):
    across = built(WALL, PERSPECTIVE % "target: [60 cm, 25 cm]", MONITOR).wall_points
    high = 2 * np.degrees(np.arctan(np.tan(np.radians(10)) * 12 / 16))
    camera = PERSPECTIVE.replace("field_of_view: 20 deg", f"vertical_field_of_view: {high} deg")
    up = built(WALL, camera % "target: [60 cm, 25 cm]", MONITOR).wall_points
    np.testing.assert_allclose(up, across, atol=3e-6)
    declared = read_document(tmp_path / "lab.xml").defaults
    assert declared["vertical_field_of_view_error"] == "1.0" and "field_of_view" not in declared


def test_camera_known_by_four_corners_is_the_one_that_sees_them(built, tmp_path):
    aimed = built(WALL, PERSPECTIVE % "target: [60 cm, 25 cm], roll: 3 deg", MONITOR)
    grid = built(
        WALL, PERSPECTIVE % "target: [60 cm, 25 cm], roll: 3 deg", MONITOR,
        photograph=(1000, 1000),
    ).wall_points.reshape(1000, 1000, 3)  # fmt: skip
    names = ("top_left", "top_right", "bottom_right", "bottom_left")
    ends = grid[[0, 0, -1, -1], [0, -1, -1, 0]]
    listed = ", ".join(
        f"{name}: [{x!r} m, {z!r} m]" for name, (x, _, z) in zip(names, ends.tolist(), strict=True)
    )
    camera = f"""camera: {{kind: corners, film: 12x16, position: [1.2 m, 10 cm, 40 cm],
         corners: {{{listed}}}}}
"""
    found = built(WALL, camera, MONITOR)
    # The pixels' centres lie half a thousandth of the picture within its corners.
    np.testing.assert_allclose(found.wall_points, aimed.wall_points, atol=5e-4)
    defaults = read_document(tmp_path / "lab.xml").defaults
    assert abs(float(defaults["camera_roll"]) - 3) < 0.01
    assert 0.001 < float(defaults["target_x_error"]) < 0.01
    assert 0.1 < float(defaults["field_of_view_error"]) < 1


def test_corners_that_contradict_each_other_are_refused(built):
    camera = """camera: {kind: corners, film: 12x16, position: [1.2 m, 10 cm, 40 cm],
      corners: {top_left: [0 m, 50 cm], top_right: [1 m, 50 cm], bottom_right: [60 cm, 0 m],
                bottom_left: [0 m, 0 m]}}
"""
    with pytest.raises(ConfigurationError, match=r"lab.yaml: camera: .* cannot see these corners"):
        built(WALL, camera, MONITOR)
    with pytest.raises(ConfigurationError, match="camera"):  # from behind the wall
        built(WALL, camera.replace("10 cm, 40", "1.2 m, 40"), MONITOR)
