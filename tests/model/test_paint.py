"""Paint that background photographs show multiplies the hidden image's light, too; edges do not."""

import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.model import paint
from periscopy_sim.model.fit import Fit, FittedPhotograph
from periscopy_sim.model.paint import Paint
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.noise_aware import NoiseAware

PHOTOGRAPH, HIDDEN = (30, 36), (3, 4)
M, N = 1080, 12
RNG = np.random.default_rng(80)
A = RNG.uniform(0.1, 1, (M, N))
DOWN, ACROSS = (axis.ravel() for axis in np.mgrid[-1:1:30j, -1:1:36j])
B = np.stack([np.ones(M), 1 + 0.5 * DOWN, 1 + 0.5 * ACROSS, 2 - DOWN**2 + ACROSS], axis=1)
TRUTH = RNG.uniform(0.2, 1, (N, 3))
LAMP, OTHER = B @ RNG.uniform(0.5, 1, (4, 3)), B @ RNG.uniform(0.5, 1, (4, 3))
PAINT = 0.02 * RNG.normal(size=(M, 1)) * [1.0, 0.8, 1.2]
NOISE = 0.004
SCENE = {"hidden": HIDDEN, "photograph_shape": PHOTOGRAPH}


def photograph(light, paint=PAINT, noise=NOISE, seed=0):
    return (1 + paint) * light + noise * np.random.default_rng(seed).normal(size=(M, 3))


Y = photograph(A @ TRUTH + LAMP)
OFF = photograph(2 * LAMP, seed=1)


def whole(y, off, mask=None):
    """A photograph with others of the monitor off, (M, 3) each."""
    y, *dark = (each.reshape(*PHOTOGRAPH, 3) for each in (y, *off))
    return Photograph.of(y, mask=mask, monitor_off=dark)


def fitted(off, mask=None, B=B):
    return Fit(A, B, hidden=Hidden.of(HIDDEN), conditions=whole(Y, off, mask))


def evenness(y, off, mask=None):
    fit = fitted(off, mask)
    return Paint(fit).evenness(fit.planes(y[None])[0])


def solved(y, off, *corrections):
    method = NoiseAware(A, B, **SCENE, profiles=False, corrections=corrections)
    return method.solve(whole(y, off))


def test_wall_is_made_even_and_the_image_is_better_for_it():
    left = evenness(Y, [OFF]).T * (1 + PAINT) - 1
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(PAINT**2))
    found, columns = (solved(Y, [OFF], *each) for each in ((Paint,), ()))
    assert found.corrections == {"paint_found": True}
    truth = TRUTH.reshape(*HIDDEN, 3)
    assert np.sum((found.image - truth) ** 2) < 0.5 * np.sum((columns.image - truth) ** 2)
    assert (found.noise < 0.7 * columns.noise).all()


def test_correction_multiplies_the_photograph_by_the_evenness():
    fit = fitted([OFF])
    given = FittedPhotograph(fit.planes(Y[None])[0], fit)
    corrected, found = Paint(fit)(given, None)
    np.testing.assert_allclose(corrected.planes, evenness(Y, [OFF]) * given.planes)
    assert corrected.fit is fit and found == {"paint_found": True}
    even = photograph(A @ TRUTH + LAMP, 0)
    given = FittedPhotograph(fit.planes(even[None])[0], fit)
    corrected, found = Paint(fit)(given, None)
    assert corrected is given and found == {"paint_found": False}


def test_shares_are_those_of_joint_least_squares():
    off = [OFF, photograph(OTHER, seed=2)]
    even = evenness(Y, off)
    smooth = B @ np.linalg.lstsq(B, np.hstack(off))[0]
    d = 1 - smooth / np.hstack(off)
    for channel in range(3):
        y = Y[:, channel]
        explaining = np.hstack([d * y[:, None], A, B, *off])
        shares = np.linalg.lstsq(explaining / np.linalg.norm(explaining, axis=0), y)[0][:6]
        shares /= np.linalg.norm(d * y[:, None], axis=0)
        np.testing.assert_allclose(even[channel], 1 - d @ shares, atol=1e-4)


