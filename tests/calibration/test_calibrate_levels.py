"""The whole way in the world of the slat: what is told of each parameter, and by whom."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.calibrate_levels import ATTEMPTS, UNEVEN, WIDER, calibrate_levels
from periscopy_sim.calibration.explanation.discrepancy import STRUCTURED
from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel
from periscopy_sim.calibration.search.image_shift import ImageShift

from periscopy_sim.calibration import calibrate_levels as search
from periscopy_sim.errors import PhotographError, SceneError
from tests.calibration.conftest import (
    ERRING,
    NOTHING,
    TRUTH,
    Slat,
    calibrated,
)


def test_a_ruler_that_errs_is_corrected_by_the_photograph():
    # One of two errors is more than four standard errors in less than 1 of 7,000 sets of seeds.
    found = calibrated(ERRING, [0.02, 0.02])
    assert found.moved and found.trusted
    for parameter, truth in zip(found.parameters, TRUTH, strict=True):
        assert parameter.determined
        assert abs(parameter.value - truth) < 4 * parameter.standard_error


@pytest.mark.parametrize("best", [0, 1, 2])
def test_it_goes_on_from_the_best_end_at_the_fine_level(monkeypatch, best):
    ends = [TRUTH + 0.03, TRUTH - 0.02, ERRING]
    ends[best] = TRUTH
    monkeypatch.setattr(search, "ends_from_ruler", lambda *_: ends)
    _, descent = (found := calibrated(ERRING, [0.02, 0.02])).path
    np.testing.assert_array_equal(descent.values[0], TRUTH)
    assert found.trusted


def test_it_goes_on_from_the_rulers_word_where_all_ends_are_worse(monkeypatch):
    monkeypatch.setattr(search, "ends_from_ruler", lambda *_: [TRUTH + 0.06, TRUTH - 0.06])
    _, descent = calibrated(ERRING, [0.02, 0.02]).path
    np.testing.assert_array_equal(descent.values[0], ERRING)


@pytest.fixture
def ends_of(monkeypatch):
    """Have the descents of each attempt end where is said; give the attempts that were made."""
    attempts = []

    def set_ends(*ends):
        def ends_from_ruler(*given):
            attempt = given[4] if len(given) > 4 else 0
            attempts.append(attempt)
            return ends[min(attempt, len(ends) - 1)]

        monkeypatch.setattr(search, "ends_from_ruler", ends_from_ruler)
        return attempts

    return set_ends


ALL = [0, *range(2, ATTEMPTS)]
"""Attempts with places of their own, if none is believed: in the second one walks are wider."""


@pytest.mark.usefixtures("doubted")
def test_a_search_in_doubt_walks_wider_from_where_it_is(ends_of, monkeypatch):
    """The wider walk leads to the truth; no other places are drawn."""
    attempts, followed = ends_of([ERRING]), []
    found = search.search_patches

    def search_patches(level, start, *others):
        *_, wider = others
        best = found(level, start, *others)
        followed.append((start, wider))
        at = TRUTH if wider > 1 else ERRING + 0.01
        return replace(best, values=at, seen=best.level.judged(at))

    monkeypatch.setattr(search, "search_patches", search_patches)
    assert calibrated(ERRING, [0.02, 0.02]).trusted
    assert attempts == [0]
    assert [wider for _, wider in followed] == [1, WIDER]
    np.testing.assert_array_equal(followed[1][0], ERRING + 0.01)


@pytest.mark.usefixtures("doubted", "held")
def test_a_search_in_doubt_begins_anew_from_other_places(ends_of):
    attempts = ends_of([ERRING], [], [TRUTH])
    found = calibrated(ERRING, [0.02, 0.02])
    assert attempts == [0, 2] and found.trusted  # after it has walked wider
    np.testing.assert_array_equal(list(found.values.values()), TRUTH)


@pytest.mark.usefixtures("doubted", "held")
def test_an_end_that_explains_more_by_the_coarse_level_is_followed_before_others_are_looked_for(
    ends_of, monkeypatch
):
    """The fine level takes it for worse at first: there it has not come to the bottom."""
    attempts = ends_of([TRUTH + 0.06, TRUTH])
    coarse, fine = Slat(ERRING, [0.02, 0.02]), Slat(ERRING, [0.02, 0.02])
    plain = ResolutionLevel.judgement

    def judgement(level, values):
        hidden = level.marked and np.array_equal(values, TRUTH) and not followed
        return 0.0 if hidden else plain(level, values)

    followed = []
    found = search.search_patches
    monkeypatch.setattr(
        search, "search_patches", lambda level, at, *o: followed.append(at) or found(level, at, *o)
    )
    monkeypatch.setattr(Slat, "judgement", judgement)
    monkeypatch.setattr(Slat, "marked", False, raising=False)
    fine.marked = True
    assert calibrate_levels([coarse, fine], ERRING, NOTHING).trusted
    assert attempts == [0]
    np.testing.assert_array_equal(followed[1], TRUTH)


@pytest.mark.usefixtures("doubted", "held")
def test_one_that_is_believed_does_not_begin_anew(ends_of):
    attempts = ends_of([TRUTH], [ERRING])
    assert calibrated(ERRING, [0.02, 0.02]).trusted
    assert attempts == [0]


@pytest.mark.usefixtures("held")
@pytest.mark.parametrize(
    ("name", "most", "structured"),
    [
        ("discrepancy", STRUCTURED, False),
        ("discrepancy", STRUCTURED, True),
        ("overdispersion", UNEVEN, False),
        ("overdispersion", UNEVEN, True),
    ],
)
def test_one_that_leaves_more_than_noise_begins_anew_too(
    ends_of, monkeypatch, name, most, structured
):
    left = property(lambda _: most + 0.1 if structured else most, lambda *_: None)
    monkeypatch.setattr(Slat, name, left)
    attempts = ends_of([TRUTH + 0.004], [TRUTH + 0.004])
    assert calibrated(ERRING, [0.02, 0.02]).trusted
    assert attempts == (ALL if structured else [0])


@pytest.mark.usefixtures("doubted", "held")
@pytest.mark.parametrize(
    "ends", [[TRUTH + 0.06], [TRUTH + 0.012], []], ids=["worse", "hardly better", "none"]
)
def test_what_explains_hardly_more_is_not_followed_and_attempts_end(ends_of, ends, monkeypatch):
    followed = []
    found = search.search_patches
    monkeypatch.setattr(
        search, "search_patches", lambda level, at, *o: followed.append(at) or found(level, at, *o)
    )
    attempts = ends_of([TRUTH + 0.03], ends)
    assert not calibrated(TRUTH + 0.04, [0.03, 0.03]).trusted
    assert attempts == ALL
    assert len(followed) == 2  # once more, with wider walks


@pytest.mark.usefixtures("doubted", "held")
def test_of_what_was_followed_the_best_is_kept_where_a_later_one_fails(ends_of, monkeypatch):
    found = search.search_patches

    def search_patches(level, start, *others):
        if np.array_equal(start, TRUTH):
            raise SceneError("it left the physical")
        return found(level, start, *others)

    monkeypatch.setattr(search, "search_patches", search_patches)
    attempts = ends_of([TRUTH + 0.06], [], [TRUTH], [TRUTH + 0.012])
    values = list(calibrated(TRUTH + 0.07, [0.03, 0.03]).values.values())
    assert attempts == ALL
    np.testing.assert_array_equal(values, TRUTH + 0.012)


def test_where_the_best_end_leads_out_of_the_physical_the_next_one_is_followed(ends_of, failing):
    ends_of([TRUTH, TRUTH + 0.004])
    begun = failing([(TRUTH, SceneError("it left the physical"))])
    assert calibrated(ERRING, [0.02, 0.02]).trusted
    np.testing.assert_array_equal(begun, [TRUTH, TRUTH + 0.004])


def test_where_all_lead_out_of_it_the_best_ones_error_is_raised(ends_of, failing):
    ends_of([TRUTH + 0.004])
    failing([(TRUTH + 0.004, SceneError("by the end")), (ERRING, SceneError("by the ruler"))])
    with pytest.raises(SceneError, match="by the end"):
        calibrated(ERRING, [0.02, 0.02])


@pytest.mark.usefixtures("doubted", "held")
def test_a_later_search_that_sees_no_shadows_costs_nothing_of_what_was_found(ends_of, failing):
    ends_of([TRUTH + 0.012], [], [TRUTH])
    begun = failing([(TRUTH, PhotographError("it shows no shadows"))])
    values = list(calibrated(TRUTH + 0.07, [0.03, 0.03]).values.values())
    assert any(np.array_equal(at, TRUTH) for at in begun)
    np.testing.assert_array_equal(values, TRUTH + 0.012)


@pytest.mark.usefixtures("doubted")
def test_no_search_begins_twice_from_one_end(ends_of, monkeypatch):
    """All end far from it, so that the coarse level would have it again."""
    at = TRUTH + 0.015
    attempts, begun = ends_of([at, at + 1e-6], [at - 1e-6]), []
    found = search.search_patches

    def search_patches(level, start, *others):
        begun.append(start)
        best = found(level, start, *others)
        away = TRUTH + 0.06
        return replace(best, values=away, seen=best.level.judged(away))

    monkeypatch.setattr(search, "search_patches", search_patches)
    assert not calibrated(TRUTH + 0.07, [0.03, 0.03]).trusted
    np.testing.assert_array_equal(begun, [at, TRUTH + 0.06])  # once more, with wider walks
    assert attempts == ALL


@pytest.mark.usefixtures("held")
@pytest.mark.parametrize("first", ["believed", "doubted"])
def test_what_hardly_explains_more_is_not_taken_for_what_is_believed(ends_of, monkeypatch, first):
    """Both are within a told error of the truth, whichever explains more."""
    places = TRUTH + 2.5e-4, TRUTH
    believed = places[0] if first == "believed" else places[1]

    def doubts(_, values, *__):
        return () if np.array_equal(values, believed) else ("it is elsewhere",)

    monkeypatch.setattr(search, "doubts", doubts)
    monkeypatch.setattr(Slat, "discrepancy", property(lambda _: STRUCTURED + 0.1, lambda *_: None))
    monkeypatch.setattr(search, "TELLING", -1e6)
    ends_of([places[0]], [], [places[1]])
    found = calibrated(ERRING, [0.02, 0.02])
    assert found.trusted
    np.testing.assert_array_equal(list(found.values.values()), believed)


@pytest.mark.usefixtures("held")
def test_what_explains_far_more_is_taken_though_it_is_in_doubt(ends_of, monkeypatch):
    """Else a wrong place would be believed for ever."""
    wrong = TRUTH + 0.012

    def doubts(_, values, *__):
        return () if np.array_equal(values, wrong) else ("it is elsewhere",)

    monkeypatch.setattr(search, "doubts", doubts)
    monkeypatch.setattr(Slat, "discrepancy", property(lambda _: STRUCTURED + 0.1, lambda *_: None))
    ends_of([wrong], [], [TRUTH])
    found = calibrated(TRUTH + 0.07, [0.03, 0.03])
    np.testing.assert_array_equal(list(found.values.values()), TRUTH)
    assert not found.trusted


@pytest.mark.parametrize(("overdispersion", "best"), [(1.0, "truth"), (20.0, "ruler")])
def test_against_the_ruler_the_photograph_counts_as_what_is_left_varies(overdispersion, best):
    ruler = TRUTH + 0.002
    level = Slat(ruler, [4e-4, 4e-4])

    def found(values, varies):
        found_by = SimpleNamespace(level=SimpleNamespace(overdispersion=varies))
        return search._Found(values, None, found_by, gained=True, set_back=False, doubts=())

    places = {"truth": found(TRUTH, overdispersion), "ruler": found(ruler, 20 * overdispersion)}
    for one, other in (("truth", "ruler"), ("ruler", "truth")):
        assert search._Search.better(None, level, places[one], places[other]) is places[best]


def test_shadows_are_seen_however_far_from_the_rulers_word():
    """What the ruler objects is no want of shadows."""
    level = Slat(TRUTH + 0.05, [1e-4, 1e-4])
    assert level.prior.penalty(TRUTH) > 4e5
    search._require_shadows(level, TRUTH)


@pytest.fixture
def behind_a_lens():
    """A slat whose light a gain spoils that is brighter to the right and darker at the sides."""
    level = Slat(ERRING, [0.02, 0.02])
    lens = replace(level._gain, coefficients=np.array([0.1, 0.0, -0.15, 0.0, 0.0]))
    level._y = level.y + (lens.field - 1)[:, None] * level.signal
    return level, lens.field.reshape(level.photograph_shape)


def test_a_lens_is_found_beside_the_values(behind_a_lens):
    level, lens = behind_a_lens
    found = calibrate_levels([level] * 2, ERRING, NOTHING)
    assert found.trusted and found.gain.shape == level.photograph_shape
    np.testing.assert_allclose(found.gain, lens, atol=0.01)
    for parameter, value in zip(found.parameters, TRUTH, strict=True):
        assert abs(parameter.value - value) < 4 * parameter.standard_error


def test_where_no_lens_is_looked_for_it_is_a_discrepancy_that_tells_nothing(
    behind_a_lens, monkeypatch
):
    monkeypatch.setattr(Explanation, "with_gain", lambda found, *_: found)
    found = calibrate_levels([behind_a_lens[0]] * 2, ERRING, NOTHING)
    assert found.discrepancy > 10
    for parameter, truth in zip(found.parameters, TRUTH, strict=True):
        assert not parameter.determined
        assert abs(parameter.value - truth) < 1.5 * parameter.standard_error


def test_a_ruler_that_is_right_is_left_alone_and_told_as_it_is():
    found = calibrated(TRUTH, [0.02, 0.03])
    assert not found.moved and found.trusted
    assert list(found.values.values()) == TRUTH.tolist()
    for parameter, error in zip(found.parameters, [0.02, 0.03], strict=True):
        assert parameter.standard_error == parameter.statistical_error == pytest.approx(error)
        assert not parameter.determined
    np.testing.assert_allclose(found.correlation, np.eye(2), atol=1e-12)


@pytest.mark.thorough
def test_what_shifts_the_image_is_known_by_the_ruler_alone_and_others_follow_it():
    start, shift = ERRING, ImageShift(np.array([[2.0, 0.0], [0.0, 0.0]]))
    middle, distance = (found := calibrated(start, [0.02, 0.02], shift)).parameters
    alone = calibrated(start, [0.02, 0.02]).parameters[1]
    assert found.moved and not middle.determined
    assert middle.standard_error == pytest.approx(np.hypot(0.02, middle.value - middle.start))
    assert middle.statistical_error == middle.standard_error
    followed = found.correlation[0, 1] * distance.standard_error
    assert abs(followed) > 0.2 * alone.standard_error
    assert distance.standard_error < np.hypot(1.05 * alone.standard_error, followed)
