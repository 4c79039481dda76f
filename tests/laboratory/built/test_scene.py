import re

import numpy as np
import pytest

from periscopy_sim.errors import ConfigurationError, SceneError
from periscopy_sim.laboratory.document import EXAMPLE, build_laboratory, load_laboratory
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.rendering.shadow_rays import render_transport
from periscopy_sim.scenario import load_scenario
from periscopy_sim.scene import EmissionProfile
from periscopy_sim.shipped import find_scene
from tests.scenes.laboratory import CAMERA, MONITOR, PERSPECTIVE, WALL, occluders, turned


def test_names_of_files_are_no_markup_of_the_scene(tmp_path):
    measurements = tmp_path / "a---b-->\x01.yaml"
    measurements.write_text(EXAMPLE.read_text())
    written = build_laboratory(measurements, tmp_path / "$width & <b>.xml")
    assert read_document(written[0]).files == written


@pytest.mark.parametrize(
    ("monitor", "occluder", "said"),
    [
        (MONITOR.replace("}", ", turn: 180 deg}"), "", "'monitor' faces away"),
        (MONITOR, occluders("box", "width: 2 m, depth: 1 cm, height: 1 m"), "192 of 192 camera"),
    ],
)
def test_laboratory_of_which_no_photograph_can_be_taken_is_refused(
    built, tmp_path, monitor, occluder, said
):
    with pytest.raises(SceneError, match=f"scene '{tmp_path}/lab.xml': .*{said}") as caught:
        built(WALL, PERSPECTIVE % "target: [60 cm, 25 cm]", monitor, occluder)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["lab.yaml"]


CHAIR = [
    ("seat", (506, 594, 238), (75, 75, 4)),
    ("back", (506, 664, 242), (75, 5, 75)),
    ("leg_near_left", (506, 594, 0), (15, 5, 242)),
    ("leg_near_right", (566, 594, 0), (15, 5, 242)),
    ("leg_far_left", (506, 664, 0), (15, 5, 242)),
    ("leg_far_right", (566, 664, 0), (15, 5, 242)),
    ("crossbar", (506, 594, 167), (75, 5, 15)),
]
"""Boxes of the published chair: name, lowest corner and extents in millimetres."""


def test_laboratory_of_the_chair_experiment_has_its_transport(built):
    """Mitsuba's points of the wall are the same to 1e-6 m; at the edges of shadows rays differ."""
    camera = """camera: {kind: rectified, film: 63x63, bottom_left: [54.3 cm, 6.4 cm],
         width: 40.1 cm, height: 40.1 cm}
"""
    monitor = """monitor: {width: 0.401625 m, height: 0.305789 m,
          center: [0.2281875 m, 0 m, 0.2916055 m], falloff: {vertical: 18, horizontal: 1}}
"""
    chair = "occluders:\n" + "".join(
        f"  - {{name: {name}, kind: box, anchor: corner, "
        f"position: [{x} mm, {y} mm, {z} mm], width: {width} mm, depth: {depth} mm, "
        f"height: {height} mm}}\n"
        for name, (x, y, z), (width, depth, height) in CHAIR
    )
    wall = "errors: {length: 5 mm}\nwall: {distance: 1.03 m}\n"
    ours = built(wall, camera, monitor, chair, hidden=(8, 10))
    theirs, plate = (
        load_scenario(find_scene(name), (8, 10), {"resolution": 63}) for name in ("chair", "plate")
    )
    np.testing.assert_allclose(ours.view.centers, theirs.view.centers, atol=3e-6)
    for other in (theirs, plate):
        assert ours.scene.emission == other.scene.emission
        for name in ("centers", "normals", "across", "up"):
            mine, expected = (getattr(each.hidden, name) for each in (ours, other))
            np.testing.assert_allclose(mine, expected, atol=1e-7)
    for mine, other in zip(ours.scene.occluders, theirs.scene.occluders, strict=True):
        np.testing.assert_allclose(mine.bounds, other.bounds, atol=1e-7)
    A, expected = (render_transport(scenario, samples=16) for scenario in (ours, theirs))
    assert np.linalg.norm(A - expected) < 2e-3 * np.linalg.norm(expected)
    assert np.mean(np.abs(A - expected) > 1e-4 * expected.max()) < 2e-3


def test_every_number_is_a_default_with_its_error_beside_it(built, tmp_path):
    built(WALL, CAMERA, MONITOR.replace("5 cm, 1 cm", "-5.1 cm +- 2 cm, 1 cm +- 0 mm"))
    defaults = read_document(tmp_path / "lab.xml").defaults
    assert defaults["wall_distance"] == "1.1" and defaults["wall_distance_error"] == "0.002"
    assert defaults["monitor_x"] == "-0.051" and defaults["monitor_x_error"] == "0.02"
    assert defaults["view_width"] == "0.48" and defaults["view_width_error"] == "0.005"
    assert defaults["monitor_y"] == "0.01" and "monitor_y_error" not in defaults  # exact
    assert defaults["monitor_turn"] == "0.0" and "monitor_turn_error" not in defaults  # not given
    text = (tmp_path / "lab.xml").read_text()
    names = re.findall(r'<default name="(\w+)"', text)
    for name in names:
        if not name.endswith("_error"):
            assert f"${name}" in text, name
    assert max(map(len, text.splitlines())) <= 100


