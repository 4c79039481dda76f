from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.fisher_information import (
    Curvature,
    Jacobian,
    curvature,
    differences,
)
from periscopy_sim.calibration.search.image_shift import BETWEEN_PATCHES
from periscopy_sim.calibration.search.image_warp import undone
from periscopy_sim.calibration.search.levenberg_marquardt import descend
from periscopy_sim.calibration.search.patch_walk import (
    DIPS,
    NEGLIGIBLE,
    PLACES,
    TELLING,
    Looked,
    _distinct,
    _likeliest,
    walk,
)

from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.search import patch_walk
from periscopy_sim.errors import SceneError

MOVED = np.full((1, 4, 3), 30.0)
EVERY = np.ones(3, bool)


def seen(evidence, residuals, excess):
    deviations = np.full(3, np.sqrt(excess))
    return SimpleNamespace(
        evidence=evidence,
        residuals=residuals,
        deviations=deviations,
        unabsorbed=lambda pixels: residuals[pixels] / deviations,
    )


class Comb:
    """Dips at whole numbers, each with a loss of its own; a border where nothing is physical.

    E = F log S, as of noise that is not known; of a bowl, 0 is the only dip.
    """

    freedom = 4000
    photograph_shape, used = (2, 2), np.ones((2, 2), bool)

    def __init__(self, losses, border=9.0, bowl=False, prior=None):
        self.losses, self.border, self.bowl = losses, border, bowl
        self.prior = prior or Prior.none(1)

    def explain(self, values):
        if values[0] > self.border:
            raise SceneError("the slat is in the wall")
        dip = 0 if self.bowl else int(np.rint(values[0]))
        residuals = -(values[0] - dip) * MOVED[0]
        excess = 1 + float(np.sum(residuals**2)) / self.freedom
        loss = self.losses.get(dip, 1e6) + self.prior.penalty(values)
        return seen(self.freedom * np.log(excess) + loss, residuals, excess)

    def judged(self, values):
        return self.explain(values)

    def unphysical(self, values):
        return SceneError("the slat is in the wall") if values[0] > self.border else None

    def end(self, value, known=1.0):
        """Return a descent's end there that knows so much of the information."""
        information = known * np.array([[np.sum(MOVED**2)]])
        seen = self.explain([value])
        slope = -np.array([np.sum(seen.residuals * MOVED[0])])
        pair = np.stack([MOVED, MOVED])
        about = Curvature(
            Jacobian(np.stack([slope, slope]), pair, pair), slope, information,
            np.diag(information), np.zeros(1), self.prior,
        )  # fmt: skip
        return SimpleNamespace(values=np.array([value]), explanation=seen, curvature=about)

    def walked(self, value, patch=1.1):
        """Walk from a value by patches that are told a tenth too long."""
        end = self.end(value)
        return told(walk(self, end, end.values, end.explanation, np.array([[patch, 0.0]])))


class LeaningComb(Comb):
    """Another number follows the dips, by `lean` each, and has to stay above 0."""

    moved = np.stack([MOVED[0], 30.0 * np.array([1, -1, 1, -1])[:, None] * np.ones(3)])

    def __init__(self, losses, lean):
        super().__init__(losses)
        self.lean, self.prior = lean, Prior.none(2)

    def explain(self, values):
        if self.unphysical(values):
            raise SceneError("the exponent is negative")
        dip = int(np.rint(values[0]))
        aside = np.array([values[0] - dip, values[1] - 0.1 - self.lean * dip])
        residuals = -np.tensordot(aside, self.moved, 1)
        excess = 1 + float(np.sum(residuals**2)) / self.freedom
        loss = self.losses.get(dip, 1e6)
        return seen(self.freedom * np.log(excess) + loss, residuals, excess)

    def unphysical(self, values):
        return SceneError("the exponent is negative") if values[1] < 0 else None

    def end(self, *values):
        pair = np.stack([self.moved, self.moved])
        information = np.tensordot(self.moved, self.moved, ((1, 2), (1, 2)))
        about = Curvature(
            Jacobian(np.zeros((2, 2)), pair, pair), np.zeros(2), information,
            np.diag(information), np.zeros(2), self.prior,
        )  # fmt: skip
        values = np.array(values)
        return SimpleNamespace(values=values, explanation=self.explain(values), curvature=about)


class Free(LeaningComb):
    """Dips at whole numbers of up to two parameters, each with a loss that is given."""

    def __init__(self, loss, prior=None):
        super().__init__({}, 0.0)
        self.loss, self.prior = loss, prior or Prior.none(2)

    def explain(self, values):
        dips = np.rint(values)
        residuals = -np.tensordot(np.asarray(values) - dips, self.moved, 1)
        excess = 1 + float(np.sum(residuals**2)) / self.freedom
        loss = self.loss(*dips) + self.prior.penalty(values)
        return seen(self.freedom * np.log(excess) + loss, residuals, excess)

    def unphysical(self, _):
        return None

    def walked(self, patches, **options):
        end = self.end(0.0, 0.0)
        return walk(self, end, end.values, self.explain(end.values), np.array(patches), **options)


