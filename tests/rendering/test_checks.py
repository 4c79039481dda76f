import numpy as np
import pytest

from periscopy_sim.rendering.survey import RAYS, hidden_fraction, shadow_doubt


def test_a_wire_of_a_millimetre_between_monitor_and_wall_is_a_shadow(room):
    assert shadow_doubt(room.load(room.cube((0.45, 0.5, 0.3), (0.0005, 0.0005, 1.0)))) == ""


@pytest.mark.parametrize("place", [(0.3, -0.4, 0.3), (0.3, 1.4, 0.3), (2.5, 0.5, 0.3)])
def test_an_occluder_without_a_shadow_is_named(room, place):
    assert "'box'" in shadow_doubt(room.load(room.cube(place, (0.04, 0.04, 0.04))))


def test_a_scene_without_occluders_or_without_light_is_doubted(room):
    assert "no occluder" in shadow_doubt(room.load())
    assert "hide all" in shadow_doubt(room.load(room.cube((0.4, 0.2, 0.3), (2, 0.01, 2))))


def test_fraction_of_blocked_paths_is_that_of_a_plate_in_closed_form(room):
    """Between parallel, equal rectangles 1 m apart, an endless edge halfway hides what it must.

    A ray from (x, 0) on the monitor to (X, 1) on the wall passes x + X over 2; the plate hides
    what passes beyond its edge: the triangular distribution of the sum of two uniform variables.
    """
    # Monitor x in (0, 0.4), wall x in (0.5, 0.9): their mean runs from 0.25 to 0.65.
    edge = 0.35
    expected = 2 * ((edge - 0.25) / 0.4) ** 2
    plate = room.cube((edge - 2, 0.5, 0.3), (2, 1e-4, 2))
    hidden = hidden_fraction(room.load(plate, camera=room.camera((64, 64))))
    error = np.sqrt(expected * (1 - expected) / RAYS)
    assert abs(hidden - expected) < 5 * error + 2e-3  # rays end at the pixels' centres
