"""What is left unexplained of a photograph, and whether it shows anything."""

import numpy as np
import pytest

from periscopy_sim.reconstruction.explained import Explained
from periscopy_sim.reconstruction.noise_aware.still import NoiseAware
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
    found = Explained(share, np.ones(3), whole * channels, left * channels, 50, 100).doubt
    assert doubt in found and bool(doubt) == bool(found)


@pytest.mark.parametrize("noise", [1e-3, 0.1])
@pytest.mark.parametrize("name", METHODS)
def test_unexplained_is_what_the_image_leaves_over_the_photograph(name, noise):
    method = METHODS[name](A, B, hidden_shape=(3, 4), channel_gain=GAIN)
    y = photograph(noise)
    found = method.solve(y)
    Q = np.linalg.qr(B)[0]
    left = y / GAIN - A @ found.image.reshape(N, 3)
    left -= Q @ (Q.T @ left)
    expected = np.sqrt(np.sum(left**2) / 3 / (M - 3) / np.mean((y / GAIN) ** 2))
    unexplained = method.told(found)["unexplained"]
    assert unexplained == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("name", METHODS)
def test_unexplained_is_noise_where_the_scene_is_right_and_more_where_it_is_not(name):
    # Of so few patches, repair takes details for outliers.
    settings = {"repair_threshold": np.inf} if name == "preconditioned" else {}
    method = METHODS[name](A, B, hidden_shape=(3, 4), **settings)
    right, wrong = (
        method.told(method.solve(photograph(1e-3, scene) / GAIN))["unexplained"]
        for scene in (A, np.roll(A, 9, axis=0))
    )
    assert right < 1.5e-3 and wrong > 5 * right


@pytest.mark.parametrize("name", METHODS)
def test_unit_of_the_photograph_does_not_matter(name):
    method, y = METHODS[name](A, B, hidden_shape=(3, 4)), photograph()
    one, other = (method.told(method.solve(unit * y))["unexplained"] for unit in (1, 1e9))
    assert other == pytest.approx(one, rel=1e-3)


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
    assert np.isfinite(method.told(found)["unexplained"])