def test_edges_in_the_light_are_not_taken_for_paint():
    bars = 0.05 * (np.sin(9 * ACROSS + 4 * DOWN) > 0)[:, None]
    off = photograph((1 + bars) * LAMP, 0, seed=1)
    even = evenness(photograph(A @ TRUTH + (1 + bars) * LAMP, 0), [off])
    assert np.abs(even - 1).max() < 0.1 * bars.max()


def test_paint_is_told_from_edges_by_photographs_under_several_lights():
    bars = 0.2 * (np.sin(9 * ACROSS + 4 * DOWN) > 0)[:, None]
    y = photograph(A @ TRUTH + (1 + bars) * LAMP)
    one = photograph((1 + bars) * LAMP, seed=1)
    both = [one, photograph(OTHER, seed=2)]
    left = [np.std(evenness(y, off).T * (1 + PAINT)) for off in ([one], both)]
    assert left[1] < 0.3 * np.std(PAINT) and left[1] < 0.5 * left[0]


def test_noise_is_shrunk_by_the_ratio_of_variances(monkeypatch):
    # Three channels of independent noise ν show one grey u: the best mixture of the three is their
    # mean, times u² / (u² + ν²/3), of energy u² times the same number.
    monkeypatch.setattr(paint, "WORTH", 0.0)
    ν, shrinkages = 0.015, []
    grey = np.repeat(PAINT[:, :1], 3, axis=1)
    expected = np.var(grey) / (np.var(grey) + ν**2 / 3)
    for seed in range(20):
        off = photograph(LAMP, grey, ν * LAMP, seed=100 + seed)
        y = photograph(A @ TRUTH + LAMP, grey, seed=200 + seed)
        shrinkages.append(np.sum((evenness(y, [off]) - 1) ** 2) / np.sum(grey**2))
    error = np.std(shrinkages) / np.sqrt(20)
    assert expected < 0.85
    # Four standard errors, and what B takes of the fields.
    assert abs(np.mean(shrinkages) - expected) < 4 * error + 0.02


def test_even_wall_is_left_alone(monkeypatch):
    monkeypatch.setattr(paint, "WORTH", 0.0)
    found = 0
    for seed in range(300):
        y = photograph(A @ TRUTH + LAMP, 0, seed=2 * seed)
        off = photograph(LAMP, 0, 0.02, seed=2 * seed + 1)
        found += bool((evenness(y, [off]) != 1).any())
    # At an error rate of 0.1 % more than 3 of 300 are found once in 3000 tries.
    assert found <= 3


def test_background_photograph_of_noise_costs_next_to_nothing():
    errors = np.zeros(2)
    for seed in range(20):
        y = photograph(A @ TRUTH + LAMP, 0, seed=seed)
        off = np.random.default_rng(1000 + seed).uniform(size=(M, 3))
        for k, given in enumerate(([], [off])):
            image = solved(y, given, *[Paint] * len(given)).image
            errors[k] += np.sum((image.reshape(N, 3) - TRUTH) ** 2)
    assert errors[1] < 1.02 * errors[0]  # 0.1 dB


def test_nothing_is_found_without_smooth_light_and_nothing_done_without_photographs():
    fit = fitted([OFF], B=None)
    given = FittedPhotograph(fit.planes(Y[None])[0], fit)
    assert Paint(fit)(given, None)[0] is given
    with pytest.raises(ValueError, match="monitor off"):
        Paint(fitted([]))


def test_mask_leaves_out_paint_and_whatever_lies_there():
    mask = RNG.random(PHOTOGRAPH) > 0.2
    used = mask.ravel()
    y, off = (np.where(used[:, None], each, np.nan) for each in (Y, OFF))
    found = evenness(y, [off], mask)
    d = 1 - B[used] @ np.linalg.lstsq(B[used], OFF[used])[0] / OFF[used]
    np.testing.assert_allclose(found[0] - 1, d @ np.linalg.lstsq(d, found[0] - 1)[0], atol=1e-6)
    left = found.T * (1 + PAINT[used]) - 1
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(PAINT**2))
