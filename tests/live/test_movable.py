import re

import numpy as np
import pytest

from periscopy_sim.errors import SceneError
from periscopy_sim.live.movable import find_movables
from periscopy_sim.scenario import load_scenario
from periscopy_sim.shipped import find_scene


def found_in(path):
    return find_movables(load_scenario(path, (3, 4), photograph=(16, 16)))


@pytest.fixture(scope="module")
def chair():
    movables, handles = found_in(find_scene("chair"))
    return {each.name: each for each in movables}, {each.name: each for each in handles}


def test_handles_move_what_the_parameters_move_as_one(chair):
    _, handles = chair
    assert {name: handle.names for name, handle in handles.items()} == {
        "chair": ("occluder_dx", "occluder_dy", "occluder_dz"),
        "monitor": ("monitor_dx", "monitor_dy", "monitor_dz"),
        "camera": ("camera_dx", "camera_dz"),
    }
    np.testing.assert_allclose(handles["chair"].directions, np.eye(3), atol=1e-3)
    assert not handles["camera"].directions[:, 1].any()


def test_values_bring_a_handle_to_its_position(chair):
    handle = chair[1]["chair"]
    position = handle.center + np.array([0.01, -0.02, 0.03])
    values = handle.values(position)
    moved = {"occluder_dx": 0.01, "occluder_dy": -0.02, "occluder_dz": 0.03}
    assert values == pytest.approx(moved, abs=1e-5)
    np.testing.assert_allclose(handle.position(values), position)
    camera = chair[1]["camera"]  # which does not move along y
    moved = camera.position(camera.values(camera.center + np.array([0.01, 0.5, 0.02])))
    np.testing.assert_allclose(moved, camera.center + np.array([0.01, 0, 0.02]), atol=1e-9)


def test_sizes_stay_positive_and_places_reach_to_either_side(chair):
    movables, _ = chair
    assert not {"resolution", "occluder_dx_error"} & movables.keys()
    assert {"occluder_turn", "seat_width", "vertical_exponent", "camera_stretch"} <= movables.keys()
    for each in movables.values():
        assert each.low < each.value < each.high
        if each.name.endswith(("thickness", "width", "stretch", "exponent")):
            assert each.low > 0, each
    assert movables["occluder_dx"].low == -movables["occluder_dx"].high <= -0.05


def test_a_scene_without_anything_to_move_is_refused(tmp_path):
    text = find_scene("plate").read_text()
    values = dict(re.findall(r'<default name="(\w+)" value="([^"]*)"/>', text))
    text = re.sub(r"<default [^>]*/>", "", text)
    for name in sorted(values, key=len, reverse=True):
        text = text.replace(f"${name}", values[name])
    fixed = tmp_path / "fixed.xml"
    fixed.write_text(text)
    with pytest.raises(SceneError, match="declares nothing that can be moved"):
        found_in(fixed)
