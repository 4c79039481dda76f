"""What errors of a scene's parameters do to light."""

import numpy as np
import pytest

from periscopy_sim.model.uncertainty import UncertainTransport

RNG = np.random.default_rng(0)
CHANGES = RNG.standard_normal((2, 8, 5))
TRANSPORT = UncertainTransport(
    ("x", "turn"),
    RNG.standard_normal((2, 3)),
    lambda image: CHANGES @ image.reshape(-1, 3),
)
MASK = np.array([[True, False, True, True], [False, True, True, True]])


@pytest.mark.parametrize("mask", [None, MASK, MASK.ravel()])
def test_light_is_that_of_every_direction_in_the_pixels_used(mask):
    image = RNG.random((1, 5, 3))
    expected = np.einsum("pk,pmn,nc->kcm", TRANSPORT.directions, CHANGES, image[0])
    expected = expected if mask is None else expected[..., MASK.ravel()]
    np.testing.assert_allclose(TRANSPORT.lights(image, mask), expected, atol=1e-12)
