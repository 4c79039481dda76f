"""The layout that a scene's text describes, against Mitsuba's own parser."""

import numpy as np
import pytest

from periscopy_sim.rendering.scene.document import read_elements
from periscopy_sim.rendering.scene.nodes import SceneNodes
from periscopy_sim.rendering.scene.placement import written_layout

DEFAULTS = (
    '<default name="a" value="0.7"/><default name="ab" value="$a"/><default name="x" value="25"/>'
)
UNDERSTOOD = [
    '<translate x="$a"/>',
    '<translate x=" $a" z="+$a"/>',
    '<translate value="1, $a 3"/>',
    '<scale y="$a" z="-2"/>',
    '<scale value="$a"/>',
    '<scale value=" 1,  $a, .5"/>',
    '<rotate x="1" y="$a" z="-2e0" angle="30"/>',
    '<rotate value="0 0 2" angle="1.$x$x"/>',
    '<rotate z="1" angle="1$x"/>',
    '<lookat origin="$a, 0.98, 0" target="0 0 $ab" up="0, 0, 2"/>',
    '<matrix value="1 0 0 $a  0 0 -1 $ab  0 1 0 2  0 0 0 1"/>',
    '<matrix value="$a 0 0  1 2 0  0 1 1"/>',
]


def layouts(folder, steps, numbers="", values=None, cylinder=""):
    """Return the text's layout and the one that Mitsuba's nodes confirm."""
    path, part = folder / "scene.xml", folder / "part.xml"
    part.write_text(f'<shape version="3.0.0" type="disk">{to_world(steps)}</shape>')
    shape = f'<shape type="cylinder" id="s">{cylinder}{to_world(steps)}</shape>'
    group = f'<shape type="shapegroup" id="g"><shape type="cube">{to_world(steps)}</shape></shape>'
    camera = f'<sensor type="perspective">{numbers}{to_world(LOOK)}<film type="hdrfilm"/></sensor>'
    texts = (DEFAULTS, shape, '<include filename="part.xml"/>', camera, group)
    path.write_text(f'<scene version="3.0.0">{"".join(texts)}</scene>')
    nodes = SceneNodes(path, values, required={})
    confirmed = nodes.layout()
    return written_layout(read_elements(path, values)[1], list(confirmed.places)), confirmed


def to_world(steps):
    return f'<transform name="to_world">{steps}</transform>'


LOOK = '<lookat origin="$a, 0, 0" target="0 1 0" up="0, 0, 1"/>'
RULED = (
    '<point name="p0" x="$a" y="0" z="1"/><point name="p1" value="1 $a 0"/>'
    '<float name="radius" value="$a"/>'
)


@pytest.mark.parametrize("step", UNDERSTOOD)
@pytest.mark.parametrize("values", [{}, {"a": "1.25", "x": "6"}, {"a": "3e-2", "ab": "1.5"}])
def test_text_is_read_as_mitsuba_reads_it(tmp_path, step, values):
    for steps in (step, f'{UNDERSTOOD[6]}{step}<translate y="$ab"/>'):
        _, confirmed = layouts(tmp_path, steps, '<float name="fov" value="$x.5"/>', values)
        assert confirmed.rest is not None
        assert len(confirmed.places) == 5


def test_numbers_of_a_cylinder_and_of_a_view_are_read(tmp_path):
    for values in ({}, {"a": "0.4"}):
        for fov in ('<float name="fov" value="$x.5"/>', '<integer name="fov" value="40"/>', ""):
            _, confirmed = layouts(tmp_path, UNDERSTOOD[6], fov, values, RULED)
            assert confirmed.rest is not None


def test_what_only_mitsuba_understands_is_left_to_her(tmp_path):
    written, confirmed = layouts(tmp_path, '<lookat origin="$a, 0.98, 0" target="0 0 $ab"/>')
    assert np.isnan(written.places["s"]).any()
    assert confirmed.rest is None
    assert np.isfinite(confirmed.places["s"]).all()
