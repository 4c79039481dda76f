from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.calibration.resolution_level import Candidate, Look
from periscopy_sim.calibration.search import Search, descend
from tests.scenes.calibration import TRUTH, Small


class Valleys:
    """A level of one number: valleys of some depth and width; what is below -2 is no scene."""

    photographs, centers, center = 1, np.zeros(1), np.zeros(1)
    terms = np.empty((0, 1))
    sharper = 1.0  # at the last level
    scene = SimpleNamespace(
        is_physical=lambda values: values[0] >= -2, errors=np.ones(1), names=("place",)
    )
    values = staticmethod(lambda point: point)

    def __init__(
        self, places: Sequence[float], bend: float = 1000.0, told: float = 1.0, depth: float = 500.0
    ) -> None:
        self.valleys = [(place, depth * k) for k, place in enumerate(places)]
        self.bend, self.told, self.asked, self.looked = bend, told, 0, [0]

    def with_edges(self, _: Candidate) -> "Valleys":
        edges = copy(self)
        edges.bend *= self.sharper
        return edges

    def with_misfit(self, _: Any) -> "Valleys":
        return self

    def candidate(self, point: Any) -> Candidate:
        self.asked += 1
        cost = min(self.bend * (point[0] - place) ** 2 - depth for place, depth in self.valleys)
        explained = Mock(cost=cost)
        return Candidate(point, (explained,) if point[0] >= -2 else (), float(point[0] ** 2))

    def look(self, candidate: Candidate, temperature: float = 1.0) -> Look:
        self.looked.append(self.asked)
        point, there = candidate.point, candidate.point[0]
        costs = [self.bend * (there - place) ** 2 - depth for place, depth in self.valleys]
        slope = self.bend * (point - self.valleys[int(np.argmin(costs))][0])
        told = np.array([[self.told * self.bend]])
        shared = point, candidate.explanations, candidate.penalty
        return Look(*shared, slope, point.copy(), told, np.ones(1), temperature)


def test_fine_descents_start_once_in_each_valley_first_in_the_priors_own() -> None:
    level: Any = Valleys([0.0, 1.6])
    own, other = Search(level, level, level, 0).starts()
    assert own.point == pytest.approx(0, abs=0.1) and other.point == pytest.approx(1.6, abs=0.1)


@pytest.mark.parametrize(("depth", "found"), [(300.0, 1.6), (4.0, 0.0)])
def test_the_deepest_valley_wins_if_it_is_significantly_deeper(depth: float, found: float) -> None:
    """Also where its descent starts higher than another."""
    level: Any = Valleys([0.0, 0.8, 1.6], depth=depth)
    starts = [level.candidate(np.array([place])) for place in (0.0, 0.8, 1.03)]
    assert starts[2].cost > starts[1].cost
    _, best = Search(level, level, level, 0).best(starts)
    assert best.point == pytest.approx(found, abs=0.1)


@pytest.mark.parametrize(("sharper", "last"), [(0.6, 1.0), (1.0, 2.0), (100.0, 4.0)])
def test_nothing_follows_a_descent_that_leaves_the_prior(sharper: float, last: float) -> None:
    """A valley 10 errors away leads too far from some temperature on, the colder the flatter it is.

    A last descent that stays hot does not count: the fine one ended 2 errors from the start.
    """
    level: Any = Valleys([10.0], bend=1.0)
    level.sharper = sharper
    visited: list[tuple[int, Any]] = []

    class Watched(Search):
        def visit(self, stage: int, candidate: Candidate) -> None:
            visited.append((stage, candidate))

    _, best = Watched(level, level, level, 0).best([level.candidate(np.zeros(1))])
    assert (visited[-1][0], visited[-1][1].temperature) == (3, last)
    assert best.temperature == 4 and best.point == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(
    "aside", [(0.0, -0.0186), pytest.param((0.0203, 0.0), marks=pytest.mark.thorough)]
)
def test_a_search_hops_out_of_valleys_whose_image_lies_a_patch_aside(
    small: Small, aside: tuple[float, float]
) -> None:
    """Of an occluder that stands as much aside, where a descent alone stays."""
    problem = small.problem()
    search = Search(problem.coarse(), problem.fine(), problem.joint(), 0)
    start = np.append(list(TRUTH.values()), np.zeros(len(search.fine.terms)))
    start[:2] += aside
    stays = search.fine.look(search.fine.candidate(start), 8.0)
    for _ in range(3):
        stays = descend(search.fine, stays, 8.0)
    assert stays.point[:2] - start[:2] == pytest.approx(0, abs=0.002)
    _, found = search.best([search.fine.candidate(start)])
    assert found.point[:2] == pytest.approx(list(TRUTH.values())[:2], abs=0.0005)


