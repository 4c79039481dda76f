import time
from contextlib import ExitStack
from dataclasses import dataclass

import pytest

from experiments.benchmarks.live import running
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.live.pictures import Choice, Overtaken
from periscopy_sim.live.session import LiveSession
from periscopy_sim.scenario import load_scenario

pytest.importorskip("websockets")

PATIENCE = 120.0


@dataclass(frozen=True)
class Picture:
    choice: object
    is_coarse: bool


class StandIn:
    """A level that takes its time, and looks now and then whether it is overtaken."""

    def __init__(self, shown, *, is_coarse):
        self.shown, self.is_coarse, self.seconds = shown, is_coarse, 0.0
        self.begun, self.given_up = [], []

    def follow(self, choice, unless_overtaken):
        self.begun.append(choice)
        if isinstance(choice, Exception):
            raise choice
        end = time.monotonic() + self.seconds
        while time.monotonic() < end:
            try:
                unless_overtaken()
            except Overtaken:
                self.given_up.append(choice)
                raise
            time.sleep(0.002)
        self.shown.append(Picture(choice, self.is_coarse))


class Following(LiveSession):
    """A session of stand-ins, and what it has shown and reported."""

    def __init__(self):
        scenario = load_scenario("plate", (3, 4), photograph=(12, 12))
        super().__init__(scenario, Choice({}, "mushroom"), lambda _: "", lambda _: [])
        self.shown, self.reported = [], []
        self.coarse = self._coarse = StandIn(self.shown, is_coarse=True)
        self.full = self._full = StandIn(self.shown, is_coarse=False)
        self.choice = "first"

    def follow(self, laboratory, choice, check):
        laboratory.follow(choice, check)

    def show_trouble(self, text, **_):
        self.reported.append(text)

    def follow_now(self, choice, rest=0.0):
        self.choice = choice
        self.want(rest)

    def until(self, holds):
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end, (self.shown, self.reported)
            time.sleep(0.005)


@pytest.fixture
def watched():
    with ExitStack() as stack:

        def make(coarse=0.0, full=0.0):
            made = stack.enter_context(Following())
            stack.enter_context(running(made))
            made.until(lambda: len(made.shown) == 2 and made.reported)  # the first choice
            for each in made.shown, made.coarse.begun, made.full.begun:
                each.clear()
            made.coarse.seconds, made.full.seconds = coarse, full
            return made

        yield make


def test_coarse_pictures_come_first_and_full_ones_last(watched):
    w = watched(full=0.2)
    w.follow_now("here")
    w.until(lambda: Picture("here", False) in w.shown)
    assert w.shown == [Picture("here", True), Picture("here", False)]


def test_what_is_overtaken_is_dropped_and_not_queued(watched):
    w = watched(coarse=0.1)
    for number in range(50):
        w.follow_now(number, 0.5)
        time.sleep(0.01)
    w.until(lambda: Picture(49, False) in w.shown)
    assert 3 <= len(w.coarse.begun) <= 20
    assert w.coarse.begun == sorted(w.coarse.begun)
    assert w.full.begun == [49]


def test_full_pictures_that_are_overtaken_are_given_up(watched):
    w = watched(full=5.0)
    w.follow_now("first")
    w.until(lambda: w.full.begun == ["first"])
    w.full.seconds = 0.0
    w.follow_now("second")
    w.until(lambda: Picture("second", False) in w.shown)
    assert w.full.given_up == ["first"]
    assert Picture("first", False) not in w.shown


def test_what_cannot_be_shown_is_reported_and_the_laboratory_goes_on(watched):
    w = watched()
    w.follow_now(PeriscopyError("no such\nscene"))
    w.until(lambda: "no such scene" in w.reported)
    w.follow_now(RuntimeError("bug"))
    w.until(lambda: "RuntimeError: bug" in w.reported)
    w.follow_now("better")
    w.until(lambda: Picture("better", False) in w.shown)
    assert w.reported[-1] == ""


def test_a_choice_that_is_done_in_full_is_followed_in_full_alone(watched):
    w = watched()
    w.follow_now("here")
    w.until(lambda: Picture("here", False) in w.shown)
    w.want()
    w.until(lambda: len(w.shown) > 2)
    assert w.shown == [Picture("here", True)] + [Picture("here", False)] * 2
    w.follow_now("there")
    w.until(lambda: Picture("there", False) in w.shown)
    assert w.shown[3] == Picture("there", True)


def test_a_job_waits_for_full_pictures_which_do_not_wait(watched):
    w = watched(full=0.2)
    shown = []
    w.follow_now("here", 60.0)
    w.at_rest(lambda: shown.extend(w.shown))
    w.until(lambda: shown)
    assert shown[-1] == Picture("here", False)

    def full_disk():
        raise PeriscopyError("disk full")

    w.at_rest(full_disk)
    w.until(lambda: w.reported[-1] == "disk full")
