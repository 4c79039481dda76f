import json
from pathlib import Path

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.calibration.occluder import KINDS, Room, write_piece
from tests.scenes.bare_room import BALL, ROOM, photographed, rough  # noqa: F401

pytestmark = pytest.mark.usefixtures("jit", "rough", "folder")
COMMAND = ("y.npy", "--scene", "room.xml", "--hidden", "9x12", "--out", "piece.xml")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "room.xml").write_text(ROOM)
    bare = ps.load_scenario(tmp_path / "room.xml", (9, 12))
    texts = {name: str(value) for name, value in BALL.items()}
    write_piece(Room.of(bare, None, None), KINDS["ball"], texts, tmp_path / "true.xml")
    np.save(tmp_path / "y.npy", photographed(tmp_path / "true.xml"))


def found(succeeds):
    box = ("--within", "0.4:0.5,0.5:0.7,0.25:0.4", "--sizes", "0.1:0.14")
    outcome = succeeds("calibrate", *COMMAND, "--unknown", "ball", *box)
    assert "piece_radius" in outcome
    record = json.loads(Path("piece.json").read_text())
    assert record["kind"] == "ball" and record["probabilities"] == {"ball": 1}
    return record


def test_a_piece_is_found_and_its_scene_reconstructs(succeeds):
    found(succeeds)
    assert Path("piece_piece.ply").is_file() and Path("piece.png").is_file()
    scene = ("--scene", "piece.xml", "--hidden", "9x12")
    succeeds("reconstruct", "y.npy", *scene, "--out", "image")


@pytest.mark.thorough
def test_python_finds_the_same(succeeds):
    record, bare = found(succeeds), ps.load_scenario("room.xml", (9, 12))
    box = {"within": [(0.4, 0.5), (0.5, 0.7), (0.25, 0.4)], "sizes": (0.1, 0.14)}
    twin = bare.find_occluder(np.load("y.npy"), "twin/piece.xml", kinds="ball", **box)
    values = {name: each["value"] for name, each in record["parameters"].items()}
    assert twin.calibration.values == pytest.approx(values)
    assert Path("twin/piece.xml").read_text() == Path("piece.xml").read_text()
    assert twin.calibration.scenario.document.values["piece_x"] == f"{values['piece_x']:.9g}"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--unknown", "ball,cube"), "'cube'"),
        (("--unknown", "ball", "--free", "x"), "--free"),
        (("--unknown", "ball", "--sizes", "0.2"), "--sizes"),
        (("--within", "0:1,0:1,0:1"), "--unknown"),
    ],
)
def test_what_cannot_be_done_exits_2(arguments, words, refused):
    assert words in refused("calibrate", *COMMAND, *arguments)
    assert not Path("piece.xml").exists()
