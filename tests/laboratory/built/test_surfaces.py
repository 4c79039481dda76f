"""Hidden surfaces other than a monitor, walls that lie, and what doorways and corners hide."""

import re

import numpy as np
import pytest

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.document import EXAMPLE, build_laboratory, load_laboratory
from periscopy_sim.rendering.load import load_scene
from periscopy_sim.rendering.scene_files import read_document, read_mesh
from periscopy_sim.rendering.shadow_rays import render_transport
from periscopy_sim.scenario import load_scenario
from periscopy_sim.shipped import scenes_folder
from tests.scenes.laboratory import CAMERA, KINDS, MONITOR, WALL, corners_of, same_points, turned

EXACT = "errors: {length: 5 mm, angle: 1 deg}\n"

CAP = """hidden: [{kind: angular, name: room, position: [5 cm, 1 cm, 20 cm], radius: 40 cm, %s}]
"""


def cap_of(built, folder, numbers, size):
    """Directions of an angular surface's patches from its middle, and solid angles of its facets.

    The latter are those of two spherical triangles, by Van Oosterom and Strackee's formula.
    """
    scenario = built(WALL, CAMERA, CAP % numbers, hidden=size, photograph=(24, 24))
    surface = scenario.hidden["hidden_room"]
    ways = surface.centers - np.array([0.05, 0.01, 0.2])
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 0.4, rtol=2e-3)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    assert (np.sum(ways * surface.normals, axis=1) < -0.99).all()  # towards its middle
    assert (np.sum(np.cross(surface.across, surface.up) * surface.normals, axis=1) > 0).all()
    mesh = read_mesh(folder / "lab_hidden_room.ply")
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    across = 1 + np.sum(a * b, axis=1) + np.sum(b * c, axis=1) + np.sum(c * a, axis=1)
    halves = 2 * np.arctan2(np.abs(np.sum(a * np.cross(b, c), axis=1)), across)
    angles = halves.reshape(2, -1).sum(axis=0)
    columns = np.count_nonzero(np.isclose(mesh.texture_coordinates[:, 1], 0)) - 1
    return ways.reshape(*size, 3), angles.reshape(-1, columns)


def test_angular_surface_has_the_solid_angles_of_its_angles(built, tmp_path):
    """Of azimuths a to a' and elevations e to e': (a' - a) (sin e' - sin e)."""
    numbers = "azimuth: [-150 deg, -30 deg], elevation: [-20 deg, 60 deg]"
    ways, angles = cap_of(built, tmp_path, numbers, (16, 12))
    azimuth = np.degrees(np.arctan2(ways[..., 1], ways[..., 0]))
    elevation = np.degrees(np.arcsin(ways[..., 2]))
    expected = -30 - 10 * (np.arange(12) + 0.5), 60 - 5 * (np.arange(16) + 0.5)
    np.testing.assert_allclose(azimuth, np.tile(expected[0], (16, 1)), atol=0.03)
    np.testing.assert_allclose(elevation, np.tile(expected[1], (12, 1)).T, atol=0.03)
    ends = np.sin(np.radians(np.linspace(-20, 60, len(angles) + 1)))
    exact = np.radians(120 / angles.shape[1]) * np.diff(ends)
    np.testing.assert_allclose(angles, np.tile(exact, (angles.shape[1], 1)).T, rtol=2e-3)


def test_projected_angular_surface_has_the_solid_angles_of_a_window(built, tmp_path):
    """Through a window at x = 1, by atan(y z / sqrt(1 + y^2 + z^2)) at its corners; turned."""
    numbers = (
        "azimuth: [0 deg, 80 deg], elevation: [-80 deg, -30 deg], projected: true, turn: -130 deg"
    )
    ways, angles = cap_of(built, tmp_path, numbers, (20, 16))
    ways = turned(ways.reshape(-1, 3), 0, 130).reshape(ways.shape)
    azimuth = np.degrees(np.arctan2(ways[..., 1], ways[..., 0]))
    projected = np.degrees(np.arctan2(ways[..., 2], ways[..., 0]))
    np.testing.assert_allclose(azimuth, np.tile(77.5 - 5 * np.arange(16), (20, 1)), atol=0.06)
    expected = -31.25 - 2.5 * np.arange(20)
    np.testing.assert_allclose(projected, np.tile(expected, (16, 1)).T, atol=0.06)
    rows, columns = angles.shape
    y = np.tan(np.radians(np.linspace(80, 0, columns + 1)))
    z = np.tan(np.radians(np.linspace(-80, -30, rows + 1)))[:, np.newaxis]
    corner = np.arctan(y * z / np.sqrt(1 + y**2 + z**2))
    exact = np.abs(np.diff(np.diff(corner, axis=0), axis=1))
    np.testing.assert_allclose(angles, exact, rtol=1e-4)