def test_number_without_an_error_is_refused(built, tmp_path):
    with pytest.raises(ConfigurationError, match=r"lab.yaml: camera.bottom_left.x, .*: no error"):
        built(WALL.partition("\n")[2], CAMERA, MONITOR)
    assert [path.name for path in tmp_path.iterdir()] == ["lab.yaml"]


def test_names_that_would_be_one_are_refused(built):
    box = "kind: box, position: [20 cm, 50 cm, 5 cm], width: 1 cm, depth: 1 cm, height: 1 cm"
    text = f"occluders: [{{name: a, {box}}}, {{name: a_x, {box}}}]\n"
    built(WALL, CAMERA, MONITOR, text)
    rod = "kind: rod, start: [20 cm, 50 cm, 5 cm], end: [20 cm, 60 cm, 5 cm], diameter: 1 cm"
    text = f"occluders: [{{name: a, {rod}}}, {{name: a_start, {box}}}]\n"
    with pytest.raises(ConfigurationError, match="two numbers of the scene would be called"):
        built(WALL, CAMERA, MONITOR, text)


@pytest.mark.parametrize(
    ("place", "across", "up", "turn", "tilt"),
    [("center", 0, 0, 0, 0), ("top_left", 1, -1, -20, 0), ("bottom_left", 1, 1, 0, 10),
     ("top_right", -1, -1, -20, 10), ("bottom_right", -1, 1, -20, 10)],
)  # fmt: skip
def test_monitor_stands_where_it_was_measured(built, place, across, up, turn, tilt):
    """A viewer's right is towards -x; `across` and `up` lead from the place to the centre."""
    monitor = f"""monitor: {{width: 40 cm, height: 30 cm, {place}: [5 cm, 1 cm, 31 cm],
          turn: {turn} deg, tilt: {tilt} deg}}
"""
    scenario = built(WALL, CAMERA, monitor)
    viewers_right = np.tile((np.arange(3) - 1) / 3 * 0.4, 2) + 0.2 * across
    height = np.repeat([0.075, -0.075], 3) + 0.15 * up
    flat = np.stack([-viewers_right, np.zeros(6), height], axis=1)
    expected = turned(flat, tilt, turn) + np.array([0.05, 0.01, 0.31])
    np.testing.assert_allclose(scenario.hidden.centers, expected, atol=3e-6)
    normal = turned([(0, 1, 0)], tilt, turn)[0]
    np.testing.assert_allclose(scenario.hidden.normals, np.tile(normal, (6, 1)), atol=3e-6)
    across = turned([(-0.4 / 3, 0, 0)], tilt, turn)
    np.testing.assert_allclose(scenario.hidden.across, np.tile(across, (6, 1)), atol=3e-6)
    assert (normal[2] > 0) == (tilt > 0)  # tilted, it looks up


def test_falloff_is_the_monitors(built):
    plain, lcd = (built(WALL, CAMERA, MONITOR.replace("}", more)) for more in (
        "}", ", falloff: {vertical: 17 +- 2, horizontal: 1.5}}"
    ))  # fmt: skip
    assert plain.scene.emission["monitor"] == EmissionProfile(0, 0)
    assert lcd.scene.emission["monitor"] == EmissionProfile(17, 1.5)


def test_perspective_picture_is_that_of_a_pinhole(built):
    scenario = built(WALL, PERSPECTIVE % "target: [60 cm, 25 cm]", MONITOR)
    points = scenario.view.centers.reshape(12, 16, 3)
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
    points = built(WALL, camera, MONITOR, hidden=(1, 1), photograph=(2, 2)).view.centers
    half = np.degrees(2 * np.arctan(np.tan(np.radians(10)) / 2))
    text = (tmp_path / "lab.yaml").read_text().replace("view: 20 deg", f"view: {half} deg")
    (tmp_path / "narrow.yaml").write_text(text)
    narrow = load_laboratory(tmp_path / "narrow.yaml")
    expected = narrow.camera.corners_seen(narrow.wall)
    np.testing.assert_allclose(points[[0, 1, 3, 2]][:, [0, 2]], expected, atol=3e-6)


def test_camera_that_sees_beyond_the_wall_is_refused(built):
    camera = PERSPECTIVE.replace("20 deg", "120 deg") % "target: [-9 m, 25 cm]"
    with pytest.raises(ConfigurationError, match=r"lab.yaml: camera: .* beyond the wall's horizon"):
        built(WALL, camera, MONITOR)
