import numpy as np
import pytest
from matplotlib.colors import to_rgba
from scipy.interpolate import RegularGridInterpolator

from periscopy_sim.figures.laboratory import LINES, VIEWED, RoomPlan, draw, facts, turn_and_tilt
from periscopy_sim.figures.style import NO_BREAK, PAGE
from periscopy_sim.scenario import load_scenario
from periscopy_sim.shipped import find_scene

TITLES = ("the wall as the camera faces it", "from the side", "plan")


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(find_scene("plant"), (6, 8), photograph=(16, 16))


@pytest.fixture(scope="module")
def figure(scenario):
    return draw(scenario)


@pytest.fixture(scope="module")
def panels(figure):
    found = {ax.get_title().partition(";")[0]: ax for ax in figure.axes}
    assert tuple(found) == (*TITLES, "in space")
    return found


def test_the_three_views_have_one_scale(figure, panels):
    scales = []
    for title in TITLES[:3]:
        box = panels[title].get_window_extent()
        scales += [box.width / np.ptp(panels[title].get_xlim())]
        scales += [box.height / np.ptp(panels[title].get_ylim())]
    np.testing.assert_allclose(scales, scales[0], rtol=1e-3)
    assert figure.get_size_inches()[0] == PAGE


def lines_of(ax, colour):
    return [line for line in ax.lines if to_rgba(line.get_color()) == to_rgba(colour)]


def test_camera_stands_where_the_scene_says(panels):
    """At (1.65, 0.15, 0.42), looking at (0.76, 1.03, 0.27)."""
    for title, place in (("plan", (1.65, 0.15)), ("from the side", (0.15, 0.42))):
        dots = [line for line in lines_of(panels[title], VIEWED) if line.get_marker() == "o"]
        assert len(dots) == 1
        np.testing.assert_allclose(dots[0].get_xydata()[0], place, atol=1e-3)


def test_lines_on_the_wall_lie_where_the_words_below_say(panels):
    """What is dotted runs where the share is all but 1, what is solid where it is all but 0."""
    assert "Dotted: where shadows begin" in LINES and "solid: where all of it is hidden" in LINES
    ax = panels[TITLES[0]]
    share, (left, right, bottom, top) = ax.images[0].get_array(), ax.images[0].get_extent()
    grid = (np.linspace(bottom, top, share.shape[0]), np.linspace(left, right, share.shape[1]))
    drawn = {}
    for contour in ax.collections:
        points = np.concatenate([path.vertices for path in contour.get_paths()])
        dotted = contour.get_linestyle()[0][1] is not None
        drawn[dotted] = RegularGridInterpolator(grid, share)(points[:, ::-1])
    np.testing.assert_allclose(drawn[True], 0.98, atol=1e-6)
    np.testing.assert_allclose(drawn[False], 0.02, atol=1e-6)


def test_labels_name_everything_and_do_not_overlap(figure, panels):
    for title in TITLES:
        texts = [t for t in panels[title].texts if t.get_transform() is not None and t.get_text()]
        names = {text.get_text() for text in texts}
        assert "monitor" in names
        if title in TITLES[1:3]:
            assert {"camera", "plant", "pedestal", "wall"} <= names
            assert ("normal" in names) == (title == "plan")
    canvas = figure.canvas
    canvas.draw()
    for title in TITLES[:3]:
        named = {"monitor", "camera", "plant", "pedestal", "normal", "seen by the camera", "wall"}
        boxes = [
            text.get_window_extent() for text in panels[title].texts if text.get_text() in named
        ]
        for k, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[:k])


def test_distances_are_those_of_the_scene(figure, scenario):
    """The camera stands 1.26 m from the wall, by Pythagoras, 45.7 degrees off its normal."""
    (text,) = [" ".join(text.get_text().split()) for text in figure.texts]
    assert "Camera: 1.26 m from the wall along its line of sight, 46° off its normal" in text
    # Its line of sight runs from (1.65, 0.15, 0.42) to (0.76, 1.03, 0.27): atan 0.89 / 0.88, and
    # atan -0.15 / 1.2516.
    assert "off its normal (turned 45.3°, tilted -6.8°); sees" in text
    assert "1.03 m from the wall, turned -12°, tilted 0° from facing it squarely" in text
    assert "pedestal 45 cm (31 cm x 24 cm)" in text  # 0.4016 * 0.45 / 0.58
    lines = " ".join([LINES, *facts(RoomPlan(scenario))])
    assert text == lines.replace(NO_BREAK, " ")


