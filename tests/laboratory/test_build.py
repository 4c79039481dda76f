"""Scenes of measured laboratories: what Mitsuba builds of them, against plain trigonometry."""

import re
import struct

import numpy as np
import pytest

from periscopy_sim.errors import ConfigurationError, OutputError, SceneError
from periscopy_sim.laboratory.build import build_laboratory
from periscopy_sim.laboratory.document import EXAMPLE
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from periscopy_sim.shipped import find_scene

WALL = "errors: {length: 5 mm, angle: 1 deg}\nwall: {distance: 1.1 m +- 2 mm, reflectance: 0.6}\n"
CAMERA = """camera: {kind: rectified, film: 12x16, bottom_left: [30 cm, 12 cm], width: 48 cm,
         height: 30 cm}
"""
MONITOR = "monitor: {width: 40 cm, height: 30 cm, center: [5 cm, 1 cm, 31 cm]}\n"
HIDDEN = (2, 3)


def turned(points, tilt=0.0, turn=0.0):
    """Tilt about x and then turn about z, in degrees, about the origin."""
    x, y, z = np.asarray(points, float).T
    a, b = np.radians([tilt, turn])
    y, z = y * np.cos(a) - z * np.sin(a), y * np.sin(a) + z * np.cos(a)
    return np.stack([x * np.cos(b) - y * np.sin(b), x * np.sin(b) + y * np.cos(b), z], axis=1)


@pytest.fixture
def built(tmp_path):
    """Build a laboratory and load its scene."""

    def build(*parts, hidden=HIDDEN, **options):
        (tmp_path / "lab.yaml").write_text("".join(parts))
        scene, *_ = build_laboratory(tmp_path / "lab.yaml", tmp_path / "lab.xml")
        return load_scenario(scene, hidden, **options)

    return build


def corners_of(low, high):
    """The eight corners of a box, (8, 3)."""
    return np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1).T


def same_points(found, expected):
    def order(points):
        return points[np.lexsort(np.round(points, 5).T)]

    found = np.unique(np.round(found, 6), axis=0)
    np.testing.assert_allclose(order(found), order(np.asarray(expected, float)), atol=3e-6)


def test_example_builds_a_scene(built):
    scenario = built(EXAMPLE.read_text())
    assert [occluder.name for occluder in scenario.occluders] == [
        "foot", "stem", "shade", "picture_left", "picture_right", "picture_bottom", "picture_top",
    ]  # fmt: skip
    A = render_transport(scenario, samples=4)
    assert A.shape == (112 * 144, 6) and A.min() == 0 < A.max()  # something throws a shadow


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


def test_numbers_keep_their_precision(built, tmp_path):
    built(WALL.replace("1.1 m", "1.0123456789012 m"), CAMERA, MONITOR)
    assert read_document(tmp_path / "lab.xml").defaults["wall_distance"] == "1.0123456789012"


# -- the camera ----------------------------------------------------------------------------------


def test_rectified_picture_shows_its_rectangle(built):
    points = built(WALL, CAMERA, MONITOR).wall_points.reshape(12, 16, 3)
    x = 0.30 + 0.48 * (np.arange(16) + 0.5) / 16
    z = 0.12 + 0.30 * (11.5 - np.arange(12)) / 12
    expected = np.stack(np.broadcast_arrays(x, 1.1, z[:, None]), axis=2)
    np.testing.assert_allclose(points, expected, atol=3e-6)


PERSPECTIVE = """camera: {kind: perspective, film: 12x16, position: [1.2 m, 10 cm, 40 cm],
         field_of_view: 20 deg, %s}
"""


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
    with pytest.raises(ConfigurationError, match="behind the wall"):
        built(WALL, camera.replace("10 cm, 40", "1.2 m, 40"), MONITOR)


