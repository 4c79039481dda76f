import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.search.mask_prior import improbability
from scipy.optimize import approx_fprime


def test_the_gradient_of_the_prior_is_that_of_its_value():
    opacities = np.random.default_rng(0).random((4, 5))
    _, gradient = improbability(opacities)
    numeric = approx_fprime(opacities.ravel(), lambda m: improbability(m.reshape(4, 5))[0], 1e-7)
    np.testing.assert_allclose(gradient.ravel(), numeric, rtol=1e-4, atol=1e-4)


def test_a_fainter_mask_is_as_probable():
    """Or every mask would fade: a brighter image makes up for it."""
    opacities = np.zeros((6, 6))
    opacities[2:4, 1:5] = 1
    whole, half = (improbability(factor * opacities)[0] for factor in (1, 0.5))
    assert half == pytest.approx(whole, rel=0.1)


def test_a_longer_outline_and_a_place_at_the_border_are_less_probable():
    block, scattered, aside = np.zeros((3, 8, 8))
    block[3:5, 3:5] = 1
    scattered[2:6:3, 2:6:3] = 1
    aside[1:3, 1:3] = 1
    assert improbability(block)[0] < improbability(aside)[0]
    assert improbability(block)[0] < improbability(scattered)[0]
