"""What is told of how far a calibration has come."""

from types import SimpleNamespace

import numpy as np

from periscopy_sim.calibration.progress import Progress


def test_a_descent_that_takes_long_does_not_eat_the_next_ones_share():
    told = []
    log = Progress(2, True, (6, 3), told.append)
    for _ in range(3):
        visit = log.at(SimpleNamespace())
        for _ in range(40):
            visit(np.zeros(2), 0.0)
    assert told == sorted(told)
    assert told[39] < told[40] < told[79] < told[80] and told[79] < 0.7 and 0.8 < told[-1] < 1


def test_progress_leaps_over_what_ended_early_and_never_goes_back():
    told = []
    log = Progress(2, False, (6, 3), told.append)
    for visits in (3, 2, 2):
        visit = log.at(None)
        for _ in range(visits):
            visit(np.zeros(2), 0.0)
    assert told == sorted(told) and 0 < told[0] < told[-1] < 1
    # A visit of a later level costs more; the levels before count as done.
    assert told[3] - told[2] > 2 * (told[2] - told[1]) and told[5] - told[4] > told[4] - told[3]


def test_a_walk_moves_on_from_the_descents_and_waits_at_the_end():
    told = []
    log = Progress(2, True, (6, 3), told.append)
    log.at(None)(np.zeros(2), 0.0)
    for _ in range(40):
        log.looked()
    assert told == sorted(told) and told[0] < 0.1 and 0.6 < told[1] < told[2] < told[-1] == 1