def told(found):
    return found.values, found.seen, found.alike


def test_one_walks_to_the_deepest_dip_nearby():
    values, seen, _ = Comb({0: 50, 1: 30, 2: -20, 3: 40}).walked(0.05)
    assert values == pytest.approx([2.0], abs=0.01)
    assert seen.evidence == pytest.approx(-20, abs=0.1)


@pytest.mark.parametrize("patch", [0.6, 1.4])
def test_the_bottom_is_reached_from_its_walls(patch):
    """There the residual is larger, and so is the noise that it is taken for."""
    values, seen, _ = Comb({0: 0, 1: -30}).walked(0.0, patch)
    assert values == pytest.approx([1.0], abs=0.02)
    assert seen.evidence == pytest.approx(-30, abs=0.5)


def test_chords_that_lead_past_the_physical_are_halved():
    """They are half as long again as they should be, and a wall stands right behind the bottom."""
    comb = Comb({0: 0, 1: -30}, border=1.1)
    end = comb.end(0.0, known=2 / 3)
    values, _, _ = told(walk(comb, end, end.values, end.explanation, np.array([[0.6, 0.0]])))
    assert values == pytest.approx([1.0], abs=0.05)


def test_a_number_at_the_border_of_the_physical_does_not_hold_up_the_walk():
    """The chord would take it past 0; the other goes to the bottom all the same."""
    comb = LeaningComb({0: 0, 1: -60}, lean=-0.15)
    end = comb.end(0.0, 0.1)
    patch = np.array([[1.3, 0.0], [0.0, 0.0]])
    values, seen, _ = told(walk(comb, end, end.values, end.explanation, patch))
    assert values == pytest.approx([1.0, 0.0], abs=0.08) and values[1] >= 0
    assert seen.evidence < -20


def test_a_patch_of_which_hardly_anything_is_physical_is_not_looked_at():
    comb, looks = LeaningComb({0: 0}, lean=0.0), []
    end, explain = comb.end(0.0, 0.1), comb.explain
    comb.explain = lambda at: (looks.append(at[1]), explain(at))[1]
    walk(comb, end, end.values, end.explanation, np.array([[0.0], [-0.2]]))
    assert {round(at, 3) for at in looks} - {0.1} == {0.3, 0.5}  # on the other side


def test_a_patch_that_takes_a_number_past_the_border_is_walked_without_it():
    comb = LeaningComb({0: 0, 1: -60}, lean=0.0)
    end = comb.end(0.0, 0.1)
    patch = np.array([[1.0, 0.0], [-0.2, 0.0]])
    values, _, _ = told(walk(comb, end, end.values, end.explanation, patch))
    assert values == pytest.approx([1.0, 0.1], abs=0.02)


def test_the_best_dip_around_is_walked_to_though_no_way_there_gains_at_once():
    """Two numbers, each with dips of its own; those beside the start are worse."""
    grid = Free(lambda a, b: -200.0 if (a, b) == (1, -1) else 60.0 * (a != 0 or b != 0))
    assert grid.walked(np.eye(2)).values == pytest.approx([1.0, -1.0], abs=0.01)


@pytest.mark.parametrize("second", [0.0, 0.8])
def test_dips_beside_are_told_once_the_best_first(second):
    comb = Comb({0: 0, 1: 40, -1: 20, 2: 5000})
    end = comb.end(0.0)
    found = walk(comb, end, end.values, end.explanation, np.array([[1.1, second]]))
    assert np.concatenate(found.beside) == pytest.approx([-1.0, 1.0], abs=0.02)
    assert found.alike.shape == (1, 1)


def test_a_bowl_has_no_dip_beside():
    values, _, alike = Comb({}, bowl=True).walked(0.0)
    assert abs(values[0]) < 0.05 and not alike.any()


def test_bottoms_are_sought_of_those_places_that_explain_most():
    """Of the many that two numbers lead to some are looked at, of a few of these it goes on."""

    comb, looks = Free(lambda a, b: 30.0 * ((a - 1) ** 2 + (b - 1) ** 2)), []
    explain = comb.explain
    comb.explain = lambda at: (looks.append(np.array(at)), explain(at))[1]
    comb.judged = explain
    patches = np.array([[1.1, 0.0], [0.0, 0.9]])
    found = comb.walked(patches)
    assert found.values == pytest.approx([1.0, 1.0], abs=0.02)
    del looks[0]  # where it is
    first = looks[: 2 * PLACES]
    assert all(
        np.abs(at / np.diag(patches) - np.rint(at / np.diag(patches))).max() < 1e-6 for at in first
    )
    followed = {tuple(np.rint(at)) for at in looks[2 * PLACES :]}
    assert len(followed - {(0.0, 0.0)}) <= np.ceil(2 * PLACES / DIPS)


