import numpy as np
import pytest

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.corners import aim_at_corners, corners_seen
from periscopy_sim.rendering.scene.load import load_scenario

POSITION, DISTANCE, FILM = np.array([1.6, 0.1, 0.45]), 1.05, (30, 40)
AIM = {"target_x": 0.7, "target_z": 0.3, "camera_roll": 7.0, "field_of_view": 24.0}
EXACT = np.zeros(3), np.zeros((4, 2))


def seen(**changes):
    return corners_seen(POSITION, DISTANCE, FILM, *{**AIM, **changes}.values())


def test_corners_are_those_that_mitsuba_sees(tmp_path):
    """The centres of a picture of 2 x 2 pixels are the corners of one half as wide."""
    scene = f"""<scene version="3.0.0">
      <sensor type="perspective" id="camera"><float name="fov" value="24"/>
        <string name="fov_axis" value="x"/><transform name="to_world"><rotate z="1" angle="7"/>
        <lookat origin="1.6, 0.1, 0.45" target="0.7, {DISTANCE}, 0.3" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="height" value="30"/><integer name="width" value="40"/>
        </film></sensor>
      <shape type="rectangle" id="wall"><transform name="to_world"><scale value="3"/>
        <rotate x="1" angle="90"/><translate y="{DISTANCE}"/></transform></shape>
      <shape type="rectangle" id="monitor"><transform name="to_world"><scale value="0.1"/>
        <rotate x="1" angle="-90"/></transform><emitter type="area">
        <rgb name="radiance" value="1"/></emitter></shape>
    </scene>"""
    (tmp_path / "room.xml").write_text(scene)
    points = load_scenario(tmp_path / "room.xml", (1, 1), photograph=(2, 2)).wall_points
    half = np.degrees(2 * np.arctan(np.tan(np.radians(12)) / 2))
    expected = seen(field_of_view=half)
    np.testing.assert_allclose(points[[0, 1, 3, 2]][:, [0, 2]], expected, atol=3e-6)


@pytest.mark.parametrize("roll", [-170.0, -40.0, 0.0, 7.0, 95.0])
def test_camera_is_found_from_what_it_sees(roll):
    aim = aim_at_corners(POSITION, DISTANCE, seen(camera_roll=roll), FILM, *EXACT)
    expected = list((AIM | {"camera_roll": roll}).values())
    np.testing.assert_allclose(aim.values, expected, rtol=0, atol=1e-5)
    assert aim.residual < 1e-7


@pytest.mark.thorough
def test_errors_are_those_of_many_noisy_measurements():
    """Each standard deviation over 400 draws is within 15 %: 4.2 of its own standard errors."""
    rng = np.random.default_rng(7)
    corner_errors, position_errors = np.full((4, 2), 0.004), np.array([0.01, 0.005, 0.008])
    told = aim_at_corners(POSITION, DISTANCE, seen(), FILM, position_errors, corner_errors)
    values = []
    for _ in range(400):
        measured = seen() + rng.normal(0, corner_errors)
        position = POSITION + rng.normal(0, position_errors)
        found = aim_at_corners(position, DISTANCE, measured, FILM, position_errors, corner_errors)
        values.append(found.values)
    spread = np.std(values, axis=0, ddof=1)
    np.testing.assert_allclose(spread, told.errors, rtol=0.15)


@pytest.mark.parametrize(
    "change",
    [
        lambda corners: corners[[1, 0, 3, 2]],  # mirrored
        lambda corners: corners + np.array([[0, 0], [0, 0], [0.1, 0.05], [0, 0]]),
    ],
)
def test_corners_that_no_camera_sees_are_refused(change):
    errors = np.full(3, 0.005), np.full((4, 2), 0.005)
    with pytest.raises(ConfigurationError, match="cannot see these corners"):
        aim_at_corners(POSITION, DISTANCE, change(seen()), FILM, *errors)


def test_corners_on_a_line_are_refused():
    line = np.stack([np.arange(4.0), 2 * np.arange(4.0)], axis=1)
    with pytest.raises(ConfigurationError, match="lie on a line"):
        aim_at_corners(POSITION, DISTANCE, line, FILM, *EXACT)
