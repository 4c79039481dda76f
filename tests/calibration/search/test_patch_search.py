"""Descents and walks by turns; both follow a script."""

from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.image_shift import BETWEEN_PATCHES, NEGLIGIBLE, ImageShift
from periscopy_sim.calibration.search.levenberg_marquardt import Descent
from periscopy_sim.calibration.search.patch_search import (
    BESIDE,
    FEW,
    ITERATIONS,
    WALKS,
    search_patches,
)
from periscopy_sim.calibration.search.patch_walk import Walked
from periscopy_sim.calibration.search.telling import CERTAIN

from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.search import patch_search
from periscopy_sim.errors import SceneError

START, PATCH, FOLLOWED = np.array([[0.3, 0.0, 0.0], [0.0, 1.0, 0.0], [0.01, 0.0, 0.0]])
LEVEL = SimpleNamespace(hidden_shape=(1, 5), names=("occluder", "monitor_x", "monitor_z"))


class Searched:
    """What was asked of descents and walks that follow a script, and what came of it."""

    def __init__(self, monkeypatch, settled, walks, unphysical=None):
        self.starts, self.patches, self.walks = [], [], list(walks)
        self.unphysical = unphysical or {}
        monkeypatch.setattr(patch_search, "descend", self.descend)
        monkeypatch.setattr(patch_search, "settle", self.settle)
        monkeypatch.setattr(patch_search, "undone", lambda *_: (np.zeros((3, 0)), None))
        monkeypatch.setattr(patch_search, "walk", self.walk)
        shift = ImageShift(np.eye(3)[1:])
        object.__setattr__(shift, "settled", settled)
        self.found = search_patches(LEVEL, START, np.ones(3), shift, "visit", "looked")

    def descend(self, level, start, steps, longest, iterations, visit):
        """Follow by the occluder, by a hundredth, wherever the monitor is."""
        np.testing.assert_array_equal(longest, 5 * steps)
        assert iterations == ITERATIONS and visit == "visit"
        self.starts.append(start)
        error = self.unphysical.get(len(self.starts))
        if error == "at once":
            raise SceneError("the monitor is in the wall")
        curvature = f"about {len(self.starts)}"
        return level, Descent(start + FOLLOWED, SimpleNamespace(), curvature, error)

    def settle(self, level, end, steps):
        del level, steps
        return end.values, f"seen by {end.curvature}"

    def walk(self, level, end, values, seen, patches, looked, wider):
        del level, end
        assert (looked, wider) == ("looked", 1)
        self.patches.append(patches)
        return Walked(values + self.walks.pop(0), seen, np.zeros((3, 0)), ())


def stays(level, values, seen):
    del level
    return values, seen


def nearest_to_zero(level, values, seen):
    """The ruler has the monitor at 0: whole patches from wherever it is."""
    del level
    return (
        (values, seen) if abs(values[1]) < 0.5 else (values - PATCH * values, "seen a patch away")
    )


def test_where_nothing_is_gained_one_descent_is_all(monkeypatch):
    searched = Searched(monkeypatch, stays, [0 * PATCH])
    np.testing.assert_array_equal(searched.starts, [START])
    np.testing.assert_allclose(searched.found.values, START + FOLLOWED)
    assert searched.found.seen == "seen by about 1"


def test_what_is_shifted_to_the_ruler_is_descended_from_again(monkeypatch):
    """After the walk the monitor is a patch off, which the descent then keeps."""
    searched = Searched(monkeypatch, nearest_to_zero, [PATCH, 0 * PATCH])
    expected = [START, START + FOLLOWED + PATCH, START + 2 * FOLLOWED]
    np.testing.assert_allclose(searched.starts, expected)
    np.testing.assert_allclose(searched.found.values, START + 3 * FOLLOWED)
    assert searched.found.end.curvature == "about 3"
    assert searched.found.seen == "seen by about 3"


@pytest.mark.parametrize("error", ["at once", SceneError("the monitor is in the wall")])
def test_where_the_rulers_image_leads_out_of_the_physical_its_place_is_kept(monkeypatch, error):
    searched = Searched(monkeypatch, nearest_to_zero, [PATCH, 0 * PATCH], {3: error})
    assert len(searched.starts) == 3
    np.testing.assert_allclose(searched.found.values, START + 2 * FOLLOWED)
    assert searched.found.end.curvature == "about 2"
    assert searched.found.end.unphysical is None
    assert searched.found.seen == "seen a patch away"


def test_a_walk_is_followed_by_a_descent_but_for_the_last(monkeypatch):
    searched = Searched(monkeypatch, stays, [PATCH] * (WALKS + 1))
    assert len(searched.starts) == WALKS + 1
    assert searched.found.values[1] == pytest.approx(WALKS + 1)


def test_a_row_of_patches_has_no_place_above(monkeypatch):
    searched = Searched(monkeypatch, stays, [0 * PATCH])
    across, up = searched.patches[0].T
    assert across.any() and not up.any()


