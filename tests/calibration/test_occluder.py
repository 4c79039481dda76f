import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.calibration import occluder
from periscopy_sim.calibration.occluder import KINDS, Room, find_occluder, write_piece
from periscopy_sim.errors import PhotographError, SceneError
from periscopy_sim.rendering.load import load_geometry
from tests.scenes.bare_room import BALL, BOX, HIDDEN, ROOM, photographed, rough  # noqa: F401

pytestmark = pytest.mark.usefixtures("jit")
MIDDLE = (0.3, 0.6), (0.4, 0.7), (0.2, 0.5)
"""A box far from monitor and wall: past faces that reach either, A takes a second."""


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.xml"
    path.write_text(ROOM)
    return path


def with_piece(room, kind, values):
    file = room.with_name(f"{kind}.xml")
    texts = {name: str(value) for name, value in values.items()}
    write_piece(Room.of(load_geometry(room, HIDDEN), None, None), KINDS[kind], texts, file)
    return file


@pytest.mark.thorough
def test_an_unmeasured_ball_is_found(room, monkeypatch):
    few = {"DRAWS": 64, "GENERATIONS": 10, "VALLEYS": 1, "LIKELY": 2, "PATTERN": (1.0,)}
    for name, value in few.items():
        monkeypatch.setattr(occluder, name, value)
    y, seen = photographed(with_piece(room, "ball", BALL)), []
    out = room.with_name("found.xml")
    found = find_occluder(y, room, HIDDEN, out, kinds=["ball", "plate"], progress=seen.append)
    assert found.kind == "ball" and found.probabilities["ball"] > 0.99
    assert found.calibration.trusted
    for p in found.calibration.parameters:
        assert abs(p.value - BALL[p.name]) < 3 * p.standard_error + 1e-3
    assert seen == sorted(seen) and seen[-1] == 1
    scene = ps.load_scenario(out, HIDDEN)
    assert scene.uncertainty()[0].names == tuple(BALL)
    assert found.files == (out, out.with_name("found_piece.ply"))


def test_pieces_beside_cast_the_shadows_of_other_images(room):
    """Of a small bright patch that moves as the image does, a piece's shadow stays."""
    bare, kind = load_geometry(room, HIDDEN), KINDS["ball"]
    light = np.zeros(bare.hidden.patches)
    light[30] = 1  # it is far from the border, so it stays where the image grows
    start, patch = np.array([0.45, 0.6, 0.32, np.log(0.06)]), bare.hidden.centers[30]
    t = 0.6 / 1.08
    shadow = patch + (start[:3] - patch) / t

    def beside(scale, shift):
        place = Room.of(bare, None, None).beside(
            kind, start, bare.hidden, light, scale, np.array(shift)
        )
        return place, place[1] / 1.08

    larger, nearer = beside(1.3, [0, 0])
    assert np.allclose(patch + (larger[:3] - patch) / nearer, shadow)
    assert np.isclose(np.exp(larger[3]) / nearer, 0.06 / t)
    assert np.isclose((1 / t - 1) / (1 / nearer - 1), 1.3)
    moved, depth = beside(1.0, [1, 0])
    patch = bare.hidden.centers[30] + bare.hidden.across[30]
    assert depth == t and np.allclose(patch + (moved[:3] - patch) / t, shadow)


def test_a_room_that_is_turned_has_the_same_piece(room):
    """A piece's numbers are along the wall, towards it and up, wherever the wall faces."""
    turn = '<rotate z="1" angle="90"/>'
    turned = room.with_name("turned.xml")
    text = ROOM.replace("</transform>", f"{turn}</transform>")
    turned.write_text(text)
    here, there = (
        area_transport(load_geometry(with_piece(each, "box", BOX), HIDDEN))
        for each in (room, turned)
    )
    assert np.abs(here - there).max() < 1e-3 * here.max()


def test_a_box_that_is_a_plate_casts_its_shadow(room):
    """The shapes' XML agrees: a flat box, and a rectangle of the same numbers."""
    place = {"piece_x": 0.45, "piece_y": 0.6, "piece_z": 0.32}
    sizes = {"piece_width": 0.1, "piece_height": 0.06, "piece_turn": 20}
    flat = with_piece(room, "plate", {**place, **sizes, "piece_roll": 0})
    thin = with_piece(room, "box", {**place, **sizes, "piece_depth": 1e-5})
    plate, box = (area_transport(load_geometry(each, HIDDEN)) for each in (flat, thin))
    assert np.abs(plate - box).max() < 1e-3 * plate.max()


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"kinds": "bal"}, SceneError, "did you mean 'ball'"),
        ({"within": [(0, 1), (2, 3), (0, 1)]}, SceneError, "no room"),
        ({"within": [(0, 1), (1, 0.5), (0, 1)]}, SceneError, "within"),
        ({"sizes": (0.2, 0.1)}, SceneError, "sizes"),
    ],
)
def test_bad_input_raises(options, error, words, room):
    with pytest.raises(error, match=words):
        find_occluder(np.ones((28, 28, 3)), room, HIDDEN, room.with_name("out.xml"), **options)
    assert not room.with_name("out.xml").exists()


@pytest.mark.usefixtures("rough")
def test_a_photograph_without_shadows_raises(room):
    y = 1 + 1e-3 * np.random.default_rng(0).standard_normal((28, 28, 3))
    with pytest.raises(PhotographError, match="no shadow"):
        find_occluder(y, room, HIDDEN, room.with_name("out.xml"), kinds="ball", within=MIDDLE)
