import numpy as np
from periscopy_sim.calibration.silhouette.search.binary_search import _unlike


def test_flips_are_known_by_how_much_they_lengthen_the_outline():
    mask = np.random.default_rng(2).random((5, 6)) < 0.5

    def length(m):
        return sum(np.count_nonzero(np.diff(m.astype(int), axis=axis)) for axis in (0, 1))

    for k, told in enumerate(_unlike(mask)):
        flipped = mask.copy()
        flipped.ravel()[k] ^= True
        assert length(flipped) - length(mask) == told