STANDING = """wall: {distance: 1.1 m +- 2 mm, reflectance: 0.6}
camera: {kind: %s}
hidden:
 - {kind: screen, name: left, width: 40 cm, height: 30 cm, center: [5 cm, 1 cm, 31 cm],
    falloff: {vertical: 3, horizontal: 1}}
 - {kind: card, name: right, width: 20 cm, height: 30 cm, center: [60 cm, 20 cm, 31 cm]}
occluders:
 - {kind: box, name: thing, position: [40 cm, 55 cm, 20 cm], anchor: center, width: 9 cm,
    depth: 6 cm, height: 8 cm}
"""
CAMERAS = {
    "rectified": "rectified, film: 12x16, bottom_left: [30 cm, %s], width: 48 cm, height: 30 cm",
    "perspective": """perspective, film: 12x16, position: [55 cm, %s], target: [50 cm, %s],
 field_of_view: 30 deg, roll: 20 deg""",
}


def lying(kind, camera):
    """The laboratory of STANDING turned about x by 90 degrees, so that its wall lies.

    A floor: (x, y, z) -> (x, z, 1.1 - y); a ceiling: (x, y, z) -> (x, -z, y - 1.1). A monitor that
    faces along y, its top up, faces down with its top along y, or up with its top along -y.
    """
    s = 1 if kind == "floor" else -1
    tilt = -90 * s

    def place(x, y, z):
        return f"[{x} cm, {s * z} cm, {s * (110 - y)} cm]"

    text = STANDING.replace("distance: 1.1 m", f"kind: {kind}, height: 0 m")
    for own in ((5, 1, 31), (60, 20, 31), (40, 55, 20)):
        x, y, z = own
        text = text.replace(f"[{x} cm, {y} cm, {z} cm]", place(x, y, z) + f", tilt: {tilt} deg")
    numbers = {
        "rectified": f"{s * 12} cm",
        "perspective": (f"{s * 27} cm, {s * 60} cm", f"{s * 25} cm"),
    }
    return EXACT + text % (CAMERAS[camera] % numbers[camera])


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("kind", ["floor", "ceiling"])
def test_laboratory_turned_until_its_wall_lies_has_the_same_matrices(built, kind, camera):
    """The perspective camera looks nearly straight, so that its picture's top turns as well."""
    sizes = {"hidden_left": (3, 4), "hidden_right": (2, 2)}
    upright = {"rectified": "12 cm", "perspective": ("50 cm, 27 cm", "25 cm")}[camera]
    first = built(EXACT + STANDING % (CAMERAS[camera] % upright), hidden=sizes)
    one = render_transport(first, samples=16), point_light_backgrounds(first)
    other = built(lying(kind, camera), hidden=sizes)
    s = 1 if kind == "floor" else -1
    expected = (first.view.centers - [0, 1.1, 0])[:, [0, 2, 1]] * [1, s, -s]
    np.testing.assert_allclose(other.view.centers, expected, atol=1e-6)
    two = render_transport(other, samples=16), point_light_backgrounds(other)
    for A, B in zip(one, two, strict=True):
        assert np.linalg.norm(A - B) < 3e-3 * np.linalg.norm(A)
    assert np.count_nonzero(np.abs(one[0] - two[0]) > 1e-4 * one[0].max()) < 0.01 * one[0].size


