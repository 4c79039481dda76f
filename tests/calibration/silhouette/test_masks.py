"""What a mask explains, of an unknown image and of known pictures, against brute force."""

import numpy as np
import pytest
from scipy import optimize, sparse
from scipy.optimize import approx_fprime

from periscopy_sim.calibration.silhouette.blind import (
    BlindPhotograph,
    improbability,
    nonnegative_fit,
)
from periscopy_sim.calibration.silhouette.known import KnownPictures
from periscopy_sim.calibration.silhouette.mask import opaque, overlap, usual_opacity
from periscopy_sim.calibration.silhouette.shadows import CellShadows
from tests.calibration.silhouette.conftest import FLAG

PIXELS, HIDDEN, CELLS = 60, (3, 4), (2, 3)
PATCHES, COUNT = 12, 6
RATIO, ALLOWANCE = 0.02, 1e-2
RIGHT = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0]])


@pytest.fixture
def random():
    return np.random.default_rng(5)


@pytest.fixture
def shadows(random):
    """Cells that hold off random light."""
    blocked = sparse.csr_array((0.3 * random.random((PIXELS * PATCHES, COUNT))).astype(np.float32))
    return CellShadows((2 + random.random((PIXELS, PATCHES))).astype(np.float32), blocked)


@pytest.fixture
def background(random):
    return np.linalg.qr(random.standard_normal((PIXELS, 3)))[0]


@pytest.fixture
def blind(random, shadows, background):
    """A photograph of an image half dark."""
    image = np.maximum(random.standard_normal((PATCHES, 3)), 0)
    light = shadows.matrix(RIGHT.ravel()) @ image
    return BlindPhotograph.of(shadows, CELLS, background, light, HIDDEN)


@pytest.fixture
def known(random, shadows, background):
    pictures = [random.random((PATCHES, 3)) for _ in range(2)]
    A = shadows.matrix(RIGHT.ravel())
    mixture = np.eye(3) + 0.1 * random.random((3, 3))
    light = [A @ f @ mixture + 1e-3 * random.standard_normal((PIXELS, 3)) for f in pictures]
    return KnownPictures.of(shadows, CELLS, background, light, pictures)


def test_the_evidence_is_the_formula_of_its_module(blind, random):
    opacities = random.random(CELLS)
    Q = blind.background.astype(float)
    A = blind.shadows.matrix(opacities.ravel()).astype(float)
    A -= Q @ (Q.T @ A)
    H = A.T @ A + RATIO * blind.smoothness
    total = 3 * (np.linalg.slogdet(H)[1] - np.linalg.slogdet(RATIO * blind.smoothness)[1])
    factor = np.linalg.cholesky(H)
    for y in blind.photograph.T:
        image = optimize.nnls(factor.T, np.linalg.solve(factor, A.T @ y))[0]
        misfit = np.sum((y - A @ image) ** 2) + RATIO * image @ blind.smoothness @ image
        total += blind.freedom * np.log(misfit / (y @ y) + ALLOWANCE)
    fit = blind.fit(opacities, RATIO, ALLOWANCE)
    assert fit.evidence == pytest.approx(total, abs=0.03)
    assert (fit.image >= 0).all()
    assert (fit.image == 0).any()


def test_colours_and_ambient_light_are_fitted_by_least_squares(known, shadows, background, random):
    opacities = random.random(CELLS)
    A = shadows.matrix(opacities.ravel())
    total = 0.0
    for y, f in zip(known.photographs, known.pictures, strict=True):
        misfit = np.linalg.lstsq(np.hstack([A @ f, background]), y, rcond=None)[1]
        total += (PIXELS - 3) * np.log(misfit / np.sum(y**2, axis=0)).sum()
    assert known.explain(opacities).evidence == pytest.approx(total, rel=1e-3)


@pytest.mark.parametrize("kind", ["blind", "known"])
def test_gradients_are_those_of_values(kind, request, random):
    problem = request.getfixturevalue(kind)
    opacities = 0.2 + 0.6 * random.random(CELLS)

    def fit(o):
        if kind == "known":
            return problem.explain(o)
        return problem.fit(o, RATIO, ALLOWANCE)

    steps = 1e-2 * np.eye(COUNT).reshape(COUNT, *CELLS)  # single precision tells it from these on
    numeric = [
        (fit(opacities + step).objective - fit(opacities - step).objective) / 2e-2 for step in steps
    ]
    gradient = fit(opacities).gradient
    np.testing.assert_allclose(gradient, numeric, rtol=0.03, atol=0.03 * np.abs(numeric).max())


def test_images_do_not_depend_on_where_they_are_sought_from(blind, random):
    opacities = random.random(CELLS)
    starts = np.ones((PATCHES, 3)), np.zeros((PATCHES, 3)), random.standard_normal((PATCHES, 3))
    first, *others = (blind.fit(opacities, RATIO, 0.0, start) for start in starts)
    for other in others:
        np.testing.assert_allclose(other.image, first.image, atol=1e-9)


def test_the_right_mask_explains_more_than_others(blind, known, random):
    for problem in (blind, known):
        right = problem.explain(RIGHT).evidence
        assert all(right < problem.explain(random.random(CELLS)).evidence - 20 for _ in range(5))
    np.testing.assert_allclose(known.descend().opacities, RIGHT, atol=0.1)


def test_the_best_nonnegative_image_is_that_of_a_library(random):
    for _ in range(5):
        root, y = random.standard_normal((30, 12)), random.standard_normal(30)
        image = nonnegative_fit(root.T @ root, root.T @ y, random.standard_normal(12))
        np.testing.assert_allclose(image, optimize.nnls(root, y)[0], atol=1e-9)


def test_the_gradient_of_the_prior_is_that_of_its_value(random):
    opacities = random.random((4, 5))
    _, gradient = improbability(opacities)
    numeric = approx_fprime(opacities.ravel(), lambda o: improbability(o.reshape(4, 5))[0], 1e-7)
    np.testing.assert_allclose(gradient.ravel(), numeric, rtol=1e-4, atol=1e-4)


def test_a_longer_outline_and_a_place_at_the_border_are_less_probable():
    block, scattered, aside = np.zeros((3, 8, 8))
    block[3:5, 3:5] = 1
    scattered[2:6:3, 2:6:3] = 1
    aside[1:3, 1:3] = 1
    assert improbability(block)[0] < improbability(aside)[0]
    assert improbability(block)[0] < improbability(scattered)[0]
    assert improbability(block / 2)[0] == pytest.approx(improbability(block)[0], rel=0.1)


def test_a_fainter_mask_has_the_same_opaque_cells():
    faint = 0.3 * FLAG + 0.05
    np.testing.assert_array_equal(opaque(faint), FLAG)
    assert usual_opacity(0.3 * FLAG) == pytest.approx(0.3)
    assert not opaque(np.zeros((3, 3))).any()


def test_masks_are_compared_wherever_they_are_shifted():
    moved = np.roll(FLAG, (1, -1), (0, 1))
    assert overlap(FLAG, moved, 1) == 1
    assert overlap(FLAG, moved, 0) < 0.8
    assert overlap(FLAG, np.zeros_like(FLAG)) == 0