def test_turn_and_tilt_are_those_that_measurements_have():
    ahead = np.array([0, 1.0, 0])
    for turn, tilt in ((30.0, 0.0), (-12.0, 5.5), (0.0, -20.0), (170.0, 40.0)):
        t, e = np.radians([turn, tilt])
        direction = np.array([-np.sin(t) * np.cos(e), np.cos(t) * np.cos(e), np.sin(e)])
        assert turn_and_tilt(3 * direction, ahead) == f"turned {turn:g}°, tilted {tilt:g}°"
    assert turn_and_tilt(-ahead + [1e-9, 0, 0], -ahead) == "turned 0°, tilted 0°"


def test_an_occluder_beside_the_view_is_drawn_whole():
    layout = RoomPlan(load_scenario("chair", (4, 5), {"occluder_dx": 3}, photograph=(16, 16)))
    points = np.concatenate([solid.points for solid in layout.standing()])
    assert len(points) and (points > layout.low).all() and (points < layout.high).all()


def test_wall_that_lies_is_drawn_as_the_plan_with_up_upwards():
    """The doorway's ceiling: its picture's top is towards -y, the room below it, past the jamb."""
    scenario = load_scenario("doorway", (6, 8), photograph=(12, 12))
    layout = RoomPlan(scenario)
    assert (layout.axes, *layout.mirrored, layout.wall) == ((0, 1, 2), False, True, False, (0, 1))
    figure = draw(scenario)
    found = {ax.get_title(): ax for ax in figure.axes}
    assert list(found) == ["from the front", "from the side", TITLES[0], "in space"]
    wall = found[TITLES[0]]
    assert found["from the front"].get_ylabel() == "z / m" and wall.get_ylabel() == "y / m"
    assert found["from the side"].get_ylim() == found["from the front"].get_ylim()
    assert wall.get_ylim()[0] > wall.get_ylim()[1] and wall.get_xlim()[0] < wall.get_xlim()[1]
    assert {"hidden_room", "door", "seen by the camera"} <= {t.get_text() for t in wall.texts}
    for title in ("from the front", "from the side"):
        low, high = found[title].get_ylim()
        assert low < high
        places = {text.get_text(): text.get_position()[1] for text in found[title].texts}
        assert places["hidden_room"] < places["seen by the camera"]
    share, (left, right, bottom, top) = wall.images[0].get_array(), wall.images[0].get_extent()
    x = np.linspace(left, right, share.shape[1])
    y = np.linspace(bottom, top, share.shape[0])
    seen = RegularGridInterpolator((y, x), share)
    np.testing.assert_allclose(seen([(-0.4, -0.02), (0.2, 0.2)]), [0, 1])  # (y, x)
    assert 0 < seen([(0.2, -0.2)]) < 1
    assert facts(layout)[-1] == "hidden_room: curved."


def test_every_hidden_surface_is_drawn_and_named(tmp_path):
    text = find_scene("plate").read_text()
    card = """<shape type="rectangle" id="hidden_card"><transform name="to_world">
        <scale x="0.05" y="0.1"/><rotate x="1" angle="-90"/><translate x="0.2" y="0.3" z="0.2"/>
        </transform></shape></scene>"""
    (tmp_path / "two.xml").write_text(text.replace("</scene>", card))
    sizes = {"monitor": (3, 4), "hidden_card": (2, 2)}
    two = load_scenario(tmp_path / "two.xml", sizes, photograph=(12, 12))
    lines = facts(RoomPlan(two))
    assert "Monitor: 40.2 cm x 30.6 cm, 1.03 m from the wall, turned 0°, tilted 0° from" in lines[1]
    assert lines[2].startswith("hidden_card: 10 cm x 20 cm, 73 cm from the wall")
    for ax in draw(two).axes:
        assert {"monitor", "hidden_card"} <= {label.get_text() for label in ax.texts}
    corners = RoomPlan(two).survey.corners["hidden_card"]
    assert corners.shape == (3, 3, 3)
    np.testing.assert_allclose(corners[0, 0], [0.15, 0.3, 0.1], atol=1e-4)  # its top hangs
    np.testing.assert_allclose(corners[2, 2], [0.25, 0.3, 0.3], atol=1e-4)