@pytest.mark.parametrize(("kind", "height"), [("floor", -0.2), ("ceiling", 2.5)])
def test_oblique_camera_has_up_at_the_top_of_a_wall_that_lies(built, tmp_path, kind, height):
    """The middle row has the target; a floor's top row is the farthest, a ceiling's nearest."""
    up = kind == "ceiling"
    text = f"""wall: {{kind: {kind}, height: {height} m}}
camera: {{kind: perspective, film: 13x17, position: [1 m, -1 m, 1.2 m], target: [40 cm, 60 cm],
 field_of_view: 25 deg, roll: 4 deg}}
monitor: {{width: 20 cm, height: 20 cm, center: [0 m, -1 m, 1 m], tilt: {70 if up else -70} deg}}
"""
    scenario = built(EXACT, text, hidden=(1, 1))
    points = scenario.view.centers.reshape(13, 17, 3)
    np.testing.assert_allclose(points[..., 2], height, atol=2e-6)
    np.testing.assert_allclose(points[6, 8], [0.4, 0.6, height], atol=1e-5)
    far = np.linalg.norm(points[[0, 12], 8] - [1, -1, 1.2], axis=1)
    assert (far[0] < far[1]) == up
    seen = load_laboratory(tmp_path / "lab.yaml")
    corners = seen.camera.corners_seen(seen.wall)
    ends = scenario.view.corners[1][:, :2]  # of the centres of the corner pixels
    off = np.linalg.norm(ends - corners, axis=1)
    assert (off < 0.08 * np.linalg.norm(corners[0] - corners[2])).all()
    assert (np.linalg.norm(corners - points[6, 8, :2], axis=1)
            > np.linalg.norm(ends - points[6, 8, :2], axis=1)).all()  # fmt: skip


def test_edge_and_doorway_have_their_corners_at_their_places(built):
    parts = """occluders:
 - {kind: edge, name: end, position: [90 cm, 40 cm, 0 m], turn: 30 deg, width: 2 m, height: 1 m}
 - {kind: doorway, name: door, position: [2 m, 60 cm, 90 cm], turn: 20 deg, tilt: 5 deg,
    width: 80 cm, height: 2 m, jamb: 1 m, lintel: 30 cm, thickness: 10 cm}
"""
    end, *door = built(WALL, CAMERA, MONITOR, parts).scene.occluders
    plane = turned([(0, 0, 0), (2, 0, 0), (0, 0, 1), (2, 0, 1)], 0, 30)
    same_points(end.vertices, plane + np.array([0.9, 0.4, 0]))
    expected = {
        "door_jamb": [(-1, -0.05, -2), (0, 0.05, 0)],
        "door_lintel": [(0, -0.05, 0), (0.8, 0.05, 0.3)],
        "door_corner": [(-1, -0.05, 0), (0, 0.05, 0.3)],
    }
    assert [part.name for part in door] == list(expected)
    for part in door:
        box = turned(corners_of(*expected[part.name]), 5, 20)
        same_points(part.vertices, box + np.array([2, 0.6, 0.9]))


def test_numbers_of_an_angular_surface_are_exact_and_its_radius_is_called_a_choice(built, tmp_path):
    built(WALL, CAMERA, CAP % "azimuth: [-90 deg, -30 deg], elevation: [0 deg, 60 deg]")
    defaults = read_document(tmp_path / "lab.xml").defaults
    assert defaults["hidden_room_radius"] == "0.4"
    assert not [name for name in defaults if re.fullmatch("hidden_room_.*_error", name)]
    assert "The radius is a choice" in re.sub(r"\s+", " ", (tmp_path / "lab.xml").read_text())


def test_angles_of_no_surface_are_refused(built):
    for numbers, said in [
        ("radius: 40 cm +- 1 cm, azimuth: [0 deg, 9 deg], elevation: [0 deg, 9 deg]",
         r"hidden\[0\].radius: this number is a choice, not a measurement"),
        ("radius: 40 cm, azimuth: [9 deg, 0 deg], elevation: [0 deg, 9 deg]", "that increase"),
        ("radius: 40 cm, azimuth: [0 deg, 360 deg], elevation: [0 deg, 9 deg]", "full turn"),
        ("radius: 40 cm, azimuth: [0 deg, 9 deg], elevation: [0 deg, 90 deg]", "within 89 deg"),
        ("radius: 40 cm, azimuth: [0 deg, 90 deg], elevation: [0 deg, 9 deg], projected: true",
         "within 89 deg"),
    ]:  # fmt: skip
        cap = f"hidden: [{{kind: angular, name: room, position: [0 m, 0 m, 0 m], {numbers}}}]\n"
        with pytest.raises(ConfigurationError, match=said):
            built(WALL, CAMERA, cap)


