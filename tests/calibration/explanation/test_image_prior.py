"""What is said of hidden images beforehand."""

import numpy as np
import pytest
from periscopy_sim.calibration.explanation.evidence import explain
from periscopy_sim.calibration.explanation.image_prior import BRIGHTNESS, image_precision


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 1), (3, 4)])
def test_an_image_is_as_rough_as_its_differences_in_the_dark(shape):
    image = np.random.default_rng(0).random(shape)
    dark = np.pad(image, 1)
    differences = sum(np.sum(np.diff(dark, axis=axis) ** 2) for axis in (0, 1))
    roughness = image.ravel() @ image_precision(shape) @ image.ravel()
    assert roughness == pytest.approx(differences + BRIGHTNESS * np.sum(image**2))


def test_no_place_of_a_thing_in_the_dark_is_smoother_than_another():
    K = image_precision((6, 9))
    thing = np.random.default_rng(1).random((2, 3))
    found = set()
    for row in range(5):
        for column in range(7):
            image = np.zeros((6, 9))
            image[row : row + 2, column : column + 3] = thing
            found.add(round(image.ravel() @ K @ image.ravel(), 9))
    assert len(found) == 1


def shadows(shape, across):
    """A matrix whose patches all cast the same blurred light, moved across by some patches."""
    rows, columns = (np.arange(-6, size + 6) for size in shape)
    down, right = (np.arange(size) for size in shape)
    of_rows = np.exp(-((rows[:, None] - down) ** 2) / 4)
    of_columns = np.exp(-((columns[:, None] - right - across) ** 2) / 4)
    return np.kron(of_rows, of_columns)


def test_an_image_that_touches_the_border_explains_no_more_than_the_right_one():
    """The same photograph by light that is moved, of an image that is moved back."""
    shape, random = (8, 12), np.random.default_rng(2)
    image = np.zeros((*shape, 3))
    image[3:6, 2:9] = random.uniform(0.6, 1, (3, 7, 3))
    y = shadows(shape, 0) @ image.reshape(-1, 3)
    at_border = np.roll(image, -2, axis=1)
    np.testing.assert_allclose(shadows(shape, 2) @ at_border.reshape(-1, 3), y, atol=1e-12)
    y += 1e-2 * y.mean() * random.standard_normal(y.shape)
    none = np.zeros((len(y), 0))
    right, wrong, farther = (explain(shadows(shape, k), none, y, shape).evidence for k in (0, 2, 4))
    assert abs(wrong - right) < 10
    assert farther > right + 100  # the image would have to leave the monitor
