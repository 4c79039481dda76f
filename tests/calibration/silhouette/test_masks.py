"""What a mask explains, of an unknown image and of known pictures, against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, sparse

from periscopy_sim.calibration import masks
from periscopy_sim.calibration.evidence import SmoothImages
from periscopy_sim.calibration.silhouette import UnknownImage
from periscopy_sim.hidden import Hidden
from periscopy_sim.testing import derivative_test
from tests.scenes.silhouette import FLAG

SIZE, HIDDEN, CELLS = (6, 10), (3, 4), (2, 3)
PIXELS, PATCHES, COUNT = 60, 12, 6
RATIO, ALLOWANCE = 0.02, 1e-2
RIGHT = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0]])
GAIN = np.array([0.7, -0.3, 0.1, 0.0, 0.2, 0.05, -0.05, 0.1, 0.05])  # in deviations of the prior


@pytest.fixture
def random():
    return np.random.default_rng(5)


@pytest.fixture
def mask(random):
    """Cells that hold off random light."""
    blocked = sparse.csr_array((0.3 * random.random((PIXELS * PATCHES, COUNT))).astype(np.float32))
    shadows = masks.CellShadows((2 + random.random((PIXELS, PATCHES))).astype(np.float32), blocked)
    return masks.Mask.of(CELLS, shadows, np.ones(SIZE, bool))


@pytest.fixture
def background(random):
    return np.linalg.qr(random.standard_normal((PIXELS, 3)))[0]


@pytest.fixture
def unknown(random, mask, background):
    """A photograph of an image half dark."""
    light = mask.transport(RIGHT, GAIN) @ np.maximum(random.standard_normal((PATCHES, 3)), 0)
    patches = SmoothImages.hats(*[Hidden.of(HIDDEN)] * 2)
    return UnknownImage(light, background, patches, RATIO, ALLOWANCE)


@pytest.fixture
def shown(random, mask):
    """Two pictures and their photographs."""
    A, pictures = mask.transport(RIGHT, GAIN), [random.random((PATCHES, 3)) for _ in range(2)]
    mixture = np.eye(3) + 0.1 * random.random((3, 3))
    light = [A @ f @ mixture for f in pictures]
    return light + 1e-3 * random.standard_normal((2, PIXELS, 3)), pictures


@pytest.fixture
def known(background, shown):
    return masks.known_pictures(background, *shown)


@pytest.fixture
def before_pictures(mask, shown):
    colours = np.hstack(shown[1])
    return replace(mask, shadows=mask.shadows.before(colours))


def test_the_evidence_is_the_formula_of_its_module(mask, unknown, random):
    opacities, Q, K = random.random(CELLS), unknown.background, unknown.images.precision
    A = mask.transport(opacities, GAIN).astype(float)
    A -= Q @ (Q.T @ A)
    H = A.T @ A + RATIO * K
    total = 3 * (np.linalg.slogdet(H)[1] - np.linalg.slogdet(RATIO * K)[1])
    factor = np.linalg.cholesky(H)
    for y in unknown.photograph.T:
        rest = y - Q @ (Q.T @ y)
        image = optimize.nnls(factor.T, np.linalg.solve(factor, A.T @ rest))[0]
        misfit = np.sum((rest - A @ image) ** 2) + RATIO * image @ K @ image
        total += (PIXELS - 3) * np.log(misfit + ALLOWANCE * rest @ rest)
    explained = mask.fit(opacities, GAIN, unknown).explained
    assert explained.cost == pytest.approx(total, abs=0.03)
    assert (explained.image >= 0).all()
    assert (explained.image == 0).any()


def test_colours_and_ambient_light_are_fitted_by_least_squares(
    mask, before_pictures, known, shown, background, random
):
    opacities = random.random(CELLS)
    A = mask.transport(opacities, GAIN)
    residual = before_pictures.fit(opacities, GAIN, known).explained.residual
    for y, f, rest in zip(*shown, residual, strict=True):
        misfit = np.linalg.lstsq(np.hstack([A @ f.reshape(-1, 3), background]), y, rcond=None)[1]
        np.testing.assert_allclose(np.sum(rest**2, axis=0), misfit, rtol=1e-3)


def test_patches_that_look_alike_are_explained(mask, unknown, random):
    A = mask.transport(RIGHT, GAIN)[:, :1] * random.random(PATCHES).astype(np.float32)
    assert np.isfinite(replace(unknown, ratio=1e-12)(A).cost)


@pytest.mark.parametrize(("kind", "rtol"), [("unknown", 1e-4), ("known", 1e-2)])
def test_slopes_of_the_evidence_are_its_derivatives(kind, rtol, request, random):
    """Of known pictures α moves a little, from one tried value to another; see `test_evidence`."""
    likelihood = request.getfixturevalue(kind)
    mask = request.getfixturevalue("before_pictures" if kind == "known" else "mask")
    A = mask.shadows.matrix(0.2 + 0.6 * random.random(COUNT)).astype(np.float64)
    changes = random.standard_normal((3, *A.shape))
    slopes = np.tensordot(changes, likelihood(A).slope, 2)

    def half(along):
        return likelihood(A + np.tensordot(along, changes, 1)).cost / 2

    derivative_test(half, slopes, np.zeros(3), rtol=rtol)


def test_gradients_are_those_of_values(mask, random):
    """By opacities and gain, of an evidence in double precision."""
    pull, f = random.standard_normal((PIXELS, PATCHES)), random.random(PATCHES)
    exact = masks.CellShadows(mask.shadows.open.astype(float), mask.shadows.blocked.astype(float))
    mask = replace(mask, shadows=exact)

    def likelihood(A):
        cost = 2 * np.vdot(pull, A) + np.sum((A @ f) ** 2)
        return masks.Explained(cost, pull + np.outer(A @ f, f), f, f)

    def fit(point):
        return mask.fit(point[:COUNT].reshape(CELLS), point[COUNT:], likelihood)

    point = np.append(0.2 + 0.6 * random.random(COUNT), GAIN)
    steps = np.repeat([0.01, 0.2], [COUNT, len(GAIN)])  # far enough for a gain of single precision
    derivative_test(lambda x: fit(x).objective, fit(point).gradient, point, steps=steps)


def test_the_right_mask_explains_more_than_others(mask, before_pictures, unknown, known, random):
    cases = (mask, replace(unknown, allowance=0.0)), (before_pictures, known)
    for mask, likelihood in cases:
        right = mask.fit(RIGHT, GAIN, likelihood).objective
        others = (mask.fit(random.random(CELLS), GAIN, likelihood) for _ in range(5))
        assert all(right < other.objective - 10 for other in others)
    end = before_pictures.descend(np.full(CELLS, 0.5), np.zeros(len(GAIN)), known)
    np.testing.assert_allclose(end.opacities, RIGHT, atol=0.1)
    np.testing.assert_allclose(end.gain, GAIN, atol=0.2)


def test_the_gradient_of_the_outline_is_that_of_its_length(random):
    opacities = random.random((4, 5))
    _, gradient = masks.outline(opacities)
    length = lambda o: masks.outline(o.reshape(4, 5))[0]  # noqa: E731
    derivative_test(length, gradient.ravel(), opacities.ravel(), steps=1e-4, atol=1e-8)
    block, scattered = np.zeros((2, 8, 8))
    block[3:5, 3:5] = 1
    scattered[2:6:3, 2:6:3] = 1
    assert masks.outline(block)[0] < masks.outline(scattered)[0]


def test_a_fainter_mask_has_the_same_opaque_cells():
    faint = 0.3 * FLAG + 0.05
    np.testing.assert_array_equal(masks.opaque(faint), FLAG)
    assert masks.usual_opacity(0.3 * FLAG) == pytest.approx(0.3)
    assert not masks.opaque(np.zeros((3, 3))).any()
