import numpy as np
import pytest

from periscopy_sim.calibration.search import Log, descend, places
from periscopy_sim.errors import SceneError
from tests.calibration.conftest import NEAREST, TRUTH, slat_level

STEPS = np.array([0.02, 0.015])


def ignore(point, evidence):
    pass


def test_a_descent_ends_at_the_truth():
    level = slat_level(errors=(0.1, 0.1))
    seen = []
    end = descend(
        level, level.start(np.add(TRUTH, [0.02, -0.015])), STEPS, 10, lambda *v: seen.append(v)
    )
    np.testing.assert_allclose(level.values(end.point), TRUTH, atol=2e-3)
    assert end.unphysical is None
    assert len(seen) > 2


def test_a_descent_into_the_wall_stops_at_its_border_and_says_so():
    level = slat_level(start=np.array([0.05, NEAREST + 0.001]), errors=(0.1, np.inf))
    light = slat_level(start=TRUTH).averaged
    del light
    end = descend(level, level.start(np.array([0.05, NEAREST + 1e-4])), STEPS, 1, ignore)
    assert level.is_physical(end.point)
    with pytest.raises(SceneError):
        descend(level, level.start(np.array([0.05, NEAREST - 0.01])), STEPS, 1, ignore)


def test_places_are_drawn_from_the_ruler_and_the_best_comes_first():
    level = slat_level(start=np.add(TRUTH, [0.03, 0.02]), errors=(0.03, 0.02))
    level = level.comparing(level.start(TRUTH))
    found = places(level, level.start(level.prior.centers), level.prior.errors, 16, 0)
    assert len(found) == 16
    evidence = [level.judgement(point) for point in found]
    assert evidence == sorted(evidence)
    distances = level.prior.distance(np.array([level.values(point) for point in found]))
    assert np.abs(distances).max() <= 3 and np.std(distances) > 0.5
    again = places(level, level.start(level.prior.centers), level.prior.errors, 16, 1)
    assert not np.allclose(found[0], again[0])


def test_progress_never_goes_back_and_ends_at_one():
    told = []
    log = Log(told.append)
    for until in (0.3, 0.5):
        log.expect(4, until)
        for level in (0, 1):
            visit = log.at(level)
            for _ in range(5):
                visit(np.zeros(2), 1.0)
        assert told[-1] <= until
    log.finish()
    assert told == sorted(told) and told[-1] == 1
    assert [len(log.visited[k]) for k in (0, 1)] == [10, 10]