def test_one_stays_where_no_dip_beside_is_deeper():
    values, _, _ = Comb({0: 0, 1: 30, 3: -900}).walked(0.0)
    assert values.tolist() == [0.0]


@pytest.mark.parametrize(("gain", "dip"), [(30, 0), (-30, 0), (200, 1)])
def test_of_dips_that_the_photograph_hardly_tells_apart_the_ruler_decides(gain, dip):
    """A patch is three of its errors: 9 of a penalty, as much as 90 of a likelihood there."""
    ruled = Comb({0: gain, 1: 0}, prior=Prior(np.zeros(1), np.full(1, 1 / 3)))
    for start in (0.0, 1.0):
        values, _, _ = ruled.walked(start)
        assert values == pytest.approx([dip], abs=0.02)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("loss", [0.5, 2.0])
def test_dips_are_alike_where_one_beside_loses_less_than_is_telling(side, loss):
    _, _, alike = Comb({0: 0, side: loss * TELLING}).walked(0.0)
    # As far as the dip is, not as was guessed.
    np.testing.assert_allclose(np.abs(alike), [[1.0] if loss < 1 else []], atol=1e-6)


def test_what_two_places_lead_to_is_one_dip_and_the_next_one_is_told_all_the_same():
    """Patches are told too short: from one and two of them one comes to the same."""
    comb = Comb({0: 0, 1: -30})
    end = comb.end(0.0)
    found = walk(comb, end, end.values, end.explanation, np.array([[0.6]]))
    assert found.values == pytest.approx([1.0], abs=0.02)
    np.testing.assert_allclose(np.abs(found.alike), [[1.0]], atol=0.02)
    assert np.concatenate(found.beside) == pytest.approx([0.0], abs=0.02)


def test_a_direction_in_which_dips_look_the_same_is_told_though_others_look_more_so():
    found = Free(lambda a, b: abs(a) + 60 * abs(b)).walked(np.eye(2))
    assert np.linalg.matrix_rank(found.alike, tol=0.1) == found.alike.shape[1] == 2
    np.testing.assert_allclose(np.sort(np.abs(found.alike).max(axis=0)), [1, 1], atol=0.02)


def test_dips_in_one_plane_are_counted_twice():
    found = Free(lambda a, b: abs(a) + abs(b)).walked(np.eye(2))
    assert len(found.beside) > 2
    np.testing.assert_allclose(np.abs(found.alike[:, ::-1]), np.eye(2)[::-1], atol=0.02)


def test_no_more_places_are_looked_at_than_most_and_none_to_which_the_ruler_objects():
    for error, most in ((np.inf, 2 * PLACES), (0.3, 4)):
        comb = Free(lambda a, b: 500.0 * (a != 0 or b != 0), Prior(np.zeros(2), np.full(2, error)))
        looks, explain = [], comb.explain
        comb.explain = lambda at, looks=looks, explain=explain: (looks.append(at), explain(at))[1]
        comb.walked(1.001 * np.eye(2))
        assert 0 < len({tuple(np.rint(at)) for at in looks} - {(0.0, 0.0)}) <= most


@pytest.mark.parametrize("wider", [1, 2])
def test_a_wider_walk_looks_at_more_places(wider):
    looks = []
    comb = Free(lambda a, b: 500.0 * (a != 0 or b != 0))
    comb.walked(1.001 * np.eye(2), looked=lambda: looks.append(1), wider=wider)
    assert 2 * PLACES * wider <= len(looks) < 2 * PLACES * (wider + 1)


@pytest.mark.parametrize(("noise", "place"), [(0.0, 1.0), (500.0, 0.0)])
def test_a_gain_that_errors_may_have_made_leads_nowhere(noise, place, monkeypatch):
    monkeypatch.setattr(patch_walk, "least_gain", lambda *_: BETWEEN_PATCHES * 2 * noise)
    values, _, _ = Comb({0: 0, 1: -400}).walked(0.0)
    assert values == pytest.approx([place], abs=0.02)


def test_dips_in_one_row_are_counted_once():
    losses = {0: 0, 1: 10, -1: 20}
    comb = Comb(losses)
    end = comb.end(0.0)
    _, _, alike = told(walk(comb, end, end.values, end.explanation, np.array([[1.1, 0.8]])))
    np.testing.assert_allclose(np.abs(alike), [[1.0]], atol=1e-6)


