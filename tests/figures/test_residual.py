"""The map of what is left of a photograph."""

import numpy as np
import pytest
from PIL import Image

from periscopy_sim.figures.residual import draw_residual, residual_figure
from periscopy_sim.model.noise import CameraNoise
from periscopy_sim.model.residual import Residual

RNG = np.random.default_rng(0)
PHOTOGRAPH = RNG.uniform(1, 2, (20, 30, 3))
NOISE = CameraNoise(np.array([0.1, 0.2, 0.2]), np.full(3, 0.01))


def residual(noise=NOISE):
    light = NOISE.σ * RNG.standard_normal((20, 30, 3))
    light[5:8, 10:20] = np.nan
    light[12, 3] = 2.0
    alone = None if noise is None else 0.1
    return Residual(light, 0.12, alone, noise, None, ())


def test_map_is_signed_over_noise_and_what_is_left_out_is_no_number():
    given = residual()
    figure = residual_figure(PHOTOGRAPH, given)
    picture = figure.axes[1].images[0]
    shown = np.ma.filled(picture.get_array(), np.nan)
    np.testing.assert_allclose(shown, given.light.mean(axis=2) / 0.1, rtol=1e-12)
    low, high = picture.get_clim()
    assert low == -high and 4 <= high < 20
    assert figure.axes[-1].get_ylabel() == "standard deviations of noise"
    assert figure._supxlabel.get_text() == given.remark


def test_map_without_known_noise_is_in_percent_of_the_photograph():
    figure = residual_figure(PHOTOGRAPH, residual(None))
    assert "%" in figure.axes[-1].get_ylabel()


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_map_of_nothing_is_drawn(tmp_path, value):
    noise = CameraNoise(np.zeros(3), np.zeros(3))
    light = np.zeros((20, 30, 3))
    light[0, 0] = value
    draw_residual(
        tmp_path / "r.png", PHOTOGRAPH, Residual(light, 0.0, 0.0, noise, None, ()), {"a": "b"}
    )
    with Image.open(tmp_path / "r.png") as picture:
        assert picture.text["a"] == "b" and picture.width > picture.height
