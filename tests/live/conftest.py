import pytest

from periscopy_sim.live.movable import find_movables
from periscopy_sim.live.pictures import Choice, SizedLaboratory
from periscopy_sim.rendering.scene.load import load_scenario

PHOTOGRAPH, HIDDEN = (24, 24), (6, 8)


def plate():
    return load_scenario("plate", HIDDEN, photograph=PHOTOGRAPH)


@pytest.fixture(scope="session", autouse=True)
def fast(jit):
    """No laboratory follows a hand where only the scalar variant works."""


@pytest.fixture
def level():
    """Make the plate's laboratory at a small size, with some light and a photograph."""

    def make(light=None, photograph=None):
        return SizedLaboratory(plate(), light, photograph, is_coarse=True)

    return make


@pytest.fixture(scope="session")
def movables():
    return find_movables(plate())


@pytest.fixture
def choice(movables):
    values = {each.name: each.value for each in movables[0]}
    return Choice(values, "mushroom")
