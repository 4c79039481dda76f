from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.ruled_starts import (
    DESCENTS,
    MOST_PLACES,
    PLACES,
    ends_from_ruler,
    places_looked_at,
)

from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.search import ruled_starts
from periscopy_sim.errors import SceneError

RULER, ERRORS = np.array([1.0, -2.0]), np.array([0.1, 2.0])


class TwoDips:
    """Evidence of two numbers that is flat about the ruler's word, with its dip aside.

    What is `beyond`, in the ruler's errors of the first number, is not physical.
    """

    def __init__(self, *, beyond=np.inf, seed=0):
        self.prior, self.seed, self.beyond = Prior(RULER, ERRORS), seed, beyond
        self.dip = RULER + np.array([0.12, -2.4])

    def judged(self, at):
        if self.prior.distance(at)[0] > self.beyond:
            raise SceneError("the plate is in the wall")
        off = (at - self.dip) / ERRORS
        return SimpleNamespace(evidence=-100 * float(np.exp(-off @ off)) + self.prior.penalty(at))


@pytest.fixture(autouse=True)
def descents(monkeypatch):
    """Descents to the dip from within its reach, to where they began from elsewhere."""
    begun = []

    def descend(level, start, *search):
        *_, visit = search
        begun.append(start)
        seen = level.judged(start)
        visit(start, seen.evidence)
        reached = np.linalg.norm((start - level.dip) / ERRORS) < 1
        return level, SimpleNamespace(values=level.dip if reached else start)

    monkeypatch.setattr(ruled_starts, "descend", descend)
    return begun


def ended(level, start=RULER, attempt=0):
    """Return the ends, the places looked at, and where descents were."""
    seen = []
    ends = ends_from_ruler(level, start, ERRORS / 8, lambda *at: seen.append(at), attempt)
    places = len(seen) - len(ends)
    return ends, seen[:places], seen[places:]


def test_a_dip_that_no_descent_from_the_ruler_reaches_is_found_within_its_errors(descents):
    level = TwoDips()
    ends, places, descended = ended(level)
    assert ends[0] is RULER  # where its own descent is held
    assert any(np.array_equal(end, level.dip) for end in ends[1:])
    assert len(ends) == len(descents) == len(descended) == DESCENTS
    assert len(places) == PLACES * 2


def test_descents_follow_on_the_places_of_the_best_evidence(descents):
    _, places, _ = ended(TwoDips())
    best = sorted(places, key=lambda seen: seen[1])[: DESCENTS - 1]
    np.testing.assert_array_equal(descents[1:], [at for at, _ in best])


def test_a_later_attempt_looks_at_other_places_and_descends_from_the_best_alone(descents):
    _, first, _ = ended(TwoDips())
    descents.clear()
    ends, places, _ = ended(TwoDips(), attempt=1)
    assert len(places) == len(first) and len(ends) == DESCENTS
    assert not any(np.array_equal(at, other) for at, _ in places for other, _ in first)
    best = sorted(places, key=lambda seen: seen[1])[:DESCENTS]
    np.testing.assert_array_equal(descents, [at for at, _ in best])


def test_places_are_spread_as_the_ruler_errs():
    off = np.array([TwoDips().prior.distance(at) for at, _ in ended(TwoDips())[1]])
    assert np.abs(off).max() <= 3
    # 16 of Sobol's points are more even than as many of chance.
    assert np.abs(off.mean(axis=0)).max() < 0.2 and np.abs(off.std(axis=0) - 1).max() < 0.2


def test_places_that_are_not_physical_are_drawn_again():
    level = TwoDips(beyond=0.2)
    _, places, _ = ended(level)
    assert len(places) == PLACES * 2
    assert max(level.prior.distance(at)[0] for at, _ in places) <= 0.2


def test_a_descent_that_leaves_the_physical_is_left_out(monkeypatch):
    def refused(level, start, *_):
        if start is not RULER:
            raise SceneError("the plate is in the wall")
        return level, SimpleNamespace(values=start)

    monkeypatch.setattr(ruled_starts, "descend", refused)
    ends, _, _ = ended(TwoDips())
    assert len(ends) == 1 and ends[0] is RULER


def test_a_start_that_is_not_physical_is_an_error():
    with pytest.raises(SceneError, match="in the wall"):
        ended(TwoDips(beyond=-0.1))


def test_the_same_seed_looks_at_the_same_places():
    one, same, other = (ended(TwoDips(seed=seed))[1] for seed in (3, 3, 4))
    np.testing.assert_array_equal([at for at, _ in one], [at for at, _ in same])
    assert not np.array_equal(one[0][0], other[0][0])


@pytest.mark.parametrize(
    ("parameters", "places"), [(1, PLACES), (3, 3 * PLACES), (24, MOST_PLACES)]
)
def test_so_many_places_are_announced(parameters, places):
    assert places_looked_at(parameters) == places
