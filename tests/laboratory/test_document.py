import pytest

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.laboratory import document
from periscopy_sim.laboratory.entries import Measured

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
    found = document.load_laboratory(written(tmp_path, LEAST))
    assert found.wall.distance == Measured(1.0, None) and found.camera.film == (12, 16)
    assert found.monitor.turn == Measured(0.0, 0.0) and found.monitor.falloff is None
    assert found.occluders == () and found.folder == tmp_path.resolve()


def test_mistakes_are_told_with_their_line(tmp_path):
    for old, new, message in [
        ("distance: 1 m", "distance: 1", r"line 2, wall.distance: 1 has no unit; write it as in"),
        ("distance: 1 m", "distance: -1 m", r"line 2, wall.distance: '-1 m' is not positive"),
        ("wall: {distance: 1 m}", "wall: {}", r"line 2, wall.distance: is missing$"),
        ("width: 40 cm", "widht: 40 cm", r"line 7, camera.widht: is not known"),
        ("12x16", "12", r"line 5, camera.film: .*write ROWSxCOLUMNS"),
        ("[30 cm, 10 cm]", "[30 cm, 10]", r"line 6, camera.bottom_left\[1\]: 10 has no unit"),
        ("center: [0 m", "center: [0,5 cm", "line 12, monitor.center: "),
        ("  center", "  top_left: [0 m, 0 m, 1 m]\n  center", r"monitor: give one of center, top"),
        ("kind: rectified", "kind: oblique", r"line 3, camera: .*'oblique'"),
        ("angle: 1 deg", "angle: 0 deg", r"line 1, errors.angle: '0 deg' is not positive"),
        ("distance: 1 m", "distance: 1 m, reflectance: 2", r"line 2, wall.reflectance"),
    ]:
        assert old in LEAST
        with pytest.raises(ConfigurationError, match=message) as caught:
            document.load_laboratory(written(tmp_path, LEAST.replace(old, new, 1)))
        assert "\n" not in str(caught.value)


BOX = "{kind: box, name: NAME, position: [0 m, 50 cm, 0 m], width: 1 cm, depth: 1 cm, height: 1 cm}"


def test_mistakes_of_occluders_are_told(tmp_path):
    for entry, message in [
        (BOX.replace("NAME", "wall"), "'wall' is no name"),
        (BOX.replace("NAME", "hidden_box"), "'hidden_box' is no name"),
        (BOX.replace("NAME", "b").replace("width: 1", "width: 0"), r"\[0\].width: '0 cm' is not"),
        (BOX.replace("box", "bx"), r"occluders\[0\]: .*'bx'.*'box', 'plate'"),
        ("{kind: mesh, name: m, file: a.stl, position: [0 m, 0 m, 0 m]}", "have no unit; give it"),
        (
            "{kind: rod, name: r, start: [0 m, 0 m, 0 m], end: [0 m, 0 m, 0 m], diameter: 1 cm}",
            r"line 13, occluders\[0\]: rod 'r': start and end are one point",
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
    ]:
        with pytest.raises(ConfigurationError, match=message):
            document.load_laboratory(written(tmp_path, f"{LEAST}occluders: [{entry}]\n"))


def test_every_mistake_is_told_at_once(tmp_path):
    text = LEAST.replace("width: 40 cm", "widht: 40 cm").replace("distance: 1 m", "distance: .nan")
    text = text.replace("height: 30", "height: .inf").replace("angle: 1", "angle: nan")
    with pytest.raises(ConfigurationError) as caught:
        document.load_laboratory(written(tmp_path, text))
    for part in (
        *("line 1, errors.angle", "line 2, wall.distance", "line 7, camera.widht"),
        *("line 8, camera.height", "line 10, monitor.widht", "line 11, monitor.height"),
    ):
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_field_of_view_is_an_angle_between_0_and_180_degrees(tmp_path):
    camera = """camera: {kind: perspective, film: 12x16, position: [1 m, 0 m, 30 cm],
         target: [0 m, 0 m], field_of_view: %s}
"""
    text = LEAST.replace(LEAST[LEAST.index("camera") : LEAST.index("monitor")], camera)
    assert (
        document.load_laboratory(written(tmp_path, text % "30 deg")).camera.field_of_view.value
        == 30
    )
    for angle in ("-3 deg", "180 deg"):
        with pytest.raises(ConfigurationError, match=r"camera: .* between 0 and 180 deg"):
            document.load_laboratory(written(tmp_path, text % angle))
