"""What errors of a scene's parameters do to A, and what is rejected."""

from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.model.uncertain_transport import UncertainTransport

RNG = np.random.default_rng(0)
CHANGES = RNG.standard_normal((3, 8, 5)).astype(np.float32)
TRANSPORT = UncertainTransport(
    ("x", "turn"), np.array([0.1, 2.0]), RNG.standard_normal((2, 3)), CHANGES
)
MASK = np.array([[True, False, True, True], [False, True, True, True]])


@pytest.mark.parametrize("mask", [None, MASK, MASK.ravel()])
def test_light_is_that_of_every_direction_in_the_pixels_used(mask):
    image = RNG.random((1, 5, 3))
    expected = np.einsum("kmn,nc->kcm", CHANGES, image[0])
    expected = expected if mask is None else expected[..., MASK.ravel()]
    np.testing.assert_allclose(TRANSPORT.lights(image, mask), expected, atol=1e-5)


def test_standard_errors_follow_the_directions():
    L = TRANSPORT.directions
    np.testing.assert_allclose(TRANSPORT.standard_errors**2, np.diag(L @ L.T))
    TRANSPORT.check((8, 5))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"changes": CHANGES[:2]}, "(2, 8, 5)"),
        ({"changes": np.where(CHANGES > 2, np.nan, CHANGES)}, "finite"),
    ],
)
def test_what_does_not_fit_is_rejected(wrong, words):
    with pytest.raises(ValueError) as error:
        replace(TRANSPORT, **wrong).check((8, 5))
    assert words in str(error.value)


def test_an_error_that_changes_nothing_is_named():
    still = CHANGES.copy()
    still[1] = 0
    turned = replace(TRANSPORT, changes=still, directions=np.array([[1, 0.1, 0], [0, 2, 1]]))
    with pytest.raises(ValueError, match="'turn'"):
        turned.check((8, 5))
