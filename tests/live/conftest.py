import time
from contextlib import ExitStack

import pytest

from experiments.benchmarks import live
from periscopy_sim.live.looks import find_movables
from periscopy_sim.live.pictures import Choice, SizedLaboratory
from periscopy_sim.live.session import LiveSession
from periscopy_sim.scenario import load_scenario

PHOTOGRAPH, HIDDEN = (24, 24), (6, 8)


def plate():
    return load_scenario("plate", HIDDEN, photograph=PHOTOGRAPH)


@pytest.fixture(scope="session", autouse=True)
def fast(jit):
    """No laboratory follows a hand where only the scalar variant works."""


@pytest.fixture(scope="module", autouse=True)
def small(quick_light):
    """Make each A quickly."""


@pytest.fixture
def level():
    """Make the plate's laboratory at a small size, with some light and a photograph."""

    def make(light=None, photograph=None):
        return SizedLaboratory(plate(), photograph, light, is_coarse=True)

    return make


@pytest.fixture(scope="session")
def movables():
    return find_movables(plate())


@pytest.fixture
def choice(movables):
    values = {each.name: each.value for each in movables[0]}
    return Choice(values, "mushroom")


@pytest.fixture(scope="module")
def opened():
    """Run sessions whose `shown` are the moments and the pictures that their pages have shown."""
    shown, show = [], LiveSession.show

    def watched(page, pictures):
        show(page, pictures)
        shown.append((time.monotonic(), pictures))

    with ExitStack() as stack:
        stack.enter_context(pytest.MonkeyPatch.context()).setattr(LiveSession, "show", watched)

        def open_session(scenario, place, light, save):
            first = Choice({}, "mushroom", place)
            session = LiveSession(scenario, first, save, lambda _: [], light=light)
            session.shown = shown
            stack.enter_context(session)
            stack.enter_context(live.running(session))
            return session

        yield open_session
