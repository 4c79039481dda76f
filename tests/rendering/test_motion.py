"""A scene at other values of its parameters, against the scene loaded with them."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.nodes import SceneNodes
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scenario import load_scenario
from periscopy_sim.shipped import find_scene

ARRAYS = {"view": "points normals corners channel_gain", "hidden": "centers normals across up"}
SCENES = "chair", "plant", "scenes/tutorial/truth/scene.xml"
WHOLE = "resolution", "width", "height"


def assert_same(scene, expected):
    assert repr(scene) == repr(expected)
    assert scene.scene.emission == expected.scene.emission
    for part, names in ARRAYS.items():
        for name in names.split():
            ours, theirs = (getattr(getattr(each, part), name) for each in (scene, expected))
            np.testing.assert_allclose(ours, theirs, atol=1e-6)
    assert scene.view.relief == pytest.approx(expected.view.relief, abs=1e-6)
    for one, other in zip(scene.scene.occluders, expected.scene.occluders, strict=True):
        assert one.name == other.name
        np.testing.assert_allclose(one.bounds, other.bounds, atol=1e-6)
        if other.vertices is not None:
            np.testing.assert_allclose(one.vertices, other.vertices, atol=1e-6)
            np.testing.assert_array_equal(one.faces, other.faces)


@pytest.mark.parametrize("name", SCENES)
def test_shipped_scene_at_other_values_is_the_scene_loaded_with_them_and_takes_no_build(
    name, monkeypatch
):
    path = find_scene(name)
    document = read_document(path)
    values = {
        name: 1.03 * float(text) + 0.004
        for name, text in document.defaults.items()
        if name not in (*document.errors, *WHOLE)
    }
    scene = load_scenario(path, (3, 4), photograph=(6, 8))
    draws = [{name: value} for name, value in values.items()] + [values]
    for draw in draws:
        expected = load_scenario(path, (3, 4), draw, photograph=(6, 8))
        with monkeypatch.context() as patch:
            patch.setattr(SceneNodes, "instantiate", None)
            assert_same(scene.at(**draw), expected)


def test_scenes_of_one_file_move_in_any_order():
    """What stays in its place is taken over from the scene before."""
    names = "camera_dx", "occluder_dx", "monitor_dy"
    first = load_scenario("chair", (3, 4), photograph=(6, 8))
    for moved in ("c", "co", "o", "", "mc", "c", "m"):
        values = {name: 0.02 * (name[0] in moved) for name in names}
        expected = load_scenario("chair", (3, 4), values, photograph=(6, 8))
        assert_same(first.at(**values), expected)


X = '<default name="x" value="0.7"/>'


def test_what_takes_rays_is_traced(room):
    """Shapes of no mesh, and walls that are no rectangles."""
    folded = room.wall().replace("rectangle", "cube")
    for extra, parts in [
        (room.blocker(center="$x, 0.5, 0.3"), {}),
        ("", {"wall": folded.replace('x="0.7"', 'x="$x"').replace('y="1"', 'y="2"')}),
        ("", {"monitor": room.curved_monitor(room.area), "camera": camera_at_x(room)}),
    ]:
        path = room.write(extra, **parts | {"wall": X + parts.get("wall", room.wall())})
        scene, expected = (load_scenario(path, (2, 3), values) for values in ({}, {"x": 0.72}))
        moved = scene.at(x=0.72)
        assert_same(moved, expected)


def test_scene_of_many_files_moves_by_any_of_its_references(room, monkeypatch):
    """Moved by includes, nested defaults, a ruled cylinder, exponents and an unnamed shape."""
    (room.folder / "part.xml").write_text(
        '<scene version="3.0.0"><default name="far" value="0.4$digit"/>'
        '<shape type="cube"><transform name="to_world"><scale value="0.0$digit"/>'
        '<rotate y="1" angle="$turn"/><translate value="0.$digit, $far 0.3"/></transform></shape>'
        "</scene>"
    )
    rod = (
        '<shape type="cylinder" id="rod"><point name="p0" x="0.4" y="$far" z="0"/>'
        '<point name="p1" value="0.4 0.5 0.6"/><float name="radius" value="0.00$digit"/></shape>'
    )
    turn = '<default name="digit" value="2"/><default name="turn" value="$digit"/>'
    parts = {"wall": turn + room.wall(), "monitor": room.monitor(room.lcd("1$digit", "0.$digit"))}
    path = room.write('<include filename="part.xml"/>', rod, **parts)
    scene = load_scenario(path, (2, 3))
    for values in ({"digit": 3}, {"turn": -40}, {"far": 0.41}, {"digit": 3, "far": 0.5}):
        expected = load_scenario(path, (2, 3), values)
        with monkeypatch.context() as patch:
            patch.setattr(SceneNodes, "instantiate", None)
            assert_same(scene.at(**values), expected)


@pytest.mark.parametrize("value", ["0.72", "oak"])
def test_value_that_does_more_than_move_loads_the_scene_anew(room, value):
    """A reference in a material, too; `oak` is no number, and the error is the loaded scene's."""
    paint = '<bsdf type="diffuse"><rgb name="reflectance" value="$x"/></bsdf>'
    path = room.write(wall=X + room.wall(paint, x="$x"))
    scene = load_scenario(path, (2, 3))
    if value == "oak":
        with pytest.raises(SceneError, match="x=oak"):
            scene.at(x=value)
    else:
        moved = scene.at(x=value)
        assert_same(moved, load_scenario(path, (2, 3), {"x": value}))
        assert moved.view.reflectance == pytest.approx(0.72)


def camera_at_x(room):
    return room.camera().replace("0.7,", "$x,")


@pytest.mark.parametrize(
    ("scene", "values"),
    [
        ("chair", {"camera_dx": 2}),  # off the wall
        ("chair", {"monitor_turn": 180}),
        ("chair", {"monitor_stretch": 0}),
        ("chair", {"occluder_dx": 0.2, "occluder_dy": 0.35}),  # into the camera's view
        ("chair", {"vertical_exponent": -1}),
        ("chair", {"occluder_dx": "nan"}),
        ("chair", {"occluder_dw": 1}),
        ("plant", {"camera_fov": 200}),
        ("plant", {"camera_pan": 180}),
    ],
)
def test_values_without_a_scene_are_refused_as_when_loaded(scene, values):
    loaded = load_scenario(scene, (1, 2), photograph=(4, 5))
    with pytest.raises(SceneError) as expected:
        load_scenario(scene, (1, 2), values, photograph=(4, 5))
    with pytest.raises(SceneError) as caught:
        loaded.at(**values)
    assert str(caught.value) == str(expected.value)


def test_scene_keeps_its_values_and_so_does_a_pickled_one(monkeypatch):
    scene = load_scenario("chair", (1, 2), {"resolution": 8, "monitor_dx": "0.01"})
    copy = pickle.loads(pickle.dumps(scene))
    expected = load_scenario("chair", (1, 2), {
        **scene.parameters, "occluder_dx": 0, "camera_dz": -0.002,
    })  # fmt: skip
    monkeypatch.setattr(SceneNodes, "instantiate", None)
    for each in scene, copy, scene.at(occluder_dx=0.004).at(occluder_dx=0):
        assert_same(each.at(occluder_dx=0, camera_dz=-0.002), expected)
    assert scene.parameters == {"resolution": "8", "monitor_dx": "0.01"}
    with pytest.raises(ValueError):
        replace(scene.scene, source=None).at(occluder_dx=1)
