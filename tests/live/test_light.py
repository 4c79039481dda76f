import time

import pytest

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.light import AmbientLight
from periscopy_sim.shipped import find_scene


@pytest.fixture
def light():
    arrived = []
    made = AmbientLight(find_scene("plate"), {}, (40, 40), arrived.append)
    made.arrived = arrived
    yield made
    made.close()


def wait_for(holds):
    end = time.monotonic() + 300
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.1)


@pytest.mark.thorough
def test_light_comes_from_a_process_of_its_own(light):
    light.want("overcast")
    assert light.photograph("overcast") is None
    wait_for(lambda: light.arrived)
    photograph = light.photograph("overcast")
    assert photograph.shape == (40, 40, 3) and photograph.min() > 0
    assert photograph[:20].mean() > photograph[20:].mean()  # the sky is above


@pytest.mark.thorough
def test_scene_that_lights_nothing_is_told(light, tmp_path):
    broken = tmp_path / "broken.xml"
    broken.write_text("<scene version='3.0.0'></scene>")
    light.want(str(broken))
    wait_for(lambda: light.arrived)
    with pytest.raises(PeriscopyError, match="broken"):
        light.photograph(str(broken))


def test_unknown_place_is_told(light):
    with pytest.raises(PeriscopyError, match="no ambient condition 'mars'"):
        light.want("mars")


def test_only_the_latest_place_is_rendered(light):
    places = ["overcast", "low_sun", "overcast", "corridor"]
    processes = []
    for place in places:
        light.want(place)
        processes.append(light._rendering[1])
        assert sum(each.poll() is None for each in processes) == 1
    assert light._rendering[0] == places[-1]
    light.close()
    assert processes[-1].poll() is not None and not light.arrived
