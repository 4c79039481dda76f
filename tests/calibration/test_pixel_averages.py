import numpy as np
import pytest

from periscopy_sim.calibration.pixel_averages import averages, footprints
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import Photograph
from periscopy_sim.storage.pictures import averaged_photograph


def light(across: int) -> Array:
    """Return a cubic and a wave in the middles of (20 x across) squared pixels."""
    points = (np.arange(20 * across) + 0.5) / across
    x, y = np.meshgrid(points, points)
    return np.asarray(x**3 + 2 * x * y**2 - 30 * y**2 + 900 * np.sin(x / 3) * np.cos(y / 4))


MEANS = light(32).reshape(20, 32, 20, 32).mean(axis=(1, 3))
PIXELS = np.ones((20, 20), bool)
PIXELS[:4, :3] = False


@pytest.mark.parametrize("across", [1, 3])
def test_pixels_are_means_of_light_that_is_known_at_points(across: int) -> None:
    """But in the outermost row, beside which no neighbour shows how the light bends."""
    known = light(across).reshape(20, across, 20, across).mean(axis=(1, 3))
    averaged = np.zeros(PIXELS.shape)
    averaged[PIXELS] = footprints(PIXELS, across) @ known[PIXELS]
    before, after = (np.max(np.abs(each - MEANS)[5:-1, 4:-1]) for each in (known, averaged))
    assert before == pytest.approx(6.0 / across**2, rel=0.1)
    assert after < 0.05


@pytest.mark.parametrize("shape", [(20, 20), (10, 10), (7, 9)])
def test_a_photograph_and_a_are_averaged_alike(shape: tuple[int, int]) -> None:
    """Also where large pixels part small ones, and the mask large ones."""
    photograph = Photograph(np.repeat(MEANS[..., None], 3, axis=2), mask=PIXELS)
    means = averaged_photograph(photograph, shape)
    exact = means.values[means.pixels][:, 0]
    S = averages(PIXELS, shape)
    assert S.shape == (len(exact), np.count_nonzero(PIXELS))
    off = np.abs(S @ light(1)[PIXELS] - exact)
    assert np.median(off) < 0.1
    if shape == (10, 10):  # else the outermost row has its part in all large pixels beside it
        inner = np.zeros(shape, bool)
        inner[3:-1, 2:-1] = True
        assert off[inner[means.pixels]].max() < 0.05
