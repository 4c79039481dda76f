import numpy as np
from scipy.ndimage import shift

from periscopy_sim.calibration.silhouette.search.mask_walk import walk
from periscopy_sim.calibration.silhouette.search.opacity_descent import ONWARD, descend

STEPS = np.array([[-1.5, 0.0], [0.0, 1.6]])
MASK = np.zeros((12, 12))
MASK[4:8, 5:8] = 1


class Dips:
    """An evidence with a dip wherever a mask is so many steps aside; how deep each is, is known."""

    smoothness = np.eye(2)

    def __init__(self, floors):
        self.goals = np.array([shift(MASK, np.array(at) @ STEPS, order=1) for at in floors])
        self.floors = np.array(list(floors.values()))

    def best_ratio(self, *_):
        return 1.0

    def at(self, opacities, _, __, start):
        off = opacities - self.goals.reshape(len(self.goals), -1)
        values = self.floors + 2000 * np.sum(off**2, axis=1)
        nearest = int(np.argmin(values))
        return values[nearest], 4000 * off[nearest], start

    def descended(self, at):
        return descend(self, shift(MASK, np.array(at) @ STEPS, order=1), ONWARD)


def test_a_walk_goes_from_dip_to_dip_to_the_deepest():
    dips = Dips({(0, 0): -900.0, (0, 1): -600.0, (1, 2): -300.0, (-1, 0): -700.0})
    found = dips.descended((1, 2))
    assert np.abs(found.opacities - dips.goals[2]).max() < 0.3  # a descent stays where it is
    end = walk(dips, found, STEPS)
    assert end.objective < found.objective - 250
    np.testing.assert_allclose(end.opacities, MASK, atol=0.02)


def test_a_walk_stays_where_no_step_gains():
    dips = Dips({(0, 0): -900.0, (0, 1): -600.0, (-1, -1): -700.0})
    found = dips.descended((0, 0))
    assert walk(dips, found, STEPS) is found