class Beside:
    """A search whose walks stay; dips lie beside, of which some lead on to what is better.

    By `better` a descent of few iterations, from the occluder's place at a dip, leads to a gain, of
    which `noise` is the standard error.
    """

    def __init__(self, monkeypatch, dips, better, noise=0.0):
        self.starts, self.tried, self.better, self.noise = [], [], better, noise
        self.dips = [np.array([dip, 0.0, 0.0]) for dip in dips]
        for name in ("descend", "settle", "walk", "least_gain"):
            monkeypatch.setattr(patch_search, name, getattr(self, name))
        monkeypatch.setattr(patch_search, "undone", lambda *_: (np.zeros((3, 0)), None))
        shift = ImageShift(np.eye(3)[1:])
        object.__setattr__(shift, "settled", stays)
        level = SimpleNamespace(
            hidden_shape=(1, 5),
            names=LEVEL.names,
            judged=self.judged,
            prior=Prior.none(3),
            by_area=True,
            seed=0,
            explain=lambda values: f"seen from {values[0]}",
        )
        self.found = search_patches(level, START, np.ones(3), shift, "visit", lambda: None)

    def judged(self, values, seed=None):
        del seed
        return SimpleNamespace(evidence=-self.better.get(round(float(values[0]), 3), 0.0))

    def least_gain(self, level, about, here, there):
        del level
        assert about == "about"
        assert [seen for _, seen in (here, there)] == [
            f"seen from {at[0]}" for at, _ in (here, there)
        ]
        return BETWEEN_PATCHES * max(NEGLIGIBLE, CERTAIN * self.noise)

    def descend(self, level, start, steps, longest, iterations, visit):
        del steps, longest, visit
        if iterations == FEW:
            self.tried.append(float(start[0]))
            if start[0] < 0:
                raise SceneError("the occluder is in the wall")
        else:
            self.starts.append(float(start[0]))
        return level, Descent(start, SimpleNamespace(), "about", None)

    def settle(self, level, end, steps):
        del steps
        return end.values, level.judged(end.values)

    def walk(self, level, end, values, seen, *others):
        del level, end, others
        beside = tuple(dip for dip in self.dips if not np.array_equal(dip, values))
        return Walked(values, seen, np.zeros((3, 0)), beside)


def test_where_a_walk_stays_a_descent_from_a_dip_beside_may_lead_on(monkeypatch):
    searched = Beside(monkeypatch, [-2.0, 1.0, 2.0, 3.0], {2.0: 100.0, 3.0: 101.0})
    assert searched.starts == [0.3, 2.0, 2.0]  # to the bottom before it is compared, and after
    assert searched.tried == [-2.0, 1.0, 2.0, *[-2.0, 1.0, 3.0]]  # 3 gains less than is worth it
    assert searched.found.values[0] == 2.0


def test_no_more_dips_beside_are_looked_at_than_are_worth_it(monkeypatch):
    searched = Beside(monkeypatch, [1.0, 2.0, 3.0, 4.0, 5.0], {5.0: 100.0})
    assert searched.starts == [0.3] and len(searched.tried) == BESIDE
    assert searched.found.values[0] == 0.3


def test_descents_from_dips_beside_end_with_the_last_round(monkeypatch):
    dips = np.arange(1.0, 30.0)

    class Ever(Beside):
        def walk(self, level, end, values, seen, *others):
            del level, end, others
            return Walked(values, seen, np.zeros((3, 0)), (np.floor(values) + 1,))

    searched = Ever(monkeypatch, [], {float(dip): 100.0 * dip for dip in dips})
    assert searched.starts == [0.3, *np.repeat(dips[:WALKS], 2)] and len(searched.tried) == WALKS
    assert searched.found.values[0] == WALKS
    assert searched.found.seen.evidence == -100 * WALKS


@pytest.mark.parametrize("others", [200.0, 0.0])
def test_where_there_are_rays_others_must_agree_that_a_dip_beside_is_better(monkeypatch, others):
    class ByRays(Beside):
        def judged(self, values, seed=None):
            chosen = super().judged(values)
            return chosen if not seed else SimpleNamespace(evidence=-others * values[0])

        def walk(self, level, *rest):
            level.by_area = False
            return super().walk(level, *rest)

    searched = ByRays(monkeypatch, [2.0], {2.0: 100.0})
    assert searched.found.values[0] == (2.0 if others else 0.3)


def test_where_a_later_descent_is_stopped_by_the_border_what_was_found_before_is_kept(monkeypatch):
    error = SceneError("the monitor is in the wall")
    searched = Searched(monkeypatch, stays, [PATCH, 0 * PATCH], {2: error})
    assert len(searched.starts) == 2
    np.testing.assert_allclose(searched.found.values, START + FOLLOWED + PATCH)
    assert searched.found.end.unphysical is None
    assert searched.found.seen == "seen by about 1"


@pytest.mark.parametrize(("noise", "place"), [(40.0, 2.0), (60.0, 0.3)])
def test_a_gain_that_errors_may_have_made_leads_nowhere(monkeypatch, noise, place):
    """It is of 100 in evidence: two standard errors of 50."""
    assert Beside(monkeypatch, [2.0], {2.0: 100.0}, noise).found.values[0] == place
