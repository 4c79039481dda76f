import numpy as np
import pytest
from scipy import optimize
from scipy.optimize import approx_fprime

from periscopy_sim.calibration.level import Averaged
from periscopy_sim.calibration.silhouette.evidence import (
    MaskEvidence,
    descend,
    improbability,
    nonnegative_fit,
    opaque,
    usual_opacity,
)
from periscopy_sim.calibration.silhouette.shadows import CellShadows

pytestmark = pytest.mark.usefixtures("jit")

PIXELS, HIDDEN, CELLS = 60, (3, 4), 6
PATCHES = HIDDEN[0] * HIDDEN[1]
RATIO = 0.02
OVERDISPERSION = 1.5


@pytest.fixture
def random():
    return np.random.default_rng(5)


@pytest.fixture
def evidence(random):
    """Of a photograph of an image half dark, behind cells that hold off random light."""
    held = 0.3 * random.random((PIXELS, PATCHES, CELLS))
    entry = np.repeat(np.arange(PIXELS * PATCHES), CELLS)
    cell = np.tile(np.arange(CELLS, dtype=np.int32), PIXELS * PATCHES)
    shadows = CellShadows(
        2 + random.random((PIXELS, PATCHES)), CELLS, entry, cell, held.ravel().astype(np.float32)
    )
    background = np.linalg.qr(random.standard_normal((PIXELS, 3)))[0]
    image = np.maximum(random.standard_normal((PATCHES, 3)), 0)
    light = shadows.matrix((np.arange(CELLS) % 2).astype(float)) @ image
    averaged = Averaged(np.ones((6, 10), bool), light)
    return MaskEvidence.of(shadows, averaged, background, HIDDEN).tempered(OVERDISPERSION)


def at(evidence, opacities, allowance=1e-2):
    return evidence.at(opacities, RATIO, allowance, np.ones((PATCHES, 3)))


def test_it_is_the_formula_of_its_module(evidence, random):
    opacities = random.random(CELLS)
    Q = evidence.background.astype(float)
    A = evidence.shadows.matrix(opacities)
    A = A - Q @ (Q.T @ A)
    H = A.T @ A + RATIO * evidence.smoothness
    total = 3 * (np.linalg.slogdet(H)[1] - np.linalg.slogdet(RATIO * evidence.smoothness)[1])
    factor = np.linalg.cholesky(H)
    for y in evidence.photograph.T:
        image = optimize.nnls(factor.T, np.linalg.solve(factor, A.T @ y))[0]
        left = np.sum((y - A @ image) ** 2) + RATIO * image @ evidence.smoothness @ image
        total += evidence.freedom * np.log(left / (y @ y) + 1e-2)
    found = at(evidence, opacities)
    assert found.evidence == pytest.approx(total / OVERDISPERSION, abs=0.02)
    assert (found.images >= 0).all()
    assert (found.images == 0).any()


def test_its_gradient_is_that_of_its_value(evidence, random):
    opacities, step = random.random(CELLS), 1e-2
    fit = at(evidence, opacities)
    gradient = 2 * fit.linearized()[0]
    for k in range(CELLS):
        moved = step * np.eye(CELLS)[k]
        ahead, behind = (at(evidence, opacities + sign * moved).evidence for sign in (1, -1))
        assert gradient[k] == pytest.approx((ahead - behind) / (2 * step), rel=0.03, abs=0.5)


def test_images_do_not_depend_on_where_they_are_sought_from(evidence, random):
    opacities = random.random(CELLS)
    starts = np.ones((PATCHES, 3)), np.zeros((PATCHES, 3)), random.standard_normal((PATCHES, 3))
    first, *others = (evidence.at(opacities, RATIO, 0.0, start) for start in starts)
    for other in others:
        assert other.evidence == pytest.approx(first.evidence, abs=1e-6)
        np.testing.assert_allclose(other.images, first.images, atol=1e-9)


def test_the_right_mask_explains_more_than_others(evidence, random):
    right = evidence.explain((np.arange(CELLS) % 2).astype(float)[None])
    others = [evidence.explain(random.random((1, CELLS))).evidence for _ in range(5)]
    assert right.evidence < min(others) - 20
    assert right.opaque.tolist() == [[False, True] * 3]


def test_the_best_nonnegative_image_is_that_of_a_library(random):
    for _ in range(5):
        root = random.standard_normal((30, 12))
        y = random.standard_normal(30)
        found = nonnegative_fit(root.T @ root, root.T @ y, random.standard_normal(12))
        np.testing.assert_allclose(found, optimize.nnls(root, y)[0], atol=1e-9)


def test_information_weighs_what_no_shining_patch_can_follow(evidence, random):
    fit = at(evidence, random.random(CELLS), 0.0)
    _, H = fit.linearized()
    Q = evidence.background.astype(float)
    A = evidence.shadows.matrix(fit.opacities)
    A = A - Q @ (Q.T @ A)
    expected = np.zeros((CELLS, CELLS))
    light = evidence.shadows.held_off(fit.images)
    light = light - Q @ (Q.T @ light)
    for c in range(3):
        on = fit.images[:, c] > 0
        J = light[:, :, c].T
        hessian = (A.T @ A + RATIO * evidence.smoothness)[np.ix_(on, on)]
        left = J - A[:, on] @ np.linalg.solve(hessian, A[:, on].T @ J)
        expected += J.T @ left / (fit.noise[c] ** 2 * OVERDISPERSION)
    np.testing.assert_allclose(H, expected, rtol=1e-2, atol=1e-2 * np.abs(expected).max())


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


def test_a_descent_lowers_the_objective_and_stays_within_bounds(evidence, random):
    start = random.random((2, 3))
    end = descend(evidence, start, ((1e-2, 20), (0.0, 40)))
    assert end.objective < evidence.explain(start).objective
    assert end.opacities.min() >= 0 and end.opacities.max() <= 1


def test_a_fainter_mask_has_the_same_opaque_cells():
    mask = np.zeros((5, 5))
    mask[1:3, 1:4] = 1
    faint = 0.3 * mask + 0.05
    np.testing.assert_array_equal(opaque(faint), mask > 0)
    assert usual_opacity(0.3 * mask) == pytest.approx(0.3)
    assert not opaque(np.zeros((3, 3))).any()
