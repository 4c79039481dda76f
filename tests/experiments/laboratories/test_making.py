from pathlib import Path

import numpy as np
import pytest

from experiments.laboratories.making import ruler
from experiments.laboratories.making.camera import Camera
from experiments.laboratories.making.paint import Paint

LABORATORY = Path(ruler.__file__).parents[1] / "scenes" / "scene.xml"


def test_a_ruler_reads_within_two_errors_as_often_as_a_normal_law_says():
    """Of 400 readings of each number: the cut normal law's spread within four of its errors."""
    text = LABORATORY.read_text("utf-8")
    true = ruler.declared(text)
    read = [ruler.read_by_ruler(text, seed) for seed in range(400)]
    assert len(read[0]) >= 7
    strays = np.array(
        [[(one[n] - true[n]) / true[n + ruler.ERROR] for n in sorted(one)] for one in read]
    )
    assert abs(strays).max() < 2.4  # half a degree's rounding
    cut = 1 - 2 * 2 * np.exp(-2) / np.sqrt(2 * np.pi) / 0.9545  # variance of the law cut at 2
    spread = (strays**2).mean()
    assert spread == pytest.approx(cut, abs=4 * np.sqrt(1.2 / strays.size) + 0.01)


def test_paint_correlates_as_far_as_its_grain():
    """A Gaussian of deviation s makes a field whose correlation falls to exp(-1/4) within s."""
    paint = Paint(grain=(0.012, 0.005), passes=(0.2, 0), seam=(0, 1, 0), seed=3)
    across = np.arange(0, 0.6, 0.001)
    places = np.stack(np.meshgrid(across, across), -1).reshape(-1, 2)
    field = paint.at(places).reshape(600, 600)
    field = (field - field.mean()) / field.std()
    assert (field[:, 5:] * field[:, :-5]).mean() == pytest.approx(np.exp(-0.25), abs=0.03)
    assert (field[12:] * field[:-12]).mean() == pytest.approx(np.exp(-0.25), abs=0.03)


def test_exposing_keeps_the_light_and_the_noise_that_is_asked():
    """Mean and variance of 600 x 400 pixels, both within five of their own standard errors."""
    camera = Camera(sensitivity=(0.5, 1.0, 0.7))
    radiance = np.full((400, 600, 3), 0.3)
    gain = camera.counts_per_radiance(radiance)
    counts = camera.expose(radiance, gain, noise=0.4, seed=1).astype(float) - camera.black
    assert gain * 0.3 == pytest.approx(0.8 * (camera.white - camera.black))
    for channel, sensitivity in enumerate(camera.sensitivity):
        signal = gain * 0.3 * sensitivity
        variance = 0.4 * signal + camera.read_noise**2 + 1 / 12
        n = radiance[..., 0].size
        found = counts[..., channel]
        assert found.mean() == pytest.approx(signal, abs=5 * np.sqrt(variance / n))
        assert found.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / n))