def test_a_dip_beyond_the_border_of_the_physical_is_none():
    values, _, alike = Comb({0: 0, 1: -50}, border=0.5).walked(0.0)
    assert values.tolist() == [0.0] and not alike.any()


def test_of_dips_that_are_no_match_the_bottom_is_not_sought():
    comb, looks = Comb({0: 0, 1: 5000, -1: -50, -2: 5000}), []
    end = comb.end(0.0)
    explain = comb.explain
    comb.judged = explain
    comb.explain = lambda at: (looks.append(at[0]), explain(at))[1]
    values, _, _ = told(walk(comb, end, end.values, end.explanation, np.array([[1.0, 0.0]])))
    assert values == pytest.approx([-1.0], abs=0.01)
    assert sum(0.5 < at < 1.5 for at in looks) == sum(at < -1.5 for at in looks) == 1


@pytest.mark.parametrize(("turn", "looks"), [(0.3, 12), (1.3, 2)])
def test_a_bottom_that_is_neared_too_slowly_is_not_sought_on(turn, looks):
    """Derivatives are turned: a half chord by 74 degrees hardly gains, though it promises all."""
    comb, looked = Free(lambda a, b: -30.0 * (a == 1) + 1e4 * (b != 0 or a not in (0, 1))), []
    end = comb.end(0.0, 0.0)
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    pair = np.einsum("pq,sqmc->spmc", turned, end.curvature.jacobian.moved)
    end.curvature = replace(end.curvature, jacobian=Jacobian(np.zeros((2, 2)), pair, pair))
    patches = np.array([[1.3], [0.0]])
    found = walk(comb, end, end.values, comb.explain(end.values), patches, lambda: looked.append(1))
    assert found.values == pytest.approx([1.0, 0.0] if turn < 1 else [0.0, 0.0], abs=0.05)
    sought = 2  # besides four places that are looked at
    assert len(looked) <= 4 + sought * looks


def test_a_bowl_is_left_as_soon_as_chords_lead_back():
    comb, looks = Comb({}, bowl=True), []
    end = comb.end(0.0)
    walk(comb, end, end.values, end.explanation, np.array([[0.1, 0.0]]), lambda: looks.append(1))
    assert len(looks) <= 9


def test_without_a_shift_that_can_be_undone_nothing_is_rendered():
    comb = Comb({0: 0})
    end = comb.end(0.0)
    comb.explain = None
    values, seen, alike = told(walk(comb, end, end.values, end.explanation, np.zeros((1, 2))))
    assert (values is end.values) and (seen is end.explanation) and not alike.any()


@pytest.mark.slow
def test_a_chair_that_a_descent_left_a_patch_aside_is_walked_back(chair_before_a_small_image):
    level, _ = chair_before_a_small_image
    steps = np.array([0.004, 0.004, 1.0])
    truth = np.zeros(3)
    here = level.explain(truth)
    about = curvature(level, truth, here, differences(level, truth, np.diag(steps)))
    moves, warps = undone(here, about, level.hidden_shape, EVERY)
    start = moves @ np.linalg.pinv(warps)[:, 3]  # as the image is shifted by a patch across
    level, end = descend(level, start, steps, steps / 10, 1, lambda *_: None)
    assert abs(end.values[0]) > 0.005
    seen = level.explain(end.values)
    moves, _ = undone(end.explanation, end.curvature, level.hidden_shape, EVERY)
    values, after, alike = told(walk(level, end, end.values, seen, moves))
    assert after.evidence < level.judged(truth).evidence + NEGLIGIBLE
    metric = about.invertible() @ start  # a turn of the monitor and the chair's x go together
    assert abs(values @ metric) < 0.3 * (start @ metric)
    # Up and down this photograph does not tell it: that is counted as an error.
    assert np.abs(alike[1]).max() > 0.005, alike


def test_of_moves_along_one_row_the_shorter_is_distinct():
    moves = [np.array(move) for move in ([2.0, 0.0], [1.0, 0.0], [1.1, 0.3], [0.0, -4.0])]
    np.testing.assert_array_equal(_distinct(moves, np.eye(2)), [[1.0, 0.0], [0.0, -4.0]])


def test_the_bottom_is_sought_in_each_direction_however_little_is_explained_there():
    lattice = SimpleNamespace(values=np.zeros(2), root=np.eye(2))
    places = [*([float(k), 0.0] for k in range(1, 6)), [0.0, 1.0]]
    starts = [Looked(np.array(at), float(k), np.zeros(1)) for k, at in enumerate(places)]
    assert _likeliest(starts, lattice) == [*starts[:2], starts[-1]]