class Placed(Valleys):
    """Of an image, too, that takes the number along by 1 a patch."""

    centers, center = np.zeros(2), np.zeros(2)

    def look(self, candidate: Candidate, temperature: float = 1.0) -> Look:
        information = 1e6 * np.array([[1.0, -1.0], [-1.0, 1.0]])
        shared = candidate.point, candidate.explanations, candidate.penalty
        return Look(*shared, np.zeros(2), np.zeros(2), information, np.ones(2), temperature)


@pytest.mark.parametrize(("deeper", "variance"), [(0.0, 0.55), (-120.0, 0.0)])
def test_places_of_the_image_that_are_as_likely_widen_the_errors(
    deeper: float, variance: float
) -> None:
    """Of a place that is a ruler error away, and as likely but for that: e^-½ / (½ + e^-½)."""
    level: Any = Valleys([0.0, 1.0], bend=100.0, depth=deeper)
    search = Search(level, level, Placed([0.0]), 0)  # type: ignore[arg-type]
    search.best([level.candidate(np.zeros(1))])
    assert search.spread[0] == pytest.approx(variance, abs=0.1)


def test_a_search_ends_at_the_likeliest_of_its_places() -> None:
    """Where it came from is a rival, though no other place is e times as likely."""
    level: Any = Valleys([0.0, 1.0], bend=150.0, depth=0.0)
    search = Search(level, level, Placed([0.0]), 0)  # type: ignore[arg-type]
    _, found = search.best([level.candidate(np.ones(1))])
    ((rival, odds),) = search.rivals
    assert found.point == pytest.approx(0, abs=0.1) and rival.point == pytest.approx(1, abs=0.1)
    assert 0.5 < odds < 1 and search.spread[0] == pytest.approx(0.55, abs=0.1)


def test_an_end_that_falls_back_is_no_rival(small: Small) -> None:
    """Where only the monitor's turn is free, nothing can follow an image aside."""
    scenario = small.scenario.at(**TRUTH)
    alone = replace(
        small.problem(), scenario=scenario, names=("monitor_turn",), centers=np.array([0.3]),
        errors=np.array([0.5]),
    )  # fmt: skip
    search = Search(alone.coarse(), alone.fine(), alone.joint(), 0)
    _, found = search.best(search.starts())
    assert found.point[0] == pytest.approx(0.3, abs=0.2) and search.rivals == []


@pytest.mark.parametrize(("told", "asked"), [(1.0, 1), (1.4, 1), (1.6, 2), (3.5, 3)])
def test_a_step_is_doubled_only_where_a_parabola_falls_on(told: float, asked: int) -> None:
    """Information t times too large makes steps of 1/t: twice that is better if t exceeds 1.5."""
    level: Any = Valleys([1.0], told=told)
    start = level.look(level.candidate(np.zeros(1)))
    level.asked, level.looked = 0, [0]
    descend(level, start, 1.0)
    assert level.looked[1] == asked


class Corner(Valleys):
    """Of two numbers: the evidence rises at once where the first is 0, and falls with the other."""

    centers, center = np.zeros(2), np.zeros(2)

    def candidate(self, point: Any) -> Candidate:
        x, y = point
        evidence = 400 * x if x > 0 else -20 * x
        explanations: Any = (SimpleNamespace(cost=evidence + 100 * (y - 1) ** 2),)
        return Candidate(point, explanations, float(point @ point))

    def look(self, candidate: Candidate, temperature: float = 1.0) -> Look:
        point = candidate.point
        slope = np.array([200.0 if point[0] > 0 else -10.0, 100 * (point[1] - 1)])
        shared = point, candidate.explanations, candidate.penalty
        return Look(*shared, slope, point.copy(), np.diag([10.0, 100]), np.ones(2), temperature)


def test_a_corner_of_one_number_does_not_hold_the_others() -> None:
    level: Any = Corner([])
    end = descend(level, level.look(level.candidate(np.array([-0.01, 0.0]))), 1.0)
    assert end.point == pytest.approx([0, 1], abs=0.1)


@pytest.mark.usefixtures("jit", "quick")
def test_an_image_of_one_row_cannot_hop_out_of_its_surface() -> None:
    """Up and down it would be black: the search goes on without these hops."""
    row, size = (1, 7), {"resolution": "24"}
    scene = ps.load_scenario("chair", row, size).at(occluder_dx=0.004).averaged(5)
    light = area_transport(scene) @ np.random.default_rng(0).uniform(0.2, 1, (7, 3))
    y = ps.add_noise(light.reshape(24, 24, 3), 60, 0)
    found = ps.calibrate(y, "chair", row, {"occluder_dx": 0.005}, parameters=size)
    assert found.values["occluder_dx"] == pytest.approx(0.004, abs=0.001)