# -- the monitor ---------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt", [0, 10])
@pytest.mark.parametrize("turn", [0, -20])
@pytest.mark.parametrize(
    ("place", "across", "up"),
    [("center", 0, 0), ("top_left", 1, -1), ("bottom_left", 1, 1), ("top_right", -1, -1),
     ("bottom_right", -1, 1)],
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
    np.testing.assert_allclose(scenario.patch_centers, expected, atol=3e-6)
    normal = turned([(0, 1, 0)], tilt, turn)[0]
    np.testing.assert_allclose(scenario.patch_normals, np.tile(normal, (6, 1)), atol=3e-6)
    np.testing.assert_allclose(
        scenario.patch_across, np.tile(turned([(-0.4 / 3, 0, 0)], tilt, turn), (6, 1)), atol=3e-6
    )
    assert (normal[2] > 0) == (tilt > 0)  # tilted, it looks up


def test_falloff_is_the_monitors(built):
    plain, lcd = (built(WALL, CAMERA, MONITOR.replace("}", more)) for more in (
        "}", ", falloff: {vertical: 17 +- 2, horizontal: 1.5}}"
    ))  # fmt: skip
    assert (plain.emission.vertical, plain.emission.horizontal) == (0, 0)
    assert (lcd.emission.vertical, lcd.emission.horizontal) == (17, 1.5)


# -- occluders -----------------------------------------------------------------------------------

POSITION = np.array([0.2, 0.5, 0.05])


def occluders(kind, more):
    place = "position: [20 cm, 50 cm, 5 cm], turn: 25 deg, tilt: -15 deg"
    return f"occluders: [{{kind: {kind}, name: thing, {place}, {more}}}]\n"


@pytest.mark.parametrize(
    ("anchor", "low"),
    [("base", (-0.03, -0.01, 0)), ("center", (-0.03, -0.01, -0.05)), ("corner", (0, 0, 0))],
)
@pytest.mark.parametrize(("kind", "deep"), [("box", "depth"), ("plate", "thickness")])
def test_box_has_its_size_about_its_anchor(built, kind, deep, anchor, low):
    sizes = f"width: 6 cm, {deep}: 2 cm, height: 10 cm, anchor: {anchor}"
    (thing,) = built(WALL, CAMERA, MONITOR, occluders(kind, sizes)).occluders
    expected = turned(corners_of(low, np.add(low, (0.06, 0.02, 0.1))), -15, 25) + POSITION
    same_points(thing.vertices, expected)


def test_frame_is_four_bars_about_its_opening(built):
    sizes = "width: 6 cm, height: 10 cm, bar: 1 cm, thickness: 2 cm"
    bars = built(WALL, CAMERA, MONITOR, occluders("frame", sizes)).occluders
    expected = {
        "thing_left": [(-0.03, -0.01, 0), (-0.02, 0.01, 0.1)],
        "thing_right": [(0.02, -0.01, 0), (0.03, 0.01, 0.1)],
        "thing_bottom": [(-0.03, -0.01, 0), (0.03, 0.01, 0.01)],
        "thing_top": [(-0.03, -0.01, 0.09), (0.03, 0.01, 0.1)],
    }
    assert [bar.name for bar in bars] == list(expected)
    for bar in bars:
        same_points(bar.vertices, turned(corners_of(*expected[bar.name]), -15, 25) + POSITION)


@pytest.mark.parametrize(("anchor", "low"), [("base", 0.0), ("center", -0.05)])
def test_cylinder_is_round_and_closed(built, anchor, low):
    sizes = f"diameter: 6 cm, height: 10 cm, anchor: {anchor}"
    (thing,) = built(WALL, CAMERA, MONITOR, occluders("cylinder", sizes)).occluders
    upright = (thing.vertices - POSITION) @ turned(np.eye(3), -15, 25).T
    radius = np.hypot(upright[:, 0], upright[:, 1])
    rim = radius > 0.001
    np.testing.assert_allclose(radius[rim], 0.03, rtol=2e-4)
    np.testing.assert_allclose(np.unique(np.round(upright[:, 2], 5)), [low, low + 0.1], atol=1e-5)
    edges = np.concatenate([thing.faces[:, [0, 1]], thing.faces[:, [1, 2]], thing.faces[:, [2, 0]]])
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges) and {(b, a) for a, b in directed} == directed  # closed
    a, b, c = np.moveaxis(upright[thing.faces], 1, 0)
    volume = np.sum(a * np.cross(b, c)) / 6
    np.testing.assert_allclose(volume, np.pi * 0.03**2 * 0.1, rtol=1e-3)  # its outside is outside


