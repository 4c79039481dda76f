"""The noise-aware method by its strongest patterns against the method by all of them."""

import numpy as np
import pytest

from periscopy_sim.model import fit
from periscopy_sim.reconstruction.noise_aware import NoiseAware

HIDDEN, WALL = (12, 14), (24, 28)
MOST = 100


def penumbrae():
    """Return shadows' edges over the wall, and a light that no occluder keeps off it, as B."""
    down, across = (np.linspace(0, 1, n) for n in HIDDEN)
    y, x = (np.linspace(0, 1, n) for n in WALL)
    rows, columns = (
        0.5 + np.arctan(12 * (wall[:, None] - hidden)) / np.pi
        for wall, hidden in ((y, down), (x, across))
    )
    smooth = np.stack([np.ones(y.size * x.size), np.repeat(y, x.size), np.tile(x, y.size)], axis=1)
    return np.kron(rows, columns) + 0.1, smooth


@pytest.mark.parametrize("channels", [1, 3])
def test_image_and_standard_errors_are_those_of_all_patterns(channels, monkeypatch):
    A, B = penumbrae()
    rng = np.random.default_rng(0)
    truth = np.zeros((*HIDDEN, channels))
    truth[3:9, 2:7], truth[5:11, 8:12] = 0.8, 0.4
    light = A @ truth.reshape(-1, channels) + B @ rng.random((3, channels))
    photograph = light + 1e-2 * light.mean() * rng.standard_normal(light.shape)
    photograph = photograph.reshape(*WALL, channels)

    def solved():
        given = {"hidden": HIDDEN, "photograph_shape": WALL, "profiles": False}
        method = NoiseAware(A, B, tolerance=1e-5, max_iterations=5000, **given)
        return method, method.solve(photograph)

    whole, image = solved()
    errors = whole.report(photograph, image).standard_errors
    monkeypatch.setattr(fit, "MOST_PATTERNS", MOST)
    few, near = solved()
    assert len(few.fit.patterns.rows) == MOST < len(whole.fit.patterns.rows) == 12 * 14
    assert np.abs(near.image - image.image).max() > 0
    assert (np.abs(near.image - image.image) < 0.1 * errors).all()
    np.testing.assert_allclose(near.noise, image.noise, rtol=0.05)
    # Both standard errors differ by their contrast τ, which each estimates from its own patterns.
    ratio = few.report(photograph, near).standard_errors / errors
    assert ratio.max() < 1.1 * ratio.min()
    assert 0.3 < ratio.mean() < 1.5
