"""Whether a photograph shows anything of a scene."""

import numpy as np
import pytest
from periscopy_sim.reconstruction.explained import Explained

from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
from periscopy_sim.reconstruction.preconditioned.still import Periscope

RNG = np.random.default_rng(5)
M, N = 300, 12
SMOOTH = np.exp(-(((np.linspace(-1, 1, M)[:, None] - np.linspace(-1, 1, N)) / 0.3) ** 2))
A = SMOOTH * RNG.uniform(0.5, 1, (M, N))
B = np.polynomial.legendre.legvander(np.linspace(-1, 1, M), 2) + 1.5
TRUTH = RNG.uniform(0.2, 1, (N, 3))
GAIN = np.array([1.2, 1.0, 0.8])
METHODS = {"noise-aware": NoiseAware, "preconditioned": Periscope}


def photograph(noise=1e-3, scene=A):
    return (scene @ TRUTH + B @ RNG.uniform(1, 2, (3, 3)) + noise * RNG.normal(size=(M, 3))) * GAIN


@pytest.mark.parametrize(
    ("share", "whole", "left", "doubt"),
    [
        (1.0, 1000.0, 100.0, ""),
        (2e-6, 1000.0, 100.0, ""),
        (5e-7, 1000.0, 100.0, "ambient light alone"),
        (0.0, 0.0, 0.0, "ambient light alone"),
        # 50 patterns in 3 channels: noise explains 150 ± 17.3.
        (1.0, 205.0, 10.0, ""),
        (1.0, 199.0, 10.0, "no more than noise"),
        (1.0, 1000.0, 790.0, ""),
        (1.0, 1000.0, 810.0, "no more than noise"),
    ],
)
def test_doubt_is_of_what_noise_or_ambient_light_explains(share, whole, left, doubt):
    channels = np.array([0.5, 0.3, 0.2])
    found = Explained(share, whole * channels, left * channels, 50).doubt
    assert doubt in found and bool(doubt) == bool(found)


@pytest.mark.filterwarnings("ignore:noise-aware recovery stopped")
@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize(
    ("y", "doubt"),
    [
        (np.zeros((M, 3)), "ambient light alone"),
        (np.ones((M, 3)), "ambient light alone"),
        (np.linspace(1, 2, M)[:, None] * np.ones(3), "ambient light alone"),
        (np.eye(M)[:, [150] * 3], "no more than noise"),
        (photograph(), ""),
    ],
)
def test_photograph_that_shows_nothing_is_doubted(name, y, doubt):
    method = METHODS[name](A, B, hidden_shape=(3, 4))
    found = method.solve(y)
    assert doubt in method.doubt(found) and bool(doubt) == bool(method.doubt(found))
