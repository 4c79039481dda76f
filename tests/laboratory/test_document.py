import pytest

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory.document import EXAMPLE, load_laboratory
from periscopy_sim.laboratory.quantities import Measured

LEAST = """\
errors: {length: 5 mm, angle: 1 deg}
wall: {distance: 1 m}
camera:
  kind: rectified
  film: 12x16
  bottom_left: [30 cm, 10 cm]
  width: 40 cm
  height: 30 cm
monitor:
  width: 40 cm
  height: 30 cm
  center: [0 m, 0 m, 30 cm]
"""


def written(tmp_path, text):
    file = tmp_path / "lab.yaml"
    file.write_text(text)
    return file


def test_least_laboratory(tmp_path):
    found = load_laboratory(written(tmp_path, LEAST))
    assert found.wall.distance == Measured(1.0, None) and found.camera.film == (12, 16)
    assert found.monitor.turn == Measured(0.0, 0.0) and found.monitor.falloff is None
    assert found.occluders == () and found.folder == tmp_path.resolve()


def test_example_shows_every_kind_of_occluder_and_camera():
    found = load_laboratory(EXAMPLE)
    text = EXAMPLE.read_text()
    for kind in ("perspective", "corners", "rectified", "box", "cylinder", "rod", "frame", "mesh"):
        assert f"kind: {kind}" in text
    assert found.monitor.width == Measured(0.402, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("distance: 1 m", "distance: 1", r"line 2, wall.distance: 1 has no unit; write it as in"),
        ("distance: 1 m", "distance: -1 m", r"line 2, wall.distance: '-1 m' is not positive"),
        ("wall: {distance: 1 m}", "wall: {}", r"line 2, wall.distance: is missing$"),
        ("width: 40 cm", "widht: 40 cm", r"line 7, camera.widht: is not known"),
        ("12x16", "12", r"line 5, camera.film: write ROWSxCOLUMNS"),
        ("[30 cm, 10 cm]", "[30 cm, 10]", r"line 6, camera.bottom_left\[1\]: 10 has no unit"),
        ("center: [0 m", "center: [0,5 cm", "line 12, monitor.center: "),
        ("  center", "  top_left: [0 m, 0 m, 1 m]\n  center", r"monitor: give one of center, top"),
        ("kind: rectified", "kind: oblique", r"line 3, camera: .*'oblique'"),
        ("angle: 1 deg", "angle: 0 deg", r"line 1, errors: the error of an angle"),
        ("distance: 1 m", "distance: 1 m, reflectance: 2", r"line 2, wall.reflectance"),
    ],
)
def test_mistakes_are_told_with_their_line(tmp_path, old, new, message):
    assert old in LEAST
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_laboratory(written(tmp_path, LEAST.replace(old, new, 1)))
    assert "\n" not in str(caught.value)


BOX = "{kind: box, name: NAME, position: [0 m, 50 cm, 0 m], width: 1 cm, depth: 1 cm, height: 1 cm}"


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (BOX.replace("NAME", "wall"), "'wall' is no name"),
        (BOX.replace("NAME", "b").replace("width: 1", "width: 0"), r"\[0\].width: '0 cm' is not"),
        (BOX.replace("box", "bx"), r"occluders\[0\]: .*'bx'.*'box', 'plate'"),
        ("{kind: mesh, name: m, file: a.stl, position: [0 m, 0 m, 0 m]}", "have no unit; give it"),
        (
            "{kind: rod, name: r, start: [0 m, 0 m, 0 m], end: [0 m, 0 m, 1 m], diameter: 1 cm, "
            "radius: 5 mm}",
            r"line 13, occluders\[0\]: give either diameter or radius",
        ),
        (
            BOX.replace("}", ", with: a}").replace("NAME", "b") + f", {BOX.replace('NAME', 'a')}",
            "occluder 'b' stands with 'a', but no occluder above it",
        ),
        (
            "{kind: rod, name: r, start: [0 m, 0 m, 0 m], end: [0 m, 0 m, 1 m], diameter: 1 cm}, "
            + BOX.replace("}", ", with: r}").replace("NAME", "b"),
            "occluder 'b' stands with 'r'",
        ),
        (BOX.replace("NAME", "b") + f", {BOX.replace('NAME', 'b')}", "called 'b'"),
    ],
)
def test_mistakes_of_occluders_are_told(tmp_path, entry, message):
    with pytest.raises(ConfigurationError, match=message):
        load_laboratory(written(tmp_path, f"{LEAST}occluders: [{entry}]\n"))


def test_camera_looks_at_a_target_or_in_a_direction(tmp_path):
    camera = """camera:
  kind: perspective
  film: 12x16
  position: [1 m, 0 m, 30 cm]
  field_of_view: 30 deg
"""
    text = LEAST.replace(LEAST[LEAST.index("camera") : LEAST.index("monitor")], camera)
    aimed = camera + "  target: [0 m, 0 m]\n"
    turned = camera + "  turn: 3 deg\n"
    for changed in (aimed, turned):
        load_laboratory(written(tmp_path, text.replace(camera, changed)))
    for changed in (camera, aimed + "  tilt: 3 deg\n"):
        with pytest.raises(ConfigurationError, match="camera: give either target"):
            load_laboratory(written(tmp_path, text.replace(camera, changed)))
    both = turned + "  vertical_field_of_view: 20 deg\n"
    for changed in (both, both.replace("  field", "  vertical_field").replace("  v", "  # v")):
        with pytest.raises(ConfigurationError, match="give either field_of_view, of the picture's"):
            load_laboratory(written(tmp_path, text.replace(camera, changed)))
    with pytest.raises(ConfigurationError, match=r"camera: .* between 0 and 180 deg"):
        load_laboratory(written(tmp_path, text.replace(camera, aimed.replace("30 deg", "-3 deg"))))