def test_round_things_may_be_told_by_their_radius(built, tmp_path):
    by_diameter = "diameter: 6 cm +- 2 mm, height: 10 cm"
    by_radius = "height: 10 cm, radius: 3 cm +- 1 mm"
    one, other = (
        built(WALL, CAMERA, MONITOR, occluders("cylinder", sizes)).occluders[0].vertices
        for sizes in (by_diameter, by_radius)
    )
    np.testing.assert_allclose(one, other, atol=1e-6)
    assert read_document(tmp_path / "lab.xml").defaults["thing_radius_error"] == "0.001"
    ends = "kind: rod, name: rod, start: [20 cm, 40 cm, 15 cm], end: [30 cm, 50 cm, 35 cm]"
    texts = []
    for thick in ("diameter: 4 cm +- 2 mm", "radius: 2 cm +- 1 mm"):
        built(WALL, CAMERA, MONITOR, f"occluders: [{{{ends}, {thick}}}]\n")
        texts.append((tmp_path / "lab.xml").read_text())
    assert texts[0] == texts[1] and 'name="rod_radius" value="0.02"' in texts[0]


def test_rod_lies_between_its_ends(built):
    """Its shadow on the wall, from a small monitor, is that of the strip between its ends."""
    monitor = "monitor: {width: 1 mm, height: 1 mm, center: [10 cm, 0 m, 30 cm]}\n"
    rod = """occluders: [{kind: rod, name: rod, start: [20 cm, 40 cm, 15 cm],
             end: [30 cm, 50 cm, 35 cm], diameter: 4 cm}]
"""
    scenario = built(WALL, CAMERA.replace("12x16", "60x96"), monitor, rod, hidden=(1, 1))
    dark = render_transport(scenario, samples=1)[:, 0] == 0
    light = np.array([0.1, 0, 0.3])
    start, end = np.array([0.2, 0.4, 0.15]), np.array([0.3, 0.5, 0.35])
    along, length = (end - start) / np.linalg.norm(end - start), np.linalg.norm(end - start)
    rays = scenario.wall_points - light
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    # Closest approach of a ray and the rod's axis.
    cross = np.cross(rays, along)
    apart = np.abs((start - light) @ cross.T) / np.linalg.norm(cross, axis=1)
    where = np.einsum("ij,ij->i", np.cross(start - light, rays), cross)
    where /= np.sum(cross**2, axis=1)
    shadow = (where > 0.03) & (where < length - 0.03) & (apart < 0.019)
    assert shadow.sum() > 100 and dark[shadow].all()
    assert not dark[apart > 0.021].any()


BORNE = """occluders:
- {kind: box, name: bottle, position: [20 cm, 50 cm, 5 cm], turn: 25 deg, tilt: -15 deg,
   width: 6 cm, depth: 4 cm, height: 10 cm, anchor: center}
- {kind: box, name: neck, with: bottle, position: [1 cm, 0 cm, 5 cm], turn: 10 deg,
   width: 2 cm, depth: 1 cm, height: 3 cm}
- {kind: plate, name: flag, with: neck, position: [0 cm +- 1 mm, 0 cm, 3 cm], tilt: 5 deg,
   width: 4 cm, thickness: 2 mm, height: 2 cm}
- {kind: rod, name: straw, with: bottle, start: [0 cm, 0 cm, 5 cm], end: [2 cm, 1 cm, 15 cm],
   radius: 3 mm}
- {kind: rod, name: twin, start: [%s], end: [%s], radius: 3 mm}
"""


