"""Images of few edges: the derivatives of their evidence, units, and a black photograph."""

import numpy as np
import pytest
from numpy.typing import NDArray

from periscopy_sim.calibration.evidence import SharpImages, smoothness
from periscopy_sim.hidden import Hidden
from periscopy_sim.testing import derivative_test

Array = NDArray[np.float64]

HIDDEN = Hidden.of((6, 5))
PATCHES, PIXELS, LIGHTS = 30, 200, 4


@pytest.fixture
def wall() -> tuple[Array, Array, Array]:
    """A, a basis of ambient light, and photographs of two pictures with black parts."""
    random = np.random.default_rng(5)
    A = random.random((PIXELS, PATCHES)) ** 4
    Q = np.linalg.qr(random.random((PIXELS, LIGHTS)))[0]
    f = np.kron(random.random((3, 5)) > 0.5, np.ones((2, 1))).ravel()
    lights = f[:, None] * random.random(6)
    y = A @ lights + Q @ random.random((LIGHTS, 6))
    return A, Q, y + 0.01 * random.standard_normal(y.shape)


def test_slope_is_the_derivative_of_the_evidence(wall: tuple[Array, Array, Array]) -> None:
    """To 1e-4 at the image that was found; to a tenth as it moves, which ends near its best."""
    A, Q, y = wall
    rough = 0.1 * np.random.default_rng(0).standard_normal(A.shape) * A
    changes = np.array([rough, rough + 0.05 * A])
    explanation = SharpImages(HIDDEN).explain(A, Q, y)
    volumes = np.array([np.vdot(explanation.volume, change) for change in changes])
    slopes = volumes + explanation.pull(explanation.motion(changes @ explanation.lights))
    beyond = np.linalg.svd(Q)[0][:, LIGHTS:].T

    def at_the_image(along: Array) -> float:
        A_free = beyond @ (A + np.tensordot(along, changes, 1))
        squares = np.sum((beyond @ y - A_free @ explanation.lights) ** 2, axis=0)
        misfit = (PIXELS - LIGHTS) * np.log(squares).sum()
        return float(misfit / 2 + explanation.lights.size * np.log(np.linalg.norm(A_free)))

    derivative_test(at_the_image, slopes, [0.0, 0.0])

    def at_its_best(along: Array) -> float:
        return SharpImages(HIDDEN).explain(A + along[0] * rough, Q, y).cost / 2

    derivative_test(at_its_best, slopes[:1], [0.0], rtol=0.1)


def test_the_image_is_the_pictures_and_never_negative(wall: tuple[Array, Array, Array]) -> None:
    A, Q, y = wall
    explanation = SharpImages(HIDDEN).explain(A, Q, y)
    assert explanation.lights.min() >= 0
    np.testing.assert_allclose(explanation.noise, 0.01, rtol=0.3)
    assert np.linalg.norm(explanation.residual) < 0.1 * np.linalg.norm(y - Q @ (Q.T @ y))


def test_units_of_light_and_matrix_shift_the_evidence_alone(
    wall: tuple[Array, Array, Array],
) -> None:
    """A brighter matrix is no better; photographs in another unit keep what differs."""
    A, Q, y = wall
    images, moved = SharpImages(HIDDEN), A + 0.1 * A[::-1]
    one, other = images.explain(A, Q, y), images.explain(moved, Q, y)
    brighter, scaled = images.explain(100 * A, Q, y), images.explain(A, Q, 1e4 * y)
    scaled_other = images.explain(moved, Q, 1e4 * y)
    assert brighter.cost == pytest.approx(one.cost, abs=0.5)
    difference = other.cost - one.cost
    assert scaled_other.cost - scaled.cost == pytest.approx(difference, abs=0.5)


def test_what_the_image_can_follow_is_no_information(wall: tuple[Array, Array, Array]) -> None:
    """Light of a lit patch is followed; light that no patch throws is not."""
    A, Q, y = wall
    explanation = SharpImages(HIDDEN).explain(A, Q, y)
    lit = int(np.argmax(explanation.lights[:, 0]))
    strange = np.random.default_rng(1).standard_normal(PIXELS)
    lights = np.array([A[:, lit], strange])[:, :, None] * np.ones(6)
    motion = explanation.motion(lights)
    beyond = explanation.beyond_image(motion)
    kept = [np.vdot(b, m) / np.vdot(m, m) for b, m in zip(beyond, motion, strict=True)]
    assert kept[0] < 0.5 < kept[1] <= 1
    assert kept[0] >= 0


def test_a_channel_without_light_is_explained(wall: tuple[Array, Array, Array]) -> None:
    A, Q, y = wall
    y = y[:, :3].copy()
    y[:, 1] = 0
    assert np.isfinite(SharpImages(HIDDEN).explain(A, Q, y).cost)


def test_ambient_light_alone_has_a_black_image(wall: tuple[Array, Array, Array]) -> None:
    """Nothing of it is lit, so that no image can follow a motion, and it has no edges."""
    A, Q, _ = wall
    explanation = SharpImages(HIDDEN).explain(A, Q, Q @ np.ones((Q.shape[1], 3)))
    (image,) = explanation.images
    motion = np.ones((1, len(A), 3))
    np.testing.assert_allclose(explanation.beyond_image(motion), motion, rtol=1e-6)
    np.testing.assert_allclose(smoothness(HIDDEN, np.zeros_like(image)), smoothness(HIDDEN))


def test_a_scene_that_explains_nothing_is_no_better(wall: tuple[Array, Array, Array]) -> None:
    """Its image is black, in many patches beside few pixels."""
    A, Q, y = wall
    y = y + 0.05 * np.random.default_rng(6).standard_normal(y.shape)
    fine = np.repeat(A / 2, 2, axis=1)[:, np.argsort(np.arange(2 * PATCHES) % 2, kind="stable")]
    span = np.linalg.qr(y - Q @ (Q.T @ y))[0]
    right, wrong = (
        SharpImages(Hidden.of((12, 5))).explain(each, Q, y)
        for each in (fine, fine - span @ (span.T @ fine))
    )
    assert wrong.lights.max() < 1e-9 < right.lights.max()
    assert right.cost < wrong.cost
