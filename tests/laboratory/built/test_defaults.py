"""What is measured becomes a scene's defaults, each number with its error."""

import re

import pytest

from periscopy_sim.errors import ConfigurationError
from periscopy_sim.rendering.scene.document import read_document
from tests.laboratory.built.conftest import CAMERA, MONITOR, WALL


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
