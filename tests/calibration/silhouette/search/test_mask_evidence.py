from types import SimpleNamespace

import numpy as np
import pytest
from periscopy_sim.calibration.silhouette.cells.cell_shadows import CellShadows
from periscopy_sim.calibration.silhouette.search.mask_evidence import MaskEvidence
from scipy import optimize

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
    gain = 1 + 0.1 * random.random(PIXELS)
    light = gain[:, None] * (shadows.matrix((np.arange(CELLS) % 2).astype(float)) @ image)
    level = SimpleNamespace(
        light=light, hidden_shape=HIDDEN, gain=gain, overdispersion=OVERDISPERSION
    )
    return MaskEvidence.of(shadows, level, background)


def at(evidence, opacities, allowance=1e-2):
    return evidence.at(opacities, RATIO, allowance, np.ones((PATCHES, 3)))


def test_it_is_the_formula_of_its_module(evidence, random):
    opacities = random.random(CELLS)
    Q = evidence.background.astype(float)
    A = evidence.gain[:, None] * evidence.shadows.matrix(opacities)
    A = A - Q @ (Q.T @ A)
    H = A.T @ A + RATIO * evidence.smoothness
    total = 3 * (np.linalg.slogdet(H)[1] - np.linalg.slogdet(RATIO * evidence.smoothness)[1])
    factor = np.linalg.cholesky(H)
    for y in evidence.photograph.T:
        image = optimize.nnls(factor.T, np.linalg.solve(factor, A.T @ y))[0]
        left = np.sum((y - A @ image) ** 2) + RATIO * image @ evidence.smoothness @ image
        total += evidence.freedom * np.log(left / (y @ y) + 1e-2)
    found, _, images = at(evidence, opacities)
    assert found == pytest.approx(total / OVERDISPERSION, abs=0.02)
    assert (images >= 0).all()
    assert (images == 0).any()


def test_its_gradient_is_that_of_its_value(evidence, random):
    opacities, step = random.random(CELLS), 1e-2
    _, gradient, _ = at(evidence, opacities)
    for k in range(CELLS):
        moved = step * np.eye(CELLS)[k]
        ahead, behind = (at(evidence, opacities + sign * moved)[0] for sign in (1, -1))
        assert gradient[k] == pytest.approx((ahead - behind) / (2 * step), rel=0.03, abs=0.5)


def test_images_do_not_depend_on_where_they_are_sought_from(evidence, random):
    opacities = random.random(CELLS)
    starts = np.ones((PATCHES, 3)), np.zeros((PATCHES, 3)), random.standard_normal((PATCHES, 3))
    first, *others = (evidence.at(opacities, RATIO, 0.0, start) for start in starts)
    for other in others:
        assert other[0] == pytest.approx(first[0], abs=1e-6)
        np.testing.assert_allclose(other[2], first[2], atol=1e-9)


def test_the_right_mask_explains_more_than_others(evidence, random):
    right = (np.arange(CELLS) % 2).astype(float)
    α = evidence.best_ratio(right, 0.0)
    nothing = np.ones((PATCHES, 3))
    others = [evidence.at(random.random(CELLS), α, 0.0, nothing)[0] for _ in range(5)]
    assert evidence.at(right, α, 0.0, nothing)[0] < min(others) - 20
