from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.search.image_shift import BETWEEN_PATCHES, NEGLIGIBLE
from periscopy_sim.calibration.search.telling import (
    CERTAIN,
    _parts,
    least_gain,
    standard_error,
)

from periscopy_sim.calibration.prior import Prior

ROWS, COLUMNS, PIXELS = 40, 60, 2400
DRAWS = 300


def level(ruler=None, used=None):
    return SimpleNamespace(
        photograph_shape=(ROWS, COLUMNS),
        used=np.ones((ROWS, COLUMNS), bool) if used is None else used,
        prior=ruler or Prior.none(1),
    )


def place(residuals, deviations=(1.0, 1.0, 1.0), values=(0.0,)):
    errors = residuals / np.array(deviations)
    return np.array(values), SimpleNamespace(
        residuals=residuals,
        deviations=np.array(deviations),
        unabsorbed=lambda pixels: errors[pixels],
    )


def about(moved, ruler=None):
    """Return what the photograph tells of parameters by which it moves so, (P, M, 3)."""
    precision = np.zeros(len(moved)) if ruler is None else ruler.precision
    information = np.einsum("imc,jmc->ij", moved, moved) + np.diag(precision)
    return SimpleNamespace(
        jacobian=SimpleNamespace(projected=moved[None]), invertible=lambda: information
    )


STILL = about(np.ones((1, PIXELS, 3)))


def blocky(rng):
    """Errors that 4 x 6 pixels share."""
    return np.kron(rng.normal(size=(10, 10)), np.ones((4, 6))).ravel()[:, None] * np.ones(3)


def test_the_standard_error_is_the_spread_of_the_difference_over_draws_of_white_noise():
    """Twice the length of what two models differ by, over the noise: both are wrong alike."""
    rng = np.random.default_rng(1)
    differ = 0.05 * rng.normal(size=(PIXELS, 3))
    differences, errors = [], []
    for _ in range(DRAWS):
        noise = rng.normal(size=differ.shape)
        here, there = noise + differ, noise - differ
        differences.append(BETWEEN_PATCHES * (np.sum(here**2) - np.sum(there**2)))
        errors.append(standard_error(level(), STILL, place(here), place(there)))
    white = BETWEEN_PATCHES * 4 * np.linalg.norm(differ)
    assert np.std(differences) == pytest.approx(white, rel=0.15)  # 4 of its own errors
    assert np.mean(errors) == pytest.approx(np.std(differences), rel=0.15)


def test_errors_that_neighbours_share_are_told():
    """By pixels that are independent one would think the standard error a third."""
    rng = np.random.default_rng(2)
    differ = 0.05 * blocky(rng)
    differences, errors = [], []
    for _ in range(DRAWS):
        shared = blocky(rng)
        here, there = shared + differ, shared - differ
        differences.append(BETWEEN_PATCHES * (np.sum(here**2) - np.sum(there**2)))
        errors.append(standard_error(level(), STILL, place(here), place(there)))
    assert np.mean(errors) == pytest.approx(np.std(differences), rel=0.15)
    assert np.std(differences) > 3 * BETWEEN_PATCHES * 4 * np.linalg.norm(differ)


@pytest.mark.parametrize("patch", [0.0, 3.0])
def test_the_rulers_penalty_errs_as_far_as_the_values_follow_the_errors(patch):
    """Two dips, with a patch of values between them; of each draw's errors both find the bottom."""
    rng = np.random.default_rng(3)
    ruler = Prior(np.zeros(2), np.array([1.0, 0.7]))
    moved = 0.01 * rng.normal(size=(2, 1, 1)) + 0.01 * rng.normal(size=(2, PIXELS, 3))
    known, between = about(moved, ruler), np.array([patch, -0.5 * patch])
    directions = moved.reshape(2, -1)
    differ, truth = 0.03 * blocky(rng), np.array([0.4, -0.3])

    def bottom(light, dip):
        """Return where misfit and penalty are least together, and what they are compared by."""
        pull = directions @ (light.ravel() + directions.T @ dip)
        values = np.linalg.solve(known.invertible(), pull)
        residuals = light - np.tensordot(values - dip, moved, 1)
        compared = ruler.penalty(values) + BETWEEN_PATCHES * np.sum(residuals**2)
        return place(residuals, values=values), compared

    differences, errors = [], []
    for _ in range(DRAWS):
        light = np.tensordot(truth, moved, 1) + blocky(rng)
        here, of_here = bottom(light + differ, np.zeros(2))
        there, of_there = bottom(light - differ, between)
        differences.append(of_here - of_there)
        errors.append(standard_error(level(ruler), known, here, there))
    assert np.mean(errors) == pytest.approx(np.std(differences), rel=0.2)
    by_misfit = BETWEEN_PATCHES * 4 * np.sqrt(24 * 3) * np.linalg.norm(differ)
    if patch:
        assert np.std(differences) > 1.5 * by_misfit
    else:
        assert np.std(differences) < 1.2 * by_misfit


