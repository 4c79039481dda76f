"""Images that the tests of total variation denoise."""

import numpy as np
import pytest


@pytest.fixture(scope="session")
def random_image():
    """White noise of any shape."""

    def draw(*shape, seed=0):
        return np.random.default_rng(seed).normal(size=shape)

    return draw


@pytest.fixture(scope="session")
def blocks(random_image):
    """Two overlapping blocks in noise, (12, 15)."""

    def draw(seed=0):
        image = np.zeros((12, 15))
        image[2:7, 3:11] = 1.0
        image[6:11, 8:] += 0.5
        return image + 0.2 * random_image(12, 15, seed=seed)

    return draw
