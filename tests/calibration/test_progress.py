"""What is told of how far a calibration has come."""

import itertools
from types import SimpleNamespace

import numpy as np
from periscopy_sim.calibration.progress import Progress


def test_a_search_that_takes_long_does_not_eat_the_descents_share():
    told = []
    log = Progress(2, False, 10, told.append)
    for _ in range(2):
        visit = log.at(SimpleNamespace())
        for _ in range(600):
            visit(np.zeros(2), 0.0)
    assert told == sorted(told)
    assert told[0] < told[599] < told[600] and told[599] < 0.5 and 0.6 < told[-1] < 1


def test_progress_leaps_over_what_ended_early_and_never_goes_back():
    told = []
    log = Progress(2, False, 10, told.append)
    for visits in (3, 4):
        visit = log.at(None)
        for _ in range(visits):
            visit(np.zeros(2), 0.0)
    assert told == sorted(told) and 0 < told[0] < told[-1] < 1
    # A visit of the later level costs more; the one before counts as done.
    assert told[3] - told[2] > 2 * (told[2] - told[1]) and told[5] - told[4] > told[2] - told[1]


def test_a_walk_moves_on_from_the_descents_and_says_never_that_it_is_done():
    told = []
    log = Progress(2, True, 10, told.append)
    log.at(None)
    log.at(None)(np.zeros(2), 0.0)
    for _ in range(100):
        log.looked()
    assert all(before < after < 0.995 for before, after in itertools.pairwise(told))
    assert told[0] < 0.3 and told[1] > 0.6 and told[-1] > 0.97


def test_a_descent_after_a_walk_does_not_go_back():
    told = []
    log = Progress(2, True, 10, told.append)
    log.at(None)
    visit = log.at(None)
    for each in (visit, lambda *_: log.looked(), visit, lambda *_: log.looked()):
        for _ in range(5):
            each(np.zeros(2), 0.0)
    assert told == sorted(told)


def test_a_search_that_begins_anew_moves_on_and_keeps_what_it_visits():
    told = []
    log = Progress(2, True, 10, told.append)
    levels = [SimpleNamespace(photograph_shape=(k, k), hidden_shape=(k, k)) for k in (1, 2)]
    for level in levels:
        log.at(level)(np.zeros(2), 0.0)
    again = log.again()
    for k in range(30):
        again(np.full(2, k), 1.0)
    assert all(before < after < 1 for before, after in itertools.pairwise(told))
    assert [len(visited.values) for visited in log.path()] == [31, 1]


def test_of_another_box_many_points_count_as_one_look():
    told = []
    log = Progress(3, False, 10, told.append)
    levels = [SimpleNamespace(photograph_shape=(k, k), hidden_shape=(k, k)) for k in (1, 2)]
    for level in levels:
        log.at(level)(np.zeros(3), 0.0)
    again, before = log.again(per_look=64), len(told)
    for k in range(383):  # with the first stage's one, 384
        again(np.full(3, k), 1.0)
    assert len(told) - before == 6
    assert told[-1] < 0.95
    assert len(log.path()[0].values) == 384
