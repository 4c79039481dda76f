import numpy as np
import pytest

from periscopy_sim.rendering import shadow_check
from periscopy_sim.rendering.shadow_check import shadow_doubt


def block(x, y, z, half=(0.04, 0.01, 0.04), name="block"):
    return (
        f'<shape type="cube" id="{name}"><transform name="to_world"><scale x="{half[0]}" '
        f'y="{half[1]}" z="{half[2]}"/><translate x="{x}" y="{y}" z="{z}"/></transform></shape>'
    )


def test_an_occluder_between_monitor_and_wall_casts_its_shadow(room):
    assert shadow_doubt(room.load(block(0.45, 0.5, 0.3))) == ""
    assert shadow_doubt(room.load(room.blocker("0.45, 0.5, 0.3", 0.03))) == ""


def test_a_wire_of_a_millimetre_casts_enough(room):
    wire = block(0.45, 0.5, 0.3, (0.0005, 0.0005, 1.0))
    assert shadow_doubt(room.load(wire)) == ""


def test_one_shadow_is_enough_whatever_else_stands_around(room):
    assert shadow_doubt(room.load(block(0.45, 0.5, 0.3), block(3, -1, 0, name="cupboard"))) == ""


@pytest.mark.parametrize(
    ("place", "half", "told"),
    [
        ((0.3, -0.4, 0.3), 0.04, "x 0.3, y -0.4, z 0.3 m: behind the monitor"),
        ((0.3, 1.4, 0.3), 0.04, "y 1.4, z 0.3 m: behind the wall"),
        ((2.5, 0.5, 0.3), 0.04, "x 2.5, y 0.5, z 0.3 m: beside all lines between the two"),
        ((0.45, 0.5, 0.3), 4e-5, "'block' is 8e-05 m large, its middle at x 0.45, y 0.5"),
        ((0.45, 0.5, 0.3), 4e-5, "are its numbers metres?"),
        ((450, 500, 300), 40, "'block' is 80 m large, its middle at x 450, y 500, z 300 m: are "),
        ((0.45, -500, 0.3), 0.04, "y -500, z 0.3 m: are its numbers metres?"),
    ],
)
def test_an_occluder_without_a_shadow_is_named_with_its_place(room, place, half, told):
    doubt = shadow_doubt(room.load(block(*place, (half, half, half))))
    assert doubt.startswith("no occluder casts a shadow of the monitor")
    assert told in doubt
    assert "\n" not in doubt


def test_no_occluder_and_one_that_hides_all_are_told(room):
    assert shadow_doubt(room.load()).startswith("nothing stands between")
    hiding = shadow_doubt(room.load(block(0.4, 0.2, 0.3, (2, 0.01, 2))))
    assert hiding.startswith("occluders hide all of the monitor from what the camera sees")
    assert "'block' is 4 m large" in hiding


def test_share_of_hidden_rays_is_that_of_a_plate_in_closed_form(room, monkeypatch):
    """Between parallel, equal rectangles 1 m apart, an endless edge halfway hides what it must.

    A ray from (x, 0) on the monitor to (X, 1) on the wall passes x + X over 2; the plate hides
    what passes beyond its edge, which the triangular law of the sum of two uniforms tells.
    """
    seen = []
    blocked = shadow_check.Survey.blocked

    def counted(self, starts, ends):
        found = blocked(self, starts, ends)
        seen.append(found.mean())
        return found

    monkeypatch.setattr(shadow_check.Survey, "blocked", counted)
    # Monitor x in (0, 0.4), wall x in (0.5, 0.9): their mean runs from 0.25 to 0.65.
    edge = 0.35
    half = (edge - 0.25) / 0.4
    shadow_doubt(room.load(block(edge - 2, 0.5, 0.3, (2, 1e-4, 2)), camera=room.camera((64, 64))))
    expected = 2 * half**2
    error = np.sqrt(expected * (1 - expected) / shadow_check.RAYS)
    assert abs(seen[0] - expected) < 5 * error + 2e-3  # pixels' middles alone are tried
