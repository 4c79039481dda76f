from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.patch_lattice import REACH, TOGETHER, PatchLattice
from scipy.optimize import minimize

from periscopy_sim.calibration.prior import Prior

INFORMATION = np.array([[90.0, 60.0, 5.0], [60.0, 50.0, 0.0], [5.0, 0.0, 2.0]])
RULER = Prior(np.array([0.2, -0.4, 1.0]), np.array([0.5, 0.3, 1.0]))
MOVES = np.array([[1.0, 0.3], [-0.9, 0.4], [0.2, -0.5]])
ALONE = np.array([0.6, 0.1, 0.3])
"""Where the photograph alone has the parameters."""


def lattice(ruler=RULER, moves=MOVES):
    total = INFORMATION + np.diag(ruler.precision)
    best = np.linalg.solve(total, INFORMATION @ ALONE + ruler.precision * ruler.centers)
    about = SimpleNamespace(prior=ruler, invertible=lambda: total)
    return PatchLattice(about, best, moves)


def least(k):
    """Return the least of F at a place, and where, by brute force."""

    def objective(values):
        aside = values - ALONE - MOVES @ k
        return aside @ INFORMATION @ aside + RULER.penalty(values)

    found = minimize(objective, ALONE, tol=1e-12)
    return found.fun, found.x


def test_objection_and_move_are_those_of_the_least_of_evidence_and_penalty():
    places = np.array(list(product(range(-2, 3), repeat=2)))
    here, values = least(np.zeros(2))
    found = lattice()
    np.testing.assert_allclose(found.values, values, atol=1e-5)
    for k, objection, move in zip(places, found.objection(places), found.move(places), strict=True):
        there, at = least(k)
        assert objection == pytest.approx(there - here, abs=1e-5)
        np.testing.assert_allclose(move, at - values, atol=1e-5)
        np.testing.assert_allclose(found.move(k), move)


def free(ruler, moves, values=(0.0, 0.0), known=1e3):
    """Return a lattice in the plane where the photograph tells so much of either parameter."""
    about = SimpleNamespace(
        prior=ruler, invertible=lambda: known * np.eye(2) + np.diag(ruler.precision)
    )
    return PatchLattice(about, np.array(values), np.array(moves))


def test_the_rulers_favourites_come_first_though_no_step_alone_leads_there():
    """Two oblique moves: each alone is far from the ruler, their difference is near."""
    oblique = free(Prior(np.zeros(2), np.ones(2)), [[5.0, 5.5], [1.0, 5.0]], (-0.5, 4.0))
    places = [np.array(k) for k in ((1, -1), (1, 0), (-1, 0), (0, 1), (0, -1))]
    objections = [oblique.objection(k) for k in places]
    assert objections[0] < 0 and min(objections[1:]) > 10
    found = oblique.favourites(99, most=1e9)
    np.testing.assert_allclose(found[0], oblique.values + oblique.move(places[0]))
    wholes = np.rint(np.linalg.solve(oblique.moves, (found - oblique.values).T).T).astype(int)
    cost = oblique.objection(wholes) + np.sum(wholes**2, axis=1)
    assert len(cost) > 20 and (np.diff(cost) > -1e-9).all()


def test_where_no_ruler_tells_the_nearest_come_first():
    found = free(Prior.none(2), 3 * np.eye(2), (1.0, 2.0))
    places = (found.favourites(99, most=1.0) - found.values) / 3
    assert {tuple(k) for k in places[:4]} == {(1, 0), (-1, 0), (0, 1), (0, -1)}
    assert len({tuple(k) for k in places}) == len(places) == (2 * REACH + 1) ** 2 - 1
    np.testing.assert_array_equal(found.favourites(7, most=1.0), found.favourites(99, most=1.0)[:7])


def test_what_the_ruler_objects_to_is_left_out():
    found = lattice()
    places = np.array(list(product(range(-REACH, REACH + 1), repeat=2)))
    likely = found.values + found.move(places[found.objection(places) < 3])
    asked = found.favourites(99, most=3.0)
    assert 0 < len(asked) < len(found.favourites(99, most=1e9))
    assert all(np.abs(likely - each).max(axis=1).min() < 1e-9 for each in asked)


def test_places_that_two_moves_lead_to_are_asked_for_once():
    """Either moves the same by a patch; how they share it, the ruler says."""
    ruler = Prior(np.zeros(2), np.ones(2))
    total = np.array([[1e3, 1e3], [1e3, 1e3]]) + np.eye(2)
    about = SimpleNamespace(prior=ruler, invertible=lambda: total)
    twice = PatchLattice(about, np.zeros(2), np.eye(2))
    places = twice.favourites(99, most=1e9)
    np.testing.assert_allclose(places, places.mean(axis=1, keepdims=True) * [1, 1], atol=1e-2)
    assert sorted(np.rint(places.sum(axis=1))) == [-4, -3, -2, -1, 1, 2, 3, 4]


def test_half_of_the_shortest_move_away_is_another_dip():
    found = free(Prior.none(2), np.diag([3.0, 5.0]), (1.0, 2.0))
    for side in np.array([[1, 0], [0, -1], [0.6, 0.8]]):
        assert not found.are_apart(found.values + 1.49 * side, found.values)
        assert found.are_apart(found.values + 1.51 * side, found.values)
    short = free(Prior.none(2), np.diag([0.01, 5.0]))  # as short as a bottom is found
    assert not short.are_apart(np.array([[0.05, 0.0], [0.0, 0.05]]), np.zeros(2)).any()


def test_without_moves_there_is_no_place_beside():
    found = lattice(moves=np.zeros((3, 0)))
    assert found.favourites(9, most=1e9).shape == (0, 3)


def test_many_moves_are_no_more_than_a_few_together():
    """Twelve: 5^12 places would be 244 million."""
    about = SimpleNamespace(prior=Prior.none(12), invertible=lambda: 1e3 * np.eye(12))
    found = PatchLattice(about, np.zeros(12), np.eye(12)).favourites(60, most=1.0)
    assert len(found) == 60 and (np.count_nonzero(found, axis=1) <= TOGETHER).all()


def test_what_a_number_that_no_ruler_knows_does_is_as_its_error_grows():
    known, unknown = (
        lattice(Prior(RULER.centers, np.array([0.5, 0.3, error]))) for error in (1e6, np.inf)
    )
    places = np.array(list(product(range(-2, 3), repeat=2)))
    np.testing.assert_allclose(unknown.objection(places), known.objection(places), rtol=1e-6)
    np.testing.assert_allclose(unknown.move(places), known.move(places), rtol=1e-6)
