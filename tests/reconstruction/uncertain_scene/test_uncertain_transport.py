"""What errors of a scene's parameters do to A, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from periscopy_sim.model.uncertain_transport import UncertainTransport

RNG = np.random.default_rng(0)
CHANGES = RNG.standard_normal((2, 3, 8, 5)).astype(np.float32)
TRANSPORT = UncertainTransport(
    ("x", "turn"), np.array([0.1, 2.0]), RNG.standard_normal((2, 3)), CHANGES
)
MASK = np.array([[True, False, True, True], [False, True, True, True]])


def test_light_and_change_are_those_of_every_direction_in_the_pixels_used():
    images, u = RNG.random((5, 3)), RNG.standard_normal(3)
    used = MASK.ravel()
    expected = np.einsum("skmn,nc->skcm", CHANGES, images)[..., used]
    np.testing.assert_allclose(TRANSPORT.lights(images, MASK), expected, atol=1e-5)
    change = np.einsum("k,kmn->mn", u, CHANGES.mean(axis=0))[used]
    np.testing.assert_allclose(TRANSPORT.change(u, MASK), change, atol=1e-5)


def test_parameters_and_their_errors_follow_the_directions():
    u = np.array([1.0, -2.0, 0.5])
    L = TRANSPORT.directions
    np.testing.assert_allclose(TRANSPORT.at(u), TRANSPORT.values + L @ u)
    np.testing.assert_allclose(TRANSPORT.standard_errors**2, np.diag(L @ L.T))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"changes": CHANGES[:, :2]}, "with 3 directions they must be (1, 3, 8, 5), or 2 of them"),
        ({"changes": np.concatenate([CHANGES, CHANGES])}, "changes have shape (4, 3, 8, 5)"),
        ({"names": ("x",)}, "1 names and 2 values"),
        ({"directions": np.zeros((2, 0))}, "directions of shape (2, 0)"),
        ({"changes": np.where(CHANGES > 2, np.nan, CHANGES)}, "must be finite"),
    ],
)
def test_what_does_not_fit_is_refused(wrong, words):
    with pytest.raises(ValueError) as error:
        replace(TRANSPORT, **wrong).check((8, 5))
    assert words in str(error.value)


def test_an_error_that_changes_nothing_is_named():
    still = CHANGES.copy()
    still[:, 1] = 0
    turned = replace(TRANSPORT, changes=still, directions=np.array([[1, 0.1, 0], [0, 2, 1]]))
    with pytest.raises(ValueError, match="does not show an error of 'turn'"):
        turned.check((8, 5))