def test_walls_that_neither_stand_nor_lie_are_refused(built):
    for wall, said in [
        ("{kind: floor, distance: 1 m}", r"wall.height: is missing"),
        ("{kind: slope, height: 1 m}", r"line 2, wall: .*'slope'"),
        ("[1 m]", "line 2, wall: "),
    ]:
        with pytest.raises(ConfigurationError, match=said):
            built(EXACT, f"wall: {wall}\n", CAMERA, MONITOR)


def test_laboratory_without_a_hidden_surface_is_refused(built):
    with pytest.raises(ConfigurationError, match="no surface is hidden; give a monitor, or a list"):
        built(WALL, CAMERA)
    card = "{kind: card, name: a, width: 9 cm, height: 9 cm, center: [0 m, 0 m, 30 cm]}"
    with pytest.raises(ConfigurationError, match="two hidden surfaces have one name: a, a"):
        built(WALL, CAMERA, f"hidden: [{card}, {card}]\n")


def test_every_kind_of_the_commented_example_makes_a_scene(tmp_path):
    """What the example has in comments, but for a mesh file of the user's."""
    text = EXAMPLE.read_text("utf-8")
    assert not [kind for kind in KINDS if not re.search(rf"\b{kind}\b", text)]
    surfaces = text[text.index("# hidden:") : text.index("# -- what stands between")]
    parts = text[text.index("  # - name: cap") : text.index("  # - name: chair")]
    text = text.replace(surfaces, re.sub("(?m)^# ?", "", surfaces))
    text = text.replace(parts, re.sub("(?m)^  # ", "  ", parts))
    (tmp_path / "all.yaml").write_text(text, "utf-8")
    scene, *_ = build_laboratory(tmp_path / "all.yaml", tmp_path / "all.xml")
    loaded = load_scene(scene)
    assert list(loaded.emission) == ["monitor", "hidden_second", "hidden_card", "hidden_room"]
    bodies = load_laboratory(tmp_path / "all.yaml").occluders
    ids = set().union(*(body.ids - ({body.name} if body.parts else set()) for body in bodies))
    assert {occluder.name for occluder in loaded.occluders} == ids
    assert {"cap", "end", "door_jamb", "door_lintel", "door_corner"} <= ids


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        pytest.param("doorway", ("door_y", "door_z"), marks=pytest.mark.thorough),
        ("corner", ("edge_x", "edge_y")),
    ],
)
def test_edges_and_doorways_have_areas_that_their_numbers_move(name, numbers):
    scenario = load_scenario(name, (3, 4), photograph=(7, 7))
    rays, areas = render_transport(scenario, samples=256), area_transport(scenario)
    assert np.linalg.norm(areas - rays) < 0.06 * np.linalg.norm(
        rays
    )  # patches of 28° are flat there
    for number in numbers:
        value = float(scenario.document.defaults[number]) + 0.004
        moved = scenario.at(**{number: value})
        anew = load_scenario(name, (3, 4), {number: value}, photograph=(7, 7))
        A, B = area_transport(moved), area_transport(anew)
        np.testing.assert_allclose(A, B, atol=1e-4 * B.max())
        assert np.abs(A - areas).max() > 1e-3 * areas.max(), number


@pytest.mark.parametrize("name", ["doorway", "corner"])
def test_shipped_scene_is_what_its_measurements_make(name, tmp_path):
    folder = scenes_folder()
    written = build_laboratory(folder / f"{name}.yaml", tmp_path / f"{name}.xml")
    for file in written:
        assert file.read_bytes() == (folder / file.name).read_bytes(), file.name
    scenario = load_scenario(name, (2, 3), {"film": 25})
    assert scenario.photograph_shape == (25, 25)
