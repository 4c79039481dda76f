import struct

import numpy as np
import pytest
import trimesh

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.errors import ConfigurationError, OutputError
from periscopy_sim.laboratory.document import load_laboratory
from periscopy_sim.rendering.scene_files import SIDES, read_document
from periscopy_sim.rendering.shadow_rays import render_transport
from periscopy_sim.scenario import load_scenario
from tests.scenes.laboratory import (
    CAMERA,
    HIDDEN,
    KINDS,
    MONITOR,
    POSITION,
    WALL,
    corners_of,
    occluders,
    same_points,
    turned,
)


@pytest.mark.parametrize(
    ("anchor", "low", "kind", "deep"),
    [
        ("base", (-0.03, -0.01, 0), "box", "depth"),
        ("center", (-0.03, -0.01, -0.05), "plate", "thickness"),
        ("corner", (0, 0, 0), "box", "depth"),
    ],
)
def test_box_has_its_size_about_its_anchor(built, kind, deep, anchor, low):
    sizes = f"width: 6 cm, {deep}: 2 cm, height: 10 cm, anchor: {anchor}"
    (thing,) = built(WALL, CAMERA, MONITOR, occluders(kind, sizes)).scene.occluders
    expected = turned(corners_of(low, np.add(low, (0.06, 0.02, 0.1))), -15, 25) + POSITION
    same_points(thing.vertices, expected)


def test_frame_is_four_bars_about_its_opening(built):
    sizes = "width: 6 cm, height: 10 cm, bar: 1 cm, thickness: 2 cm"
    bars = built(WALL, CAMERA, MONITOR, occluders("frame", sizes)).scene.occluders
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
@pytest.mark.parametrize(("kind", "full"), [("cylinder", 1)])
def test_round_body_is_round_and_closed(built, kind, full, anchor, low):
    """Its volume is this fraction of a cylinder's."""
    sizes = f"diameter: 6 cm, height: 10 cm, anchor: {anchor}"
    (thing,) = built(WALL, CAMERA, MONITOR, occluders(kind, sizes)).scene.occluders
    upright = (thing.vertices - POSITION) @ turned(np.eye(3), -15, 25).T
    radius = np.hypot(upright[:, 0], upright[:, 1])
    rim = radius > 0.001
    width = SIDES * 2 * radius[rim] * np.sin(np.pi / SIDES) / np.pi  # a polygon's, on average
    np.testing.assert_allclose(width, 0.06, rtol=2e-5)
    np.testing.assert_allclose(np.unique(np.round(upright[:, 2], 5)), [low, low + 0.1], atol=1e-5)
    edges = np.concatenate([thing.faces[:, [0, 1]], thing.faces[:, [1, 2]], thing.faces[:, [2, 0]]])
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges) and {(b, a) for a, b in directed} == directed  # closed
    a, b, c = np.moveaxis(upright[thing.faces], 1, 0)
    volume = np.sum(a * np.cross(b, c)) / 6
    np.testing.assert_allclose(
        volume, full * np.pi * 0.03**2 * 0.1, rtol=1e-3
    )  # its outside is outside


def test_rod_lies_between_its_ends(built):
    rod = """occluders: [{kind: rod, name: rod, start: [20 cm, 40 cm, 15 cm],
             end: [30 cm, 50 cm, 35 cm], diameter: 4 cm}]
"""
    (found,) = built(WALL, CAMERA, MONITOR, rod).scene.occluders
    start, end = np.array([0.2, 0.4, 0.15]), np.array([0.3, 0.5, 0.35])
    length = np.linalg.norm(end - start)
    along = (found.vertices - start) @ (end - start) / length
    np.testing.assert_allclose(np.unique(along.round(6)), [0, length], atol=1e-6)
    beside = found.vertices - start - np.outer(along / length, end - start)
    np.testing.assert_allclose(np.linalg.norm(beside, axis=1), 0.02, atol=1e-6)


