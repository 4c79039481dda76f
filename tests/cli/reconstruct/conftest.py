import numpy as np
import pytest


@pytest.fixture(scope="session")
def hidden():
    return np.random.default_rng(21).uniform(0.1, 1, (4, 5, 3))


@pytest.fixture(scope="session")
def light(hidden, scenario, transport):
    """A photograph as the scene's own matrix has it, without noise, and ambient light."""
    signal = transport.astype(np.float64) @ hidden.reshape(20, 3)
    # A lamp 1 m to the left, 3 m before the wall and 1 m above the centre: one of the modelled.
    lamp = np.array([0.7435 - 1, 1.03 - 3, 0.2645 + 1])
    away = lamp - scenario.view.centers
    ambient = -away[:, 1] / np.linalg.norm(away, axis=1) ** 3
    ambient *= 5 * signal.mean() / ambient.mean()
    colour = [1.2, 1, 0.8]
    return signal.reshape(24, 24, 3), (ambient[:, None] * colour).reshape(24, 24, 3)