def test_what_stands_with_another_is_moved_by_its_numbers_alone(built, tmp_path):
    ends = turned([(0, 0, 0.05), (0.02, 0.01, 0.15)], -15, 25) + POSITION
    start, end = (", ".join(f"{x:.12f} m" for x in each) for each in ends)
    found = {
        each.name: each for each in built(WALL, CAMERA, MONITOR, BORNE % (start, end)).occluders
    }
    neck = turned(corners_of((-0.01, -0.005, 0), (0.01, 0.005, 0.03)), 0, 10) + np.array(
        [0.01, 0, 0.05]
    )
    same_points(found["neck"].vertices, turned(neck, -15, 25) + POSITION)
    flag = turned(corners_of((-0.02, -0.001, 0), (0.02, 0.001, 0.02)), 5, 0) + np.array(
        [0, 0, 0.03]
    )
    flag = turned(turned(flag, 0, 10) + np.array([0.01, 0, 0.05]), -15, 25) + POSITION
    same_points(found["flag"].vertices, flag)
    straw, twin = (found[name].bounds for name in ("straw", "twin"))
    np.testing.assert_allclose(straw, twin, atol=1e-5)
    declared = read_document(tmp_path / "lab.xml").defaults
    errors = {name for name in declared if name.endswith("_error")}
    own = {"neck_width_error", "neck_depth_error", "neck_height_error"}
    assert {name for name in errors if name.startswith("neck")} == own
    assert "flag_x_error" in errors and "flag_y_error" not in errors
    assert {"bottle_x_error", "bottle_turn_error", "straw_radius_error"} <= errors
    assert not {name for name in errors if name.startswith("straw_start")}
    moved = built(WALL, CAMERA, MONITOR, BORNE % (start, end), parameters={"bottle_x": "0.23"})
    for each in moved.occluders:
        there = 0.0 if each.name == "twin" else 0.03
        np.testing.assert_allclose(
            each.bounds - found[each.name].bounds, [(there, 0, 0)] * 2, atol=1e-6
        )


# -- meshes --------------------------------------------------------------------------------------

CORNERS = np.array([(100, 200, 10), (160, 200, 10), (100, 260, 10), (100, 200, 90)], "f4")
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])


@pytest.fixture
def tent(tmp_path):
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *c.ravel(), 0) for c in CORNERS[FACES])
    (tmp_path / "tent.stl").write_bytes(bytes(80) + struct.pack("<I", len(FACES)) + rows)


@pytest.mark.usefixtures("tent")
@pytest.mark.parametrize(
    ("up", "axes"), [("z", ((1, 0, 0), (0, 1, 0), (0, 0, 1))),
                     ("y", ((1, 0, 0), (0, 0, -1), (0, 1, 0))),
                     ("x", ((0, 1, 0), (0, 0, 1), (1, 0, 0)))],
)  # fmt: skip
@pytest.mark.parametrize("anchor", ["origin", "base", "center"])
def test_mesh_stands_in_metres_upright_at_its_anchor(built, up, axes, anchor):
    own = 0.001 * CORNERS.astype(float) @ np.transpose(axes)
    assert np.linalg.det(axes) == 1
    low, high = own.min(axis=0), own.max(axis=0)
    middle = {
        "origin": np.zeros(3),
        "center": (low + high) / 2,
        "base": np.array([*(low + high)[:2] / 2, low[2]]),
    }[anchor]
    more = f"file: tent.stl, unit: mm, up: {up}, anchor: {anchor}"
    (thing,) = built(WALL, CAMERA, MONITOR, occluders("mesh", more)).occluders
    same_points(thing.vertices, turned(own - middle, -15, 25) + POSITION)


