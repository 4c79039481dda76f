import time
from contextlib import contextmanager

import pytest

from periscopy_sim.live.level import Choice, Level
from periscopy_sim.live.movable import find_movables
from periscopy_sim.shipped import find_scene

PHOTOGRAPH, HIDDEN = (24, 24), (6, 8)


@pytest.fixture(scope="session", autouse=True)
def fast(jit):
    """No laboratory follows a hand where only the scalar variant works."""


@pytest.fixture(scope="module")
def running():
    """Run a laboratory on a page, and record what it shows, when, and what it saves."""
    pytest.importorskip("viser")
    from experiments.benchmarks import live
    from periscopy_sim.live.page import Offered, Page
    from periscopy_sim.live.session import LiveSession

    @contextmanager
    def run(scenario, first, lines, light):
        saved, shown, times, show = [], [], [], Page.show

        def watched(page, pictures):
            show(page, pictures)
            times.append(time.monotonic())
            shown.append(pictures)

        offered = Offered(("mushroom", "bars"), ("noise-aware", "preconditioned"))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Page, "show", watched)
            session = LiveSession(
                scenario, first, offered, lambda each: saved.append(each) or "saved",
                lambda _: lines, light=light,
            )  # fmt: skip
        with session, live.running(session):
            session.saved, session.shown, session.times = saved, shown, times
            yield session

    return run


@pytest.fixture
def level():
    """Make the plate's laboratory at a small size, with some light and a photograph."""

    def make(light=None, photograph=None):
        sizes = PHOTOGRAPH, HIDDEN
        return Level(find_scene("plate"), {}, sizes, light, photograph, is_coarse=True)

    return make


@pytest.fixture(scope="session")
def movables():
    path = find_scene("plate")
    small = Level(path, {}, (PHOTOGRAPH, HIDDEN), is_coarse=True)
    return find_movables({}, small.scenario)


@pytest.fixture
def choice(movables):
    values = {each.name: each.value for each in movables[0]}
    return Choice(values, "mushroom")
