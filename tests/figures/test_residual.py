"""The map of what is left of a photograph."""

import numpy as np
import pytest
from PIL import Image

from periscopy_sim.figures.residual import draw_residual, residual_figure
from periscopy_sim.model.residual import Residual

RNG = np.random.default_rng(0)
PHOTOGRAPH = RNG.uniform(1, 2, (20, 30, 3))


def residual(noise_alone=0.1):
    light = np.array([0.1, 0.2, 0.2]) * RNG.standard_normal((20, 30, 3))
    light[5:8, 10:20] = np.nan
    light[12, 3] = 2.0
    return Residual(light, 0.12, None, noise_alone, None, "unknown")


def test_map_is_signed_over_noise_and_what_is_left_out_is_no_number():
    given = residual()
    figure = residual_figure(PHOTOGRAPH, given, "a caption")
    picture = figure.axes[1].images[0]
    shown = np.ma.filled(picture.get_array(), np.nan)
    # Noise of a tenth where the unexplained light is 0.12 of the photograph.
    noise = 0.1 * np.sqrt(np.nanmean(given.light**2)) / 0.12 / np.sqrt(3)
    np.testing.assert_allclose(shown, given.light.mean(axis=2) / noise, rtol=1e-12)
    low, high = picture.get_clim()
    assert low == -high and 4 <= high < 20
    assert figure.axes[-1].get_ylabel() == "standard deviations of noise"
    assert figure._supxlabel.get_text() == "a caption"


def test_map_without_known_noise_is_in_percent_of_the_photograph():
    figure = residual_figure(PHOTOGRAPH, residual(None))
    assert "%" in figure.axes[-1].get_ylabel()


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_map_of_nothing_is_drawn(tmp_path, value):
    light = np.zeros((20, 30, 3))
    light[0, 0] = value
    given = Residual(light, 0.0, None, 0.0, None, "unknown")
    draw_residual(tmp_path / "r.png", PHOTOGRAPH, given, metadata={"a": "b"})
    with Image.open(tmp_path / "r.png") as picture:
        assert picture.text["a"] == "b" and picture.width > picture.height
