"""Scenes at the edge of geometry: a matrix that the closed form confirms, or one clear line."""

import numpy as np
import pytest

from periscopy_sim.analytic.area_transport import analytic_transport, has_areas
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.transport.shadow_rays import render_transport


def box(x, y, z, half):
    scale, place = (
        " ".join(f'{k}="{v}"' for k, v in zip("xyz", each, strict=True))
        for each in (half, (x, y, z))
    )
    return (
        f'<shape type="cube" id="box"><transform name="to_world"><scale {scale}/>'
        f"<translate {place}/></transform></shape>"
    )


def both(scenario):
    """The matrix, rendered, once the closed form, where there is one, has confirmed it."""
    rendered = render_transport(scenario, samples=1024, strata="midpoint")
    assert np.isfinite(rendered).all() and (rendered >= 0).all()
    if has_areas(scenario):
        # Of 1024 samples a shadow's edge crosses some 32, each half wrong.
        error = np.linalg.norm(rendered - analytic_transport(scenario))
        assert error < 0.03 * np.linalg.norm(rendered)
    return rendered


def line(room, *extra, **parts):
    with pytest.raises(SceneError) as caught:
        room.load(*extra, **parts)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_monitor_within_a_box_lights_nothing(room):
    closed = room.load(box(0, 0, 0, (1, 0.1, 1)))
    with pytest.raises(SceneError, match="no light of the monitor reaches the wall"):
        render_transport(closed)


@pytest.mark.parametrize("turn", [90, 89.9999, 90.0001])
def test_monitor_turned_edge_on_lights_the_side_that_it_faces(room, turn):
    A = both(room.load(monitor=room.monitor(turn=turn)))
    assert (A > 0).all()
    away = line(room, monitor=room.monitor(turn=turn + 180))
    assert "faces away from the wall" in away


@pytest.mark.parametrize(
    ("film", "hidden"),
    [((1, 1), (1, 1)), ((1, 9), (1, 1)), ((1, 9), (3, 3)), ((7, 3), (1, 5)), ((5, 6), (30, 1))],
)
def test_every_size_down_to_one_pixel_and_one_patch_is_rendered(room, film, hidden):
    # Of odd size: no ray of the few meets an edge, where rounding would decide.
    block = box(0.455, 0.454, 0.276, (0.048, 0.043, 0.073))
    A = both(room.load(block, camera=room.camera(film), hidden=hidden))
    assert A.shape == (film[0] * film[1], hidden[0] * hidden[1])


def test_patches_sum_up_to_the_one_that_they_cut(room):
    whole = both(room.load(hidden=(1, 1)))
    for hidden in ((1, 30), (30, 1), (3, 5)):
        parts = both(room.load(hidden=hidden)).sum(axis=1, keepdims=True)
        np.testing.assert_allclose(parts, whole, rtol=2e-3)
