"""The map of the residual of a photograph."""

import numpy as np
import pytest

from periscopy_sim.figures.panels import draw_residual
from periscopy_sim.model.residual import Residual
from tests.figures.conftest import read

RNG = np.random.default_rng(0)
PHOTOGRAPH = RNG.uniform(1, 2, (20, 30, 3))


def residual(noise_alone=0.1):
    light = np.array([0.1, 0.2, 0.2]) * RNG.standard_normal((20, 30, 3))
    light[5:8, 10:20] = np.nan
    light[12, 3] = 2.0
    return Residual(light, 0.12, None, noise_alone, None, "unknown")


@pytest.mark.parametrize("noise_alone", [0.1, None])
def test_map_is_signed_over_noise_or_in_percent(noise_alone, tmp_path, saved):
    given = residual(noise_alone)
    draw_residual(tmp_path / "r.png", PHOTOGRAPH, given, "a caption")
    (figure,) = saved
    picture = figure.axes[1].images[0]
    shown = np.ma.filled(picture.get_array(), np.nan)
    # The unexplained light is 0.12 of the photograph.
    level = np.sqrt(np.nanmean(given.light**2)) / 0.12
    unit = level / 100 if noise_alone is None else 0.1 * level / np.sqrt(3)
    np.testing.assert_allclose(shown, given.light.mean(axis=2) / unit, rtol=1e-12)
    low, high = picture.get_clim()
    assert low == -high and high >= (0 if noise_alone is None else 4)
    assert ("%" in figure.axes[-1].get_ylabel()) is (noise_alone is None)
    assert figure.get_supxlabel() == "a caption"


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_map_of_nothing_is_drawn(tmp_path, value):
    light = np.zeros((20, 30, 3))
    light[0, 0] = value
    given = Residual(light, 0.0, None, 0.0, None, "unknown")
    draw_residual(tmp_path / "r.png", PHOTOGRAPH, given, metadata={"a": "b"})
    assert read(tmp_path / "r.png")[0]["a"] == "b"
