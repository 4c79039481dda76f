import pytest

import periscopy_sim as ps
from periscopy_sim.rendering.pierced import pierced

SMALL = {"resolution": 12}


def chair(**values):
    return ps.load_scenario("chair", (3, 4), {**SMALL, **values})


@pytest.mark.parametrize("scene", ["chair", "plate", "bright_room", "plant"])
def test_shipped_scenes_are_free(scene):
    assert pierced(ps.load_scenario(scene, (3, 4))) == ""


def test_chair_in_the_monitor_is_named():
    told = pierced(chair(occluder_dx=-0.25, occluder_dy=-0.63))
    assert told.endswith("stands in the monitor")
    assert "'chair_seat'" in told


def test_chair_beside_or_behind_the_monitor_is_free():
    assert pierced(chair(occluder_dy=-0.63)) == ""
    assert pierced(chair(occluder_dx=-0.25, occluder_dy=-0.75)) == ""
    assert pierced(chair(occluder_dx=-0.25, occluder_dy=-0.58)) == ""


def test_thin_board_in_the_monitor_is_found():
    """A plate of 1 mm that is turned into the screen."""
    scene = {"occluder_dx": -0.28, "occluder_dy": -0.57, "occluder_turn": 90}
    told = pierced(ps.load_scenario("plate", (3, 4), {**SMALL, **scene}))
    assert told == "'plate', 'stick' stands in the monitor" or told.startswith("'plate'")


def test_what_stands_in_the_wall_is_named():
    """Seen by a camera that looks past it from beside: it hides no pixel's middle."""
    values = {"occluder_dx": 0.25, "occluder_dy": 0.449, "width": 12, "height": 10}
    try:
        scene = ps.load_scenario("plant", (3, 4), values)
    except ps.PeriscopyError as error:  # refused before: it hides the wall
        assert "miss the wall" in str(error)
        return
    assert pierced(scene).endswith("stands in the wall")