def test_every_kind_of_part_has_areas_that_its_numbers_move(built, tmp_path):
    parts = """occluders: [{kind: box, name: a, %s, width: 2 cm, depth: 2 cm, height: 4 cm},
 {kind: plate, name: b, %s, width: 3 cm, height: 5 cm}, {kind: mesh, name: c, %s, file: c.ply,
  unit: mm}, {kind: frame, name: d, %s, width: 4 cm, height: 4 cm, bar: 5 mm},
 {kind: cylinder, name: e, %s, diameter: 3 cm, height: 4 cm}, {kind: rod, name: f, diameter: 1 cm,
  start: [25 cm, 50 cm, 5 cm], end: [25 cm, 50 cm, 30 cm]},
 {kind: rod, name: g, with: e, diameter: 1 cm, start: [0 m, 0 m, 4 cm], end: [0 m, 1 cm, 9 cm]}]
"""
    places = (f"position: [{x} cm, 50 cm, 20 cm], tilt: 9 deg" for x in range(12, 37, 5))
    ball = trimesh.creation.icosphere(2, 20)
    ball.export(tmp_path / "c.ply")
    scenario = built(WALL, CAMERA, MONITOR, parts % tuple(places))
    kinds = {body.kind for body in load_laboratory(tmp_path / "lab.yaml").occluders}
    assert kinds == KINDS - {"edge", "doorway"}  # which have tests of their own
    rays, areas = render_transport(scenario, samples=256), area_transport(scenario)
    np.testing.assert_allclose(areas.sum(axis=1), rays.sum(axis=1), rtol=0.02)
    for name in ("a_x", "b_turn", "c_z", "d_bar", "e_diameter", "f_radius", "f_end_y", "g_end_x"):
        value = 1.01 * float(scenario.document.defaults[name]) + 0.001
        moved = scenario.at(**{name: value})
        anew = load_scenario(scenario.path, HIDDEN, {name: value})
        for here, there in zip(moved.scene.occluders, anew.scene.occluders, strict=True):
            np.testing.assert_allclose(here.vertices, there.vertices, atol=1e-6)
            np.testing.assert_allclose(here.bounds, there.bounds, atol=1e-4)
        assert np.any(area_transport(moved) != areas), name


BORNE = """occluders:
- {kind: box, name: bottle, position: [20 cm, 50 cm, 5 cm], turn: 25 deg, tilt: -15 deg,
   width: 6 cm, depth: 4 cm, height: 10 cm, anchor: center}
- {kind: box, name: neck, with: bottle, position: [1 cm, 0 cm, 5 cm], turn: 10 deg,
   width: 2 cm, depth: 1 cm, height: 3 cm}
- {kind: plate, name: flag, with: neck, position: [0 cm +- 1 mm, 0 cm, 3 cm], tilt: 5 deg,
   width: 4 cm, thickness: 2 mm, height: 2 cm}
- {kind: rod, name: straw, with: bottle, start: [0 cm, 0 cm, 5 cm], end: [2 cm, 1 cm, 15 cm],
   diameter: 6 mm}
- {kind: rod, name: twin, start: [%s], end: [%s], diameter: 6 mm}
"""


def test_what_stands_with_another_is_moved_by_its_numbers_alone(built, tmp_path):
    ends = turned([(0, 0, 0.05), (0.02, 0.01, 0.15)], -15, 25) + POSITION
    start, end = (", ".join(f"{x:.12f} m" for x in each) for each in ends)
    parts = WALL, CAMERA, MONITOR, BORNE % (start, end)
    found = {each.name: each for each in built(*parts).scene.occluders}

    def with_bottle(points):
        return turned(np.add(turned(points, 0, 10), (0.01, 0, 0.05)), -15, 25) + POSITION

    neck = corners_of((-0.01, -0.005, 0), (0.01, 0.005, 0.03))
    flag = turned(corners_of((-0.02, -0.001, 0), (0.02, 0.001, 0.02)), 5, 0)
    flag += (0, 0, 0.03)
    same_points(found["neck"].vertices, with_bottle(neck))
    same_points(found["flag"].vertices, with_bottle(flag))
    straw, twin = (found[name].bounds for name in ("straw", "twin"))
    np.testing.assert_allclose(straw, twin, atol=1e-5)
    declared = read_document(tmp_path / "lab.xml").defaults
    errors = {name for name in declared if name.endswith("_error")}
    own = {"neck_width_error", "neck_depth_error", "neck_height_error"}
    assert {name for name in errors if name.startswith("neck")} == own
    assert "flag_x_error" in errors and "flag_y_error" not in errors
    assert {"bottle_x_error", "bottle_turn_error", "straw_radius_error"} <= errors
    assert not {name for name in errors if name.startswith("straw_start")}
    for each in built(*parts, parameters={"bottle_x": "0.23"}).scene.occluders:
        shift = each.bounds - found[each.name].bounds
        np.testing.assert_allclose(shift, [(0.03 * (each.name != "twin"), 0, 0)] * 2, atol=1e-6)