def test_each_part_is_the_derivative_of_what_is_compared_by_its_blocks_weight():
    """A block's errors count in where the values are, too, which then count in the penalty."""
    rng = np.random.default_rng(6)
    ruler = Prior(np.array([0.5, -1.0]), np.array([1.0, 0.7]))
    moved = 0.05 * rng.normal(size=(2, PIXELS, 3)) + 0.02 * rng.normal(size=(2, 1, 1))
    light = blocky(rng) + rng.normal(size=(PIXELS, 3)) + np.tensordot([0.7, 0.4], moved, 1)
    block = np.kron(np.arange(100).reshape(10, 10), np.ones((4, 6), int)).ravel()

    def compared(weights):
        weighed = moved * weights[block][:, None]
        total = np.einsum("imc,jmc->ij", weighed, moved) + np.diag(ruler.precision)
        pull = np.einsum("imc,mc->i", weighed, light) + ruler.precision * ruler.centers
        values = np.linalg.solve(total, pull)
        residuals = light - np.tensordot(values, moved, 1)
        misfit = np.sum(weights[block][:, None] * residuals**2)
        return ruler.penalty(values) + BETWEEN_PATCHES * misfit, values, residuals

    _, values, residuals = compared(np.ones(100))
    parts = _parts(level(ruler), about(moved, ruler), *place(residuals, values=values))
    for k in (0, 37, 99):
        step = 1e-4 * (np.arange(100) == k)
        expected = (compared(1 + step)[0] - compared(1 - step)[0]) / 2e-4
        assert parts[k] == pytest.approx(expected, rel=1e-5)
    penalties = parts - BETWEEN_PATCHES * np.bincount(block, np.sum(residuals**2, axis=1))
    assert np.abs(penalties).max() > 0.02 * np.abs(parts).max()  # either shows


def test_each_place_has_a_noise_of_its_own_and_pixels_that_are_masked_do_not_count():
    rng = np.random.default_rng(4)
    noise, other = rng.normal(size=(2, PIXELS, 3))
    whole = standard_error(level(), STILL, place(noise), place(other))
    doubled = standard_error(level(), STILL, place(2 * noise, (2, 2, 2)), place(other))
    assert doubled == pytest.approx(whole)
    used = np.ones((ROWS, COLUMNS), bool)
    used[:, : COLUMNS // 2] = False
    left = (place(values[used.ravel()]) for values in (noise, other))
    half = standard_error(level(used=used), about(np.ones((1, PIXELS // 2, 3))), *left)
    assert half == pytest.approx(whole / np.sqrt(2), rel=0.25)


def test_what_is_certain_is_worth_a_move_and_what_the_rays_change_is_not():
    calm = place(np.zeros((PIXELS, 3)))
    assert least_gain(level(), STILL, calm, calm) == BETWEEN_PATCHES * NEGLIGIBLE
    rng = np.random.default_rng(5)
    here, there = (place(each) for each in rng.normal(size=(2, PIXELS, 3)))
    expected = CERTAIN * standard_error(level(), STILL, here, there)
    assert least_gain(level(), STILL, here, there) == expected > BETWEEN_PATCHES * NEGLIGIBLE