@pytest.mark.usefixtures("tent")
def test_files_that_are_given_are_not_written_over(built, tmp_path):
    more = "file: lab_thing.ply, unit: mm"
    (tmp_path / "lab_thing.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    with pytest.raises(ConfigurationError, match=r"the file .* has no PLY header"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", more))
    built(WALL, CAMERA, MONITOR, occluders("mesh", "file: tent.stl, unit: mm"))
    before = (tmp_path / "lab_thing.ply").read_bytes()
    with pytest.raises(OutputError, match="it is one of the files given"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", more))
    assert (tmp_path / "lab_thing.ply").read_bytes() == before


@pytest.mark.parametrize(
    ("content", "said"),
    [(b"", "is empty"), (b"solid x\nendsolid x\n", "has no faces"), (b"\0" * 90, "is cut short")],
)
def test_mesh_that_is_none_is_refused_and_nothing_is_written(built, tmp_path, content, said):
    (tmp_path / "bad.stl").write_bytes(content)
    with pytest.raises(ConfigurationError, match=f"occluder 'thing': the file .*bad.stl' {said}"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", "file: bad.stl, unit: mm"))
    with pytest.raises(ConfigurationError, match="there is no file"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", "file: none.stl, unit: mm"))
    assert {path.name for path in tmp_path.iterdir()} == {"bad.stl", "lab.yaml"}


# -- the whole -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ((WALL, CAMERA, MONITOR.replace("}", ", turn: 180 deg}")), "the monitor faces away"),
        (
            (WALL, CAMERA, MONITOR.replace(" 1 cm", " 2 m").replace("}", ", turn: 180 deg}")),
            "the monitor is behind the wall",
        ),
        (
            (
                WALL,
                PERSPECTIVE % "target: [60 cm, 25 cm]",
                MONITOR,
                occluders("box", "width: 2 m, depth: 1 cm, height: 1 m"),
            ),
            "192 of 192 camera pixels miss the wall",
        ),
    ],
)
def test_laboratory_of_which_no_photograph_can_be_taken_is_refused(built, tmp_path, changed, said):
    with pytest.raises(SceneError, match=f"scene '{tmp_path}/lab.xml': .*{said}") as caught:
        built(*changed)
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["lab.yaml"]


def test_number_without_an_error_is_refused(built, tmp_path):
    with pytest.raises(ConfigurationError, match=r"lab.yaml: camera.bottom_left.x has no error; "):
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


def test_laboratory_of_the_chair_experiment_has_its_transport(built):
    """Mitsuba's points of the wall are the same to 1e-6 m; at the edges of shadows rays differ."""
    camera = """camera: {kind: rectified, film: 63x63, bottom_left: [54.3 cm, 6.4 cm],
         width: 40.1 cm, height: 40.1 cm}
"""
    monitor = """monitor: {width: 0.401625 m, height: 0.305789 m,
          center: [0.2281875 m, 0 m, 0.2916055 m], falloff: {vertical: 18, horizontal: 1}}
"""
    mesh = find_scene("chair").parent / "meshes" / "chair.ply"
    chair = f"""occluders: [{{kind: mesh, name: chair, file: '{mesh}', unit: m,
             position: [0.506 m, 59.4 cm, 24.2 cm]}}]
"""
    wall = "errors: {length: 5 mm}\nwall: {distance: 1.03 m}\n"
    ours = built(wall, camera, monitor, chair, hidden=(8, 10))
    theirs = load_scenario(find_scene("chair"), (8, 10), {"resolution": 63})
    np.testing.assert_allclose(ours.wall_points, theirs.wall_points, atol=3e-6)
    for name in ("patch_centers", "patch_normals", "patch_across", "patch_up"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), atol=1e-7)
    np.testing.assert_array_equal(ours.occluders[0].vertices, theirs.occluders[0].vertices)
    A, expected = (render_transport(scenario, samples=16) for scenario in (ours, theirs))
    assert np.linalg.norm(A - expected) < 2e-3 * np.linalg.norm(expected)
    assert np.mean(np.abs(A - expected) > 1e-4 * expected.max()) < 2e-3