CORNERS = np.array([(100, 200, 10), (160, 200, 10), (100, 260, 10), (100, 200, 90)], "f4")
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])


@pytest.fixture
def tent(tmp_path):
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *c.ravel(), 0) for c in CORNERS[FACES])
    (tmp_path / "tent.stl").write_bytes(bytes(80) + struct.pack("<I", len(FACES)) + rows)


@pytest.mark.usefixtures("tent")
@pytest.mark.parametrize(
    ("up", "axes", "anchor"),
    [
        ("z", ((1, 0, 0), (0, 1, 0), (0, 0, 1)), "origin"),
        ("y", ((1, 0, 0), (0, 0, -1), (0, 1, 0)), "base"),
        ("x", ((0, 1, 0), (0, 0, 1), (1, 0, 0)), "center"),
    ],
)
def test_mesh_stands_in_metres_upright_at_its_anchor(built, up, axes, anchor):
    own = 0.001 * CORNERS.astype(float) @ np.transpose(axes)
    assert np.linalg.det(axes) == 1
    low, high = own.min(axis=0), own.max(axis=0)
    center = (low + high) / 2
    middle = {"origin": np.zeros(3), "center": center, "base": [*center[:2], low[2]]}[anchor]
    more = f"file: tent.stl, unit: mm, up: {up}, anchor: {anchor}"
    (thing,) = built(WALL, CAMERA, MONITOR, occluders("mesh", more)).scene.occluders
    same_points(thing.vertices, turned(own - middle, -15, 25) + POSITION)


def test_base_of_a_mesh_is_the_middle_of_its_lowest_face(built, tmp_path):
    pot, leaf = trimesh.creation.box((2, 4, 6)), trimesh.creation.box((9, 1, 1))
    trimesh.util.concatenate(pot, leaf.apply_translation((7, 5, 5))).export(tmp_path / "pot.stl")
    more = "file: pot.stl, unit: cm, anchor: base"
    (thing,) = built(WALL, CAMERA, MONITOR, occluders("mesh", more)).scene.occluders
    upright = turned(turned(thing.vertices - POSITION, 0, -25), 15, 0)
    np.testing.assert_allclose(upright.min(axis=0), [-0.01, -0.02, 0], atol=1e-6)
    np.testing.assert_allclose(upright.max(axis=0), [0.115, 0.055, 0.085], atol=1e-6)


@pytest.mark.usefixtures("tent")
def test_files_that_are_given_are_not_written_over(built, tmp_path):
    more = "file: lab_thing.ply, unit: mm"
    (tmp_path / "lab_thing.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    with pytest.raises(ConfigurationError, match=r"lab_thing\.ply"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", more))
    built(WALL, CAMERA, MONITOR, occluders("mesh", "file: tent.stl, unit: mm"))
    before = (tmp_path / "lab_thing.ply").read_bytes()
    with pytest.raises(OutputError, match="it is one of the files given"):
        built(WALL, CAMERA, MONITOR, occluders("mesh", more))
    assert (tmp_path / "lab_thing.ply").read_bytes() == before


@pytest.mark.usefixtures("tent")
def test_mesh_with_the_name_of_the_cylinders_is_refused(built):
    cylinder = "{kind: cylinder, name: a, diameter: 1 cm, height: 1 cm, position: [0 m, 0 m, 0 m]}"
    mesh = occluders("mesh", "file: tent.stl, unit: mm").replace("name: thing", "name: cylinder")
    with pytest.raises(ConfigurationError, match="a mesh is called 'cylinder'; name it otherwise"):
        built(WALL, CAMERA, MONITOR, mesh.replace("]\n", f", {cylinder}]\n"))


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
