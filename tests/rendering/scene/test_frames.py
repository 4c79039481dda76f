"""Results do not depend on the frame in which a user describes a scene, nor on its unit."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.errors import SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport

PLATE = """<shape type="rectangle" id="plate"><transform name="to_world"><scale x="0.05" y="0.07"/>
<rotate x="1" angle="70"/><translate x="0.45" y="0.5" z="0.3"/></transform></shape>"""
AXES = [(1, 0, 0), (0, 0.6, 0.8), (2 / 3, -1 / 3, 2 / 3)]


def framed(room, transform=""):
    """Load the room with a plate, all of it in another frame."""
    path = room.write(PLATE, camera=room.camera((10, 12)))
    path.write_text(path.read_text().replace("</transform>", f"{transform}</transform>"))
    return load_scenario(path, (2, 3))


def relative(found, expected):
    return np.linalg.norm(found - expected) / np.linalg.norm(expected)


@settings(max_examples=12, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip
@given(
    axis=st.sampled_from(AXES),
    angle=st.floats(-180, 180),
    scale=st.sampled_from([0.01, 0.3, 1, 39.37, 1000]),
    shift=st.tuples(*[st.floats(-10, 10)] * 3),
    is_mirrored=st.booleans(),
)
def test_a_scene_moved_turned_scaled_or_mirrored_is_the_same(
    room, axis, angle, scale, shift, is_mirrored
):
    """Single precision, 10 m from a field of view of 0.4 m: 3e-5. A mirror swaps left and right."""
    x, y, z = axis
    place = " ".join(f'{name}="{scale * each}"' for name, each in zip("xyz", shift, strict=True))
    scenario = framed(
        room,
        f'<scale x="{-scale if is_mirrored else scale}" y="{scale}" z="{scale}"/>'
        f'<rotate x="{x}" y="{y}" z="{z}" angle="{angle}"/><translate {place}/>',
    )
    original = framed(room)
    A = area_transport(scenario).reshape(-1, 2, 3)
    A = A[..., ::-1] if is_mirrored else A
    assert relative(A.reshape(-1, 6), area_transport(original)) < 3e-4
    B = scale**2 * point_light_backgrounds(scenario)
    same = point_light_backgrounds(original)
    if not is_mirrored:  # the grid begins at -3 m, and ends before 3 m
        assert relative(B, same) < 3e-4
    rendered = render_transport(scenario, samples=64).reshape(-1, 2, 3)
    assert relative(rendered[..., ::-1] if is_mirrored else rendered, A) < 0.03


def test_what_single_precision_does_not_resolve_is_refused(room):
    framed(room, '<translate x="200"/>')
    for place in ('x="1e4"', 'y="-1e6"', 'z="1e30"'):
        with pytest.raises(SceneError, match=r"origin|camera|scene"):
            framed(room, f"<translate {place}/>")
