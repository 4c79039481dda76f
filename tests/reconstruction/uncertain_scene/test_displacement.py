"""The estimate of where a scene is, against dense least squares and against its own errors."""

import numpy as np
from periscopy_sim.reconstruction.uncertain_scene.displacement import estimate

from periscopy_sim.model.wall_gain import SPREAD

PIXELS, PATCHES, DIRECTIONS, GAINS = 200, 12, 4, 2
RNG = np.random.default_rng(0)
AB = RNG.standard_normal((PIXELS, PATCHES + 3))
F = np.linalg.qr(AB)[0]
# Images follow nearly all of what the directions do.
T = np.einsum("mn,kcn->kcm", AB, RNG.standard_normal((DIRECTIONS, 3, PATCHES + 3)))
T += 0.3 * RNG.standard_normal(T.shape) * np.array([0.02, 0.3, 1, 3])[:, None, None]
G = RNG.standard_normal((GAINS, 3, PIXELS))


def unexplained(rows):
    return rows - (rows @ F) @ F.T


def test_without_noise_in_the_changes_it_is_the_most_probable_of_all_unknowns_together():
    y = RNG.standard_normal((3, PIXELS)) + np.tensordot([0.5, 1.0, -1.0, 0.2], T, 1)
    κ, here = 3.0, np.array([0.3, -0.2, 0.1, 0.0])
    found = estimate(unexplained(y), T[None], G, unexplained, κ, here, exact=True)

    # Each channel has an image and ambient light of its own, of which nothing is known before.
    own = np.kron(np.eye(3), AB)
    shared = np.concatenate([T, G]).reshape(DIRECTIONS + GAINS, -1).T
    design = np.hstack([own, shared])
    precision = np.zeros(design.shape[1])
    precision[own.shape[1] :] = [1] * DIRECTIONS + [SPREAD**-2] * GAINS
    normal = design.T @ design / κ + np.diag(precision)
    about = y.ravel() + shared[:, :DIRECTIONS] @ here
    solved = np.linalg.solve(normal, design.T @ about / κ)
    us = slice(own.shape[1], own.shape[1] + DIRECTIONS)
    np.testing.assert_allclose(found.moved, solved[us], atol=1e-10)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal)[us, us], atol=1e-10)
    assert found.overdispersion == κ


def test_errors_are_those_of_the_estimate_though_the_changes_are_noisy():
    """Noise in the changes is as large as all that images leave of two of the directions."""
    random, draws = np.random.default_rng(1), 400
    noise = 0.3 * np.array([0.3, 0.3, 0.1, 1.0])[:, None, None]
    z = np.empty((draws, DIRECTIONS))
    for row in z:
        u, a = random.standard_normal(DIRECTIONS), SPREAD * random.standard_normal(GAINS)
        y = np.tensordot(u, T, 1) + np.tensordot(a, G, 1) + random.standard_normal((3, PIXELS))
        seen = T + noise * random.standard_normal((2, *T.shape))
        found = estimate(
            unexplained(y), seen, G, unexplained, 1.0, np.zeros(DIRECTIONS), exact=True
        )
        row[:] = (found.moved - u) / np.sqrt(np.diag(found.covariance))
    # Squares of 400 normal numbers have a mean of 1 ± 0.07; noise in the changes adds to one.
    np.testing.assert_allclose(np.mean(z**2, axis=0), 1, atol=0.25)
    assert np.abs(np.mean(z, axis=0)).max() < 0.2


def test_one_set_of_rays_takes_their_noise_for_information():
    """Why there are two: with one, noise that is all there is passes for knowing the scene."""
    noise = np.random.default_rng(2).standard_normal((2, 1, 3, PIXELS))
    left = unexplained(np.random.default_rng(3).standard_normal((3, PIXELS)))
    nothing = np.zeros((0, 3, PIXELS))
    one, two = (
        estimate(left, sets, nothing, unexplained, 1.0, np.zeros(1), exact=True).covariance[0, 0]
        for sets in (noise[:1], noise)
    )
    assert one < 0.01
    assert two > 0.8


def test_a_photograph_that_counts_for_nothing_leaves_the_ruler_its_word():
    y = np.tensordot([3.0, 1.0, -1.0, 0.2], T, 1)
    found = estimate(
        unexplained(y), T[None], G, unexplained, 1e12, np.zeros(DIRECTIONS), exact=True
    )
    np.testing.assert_allclose(found.moved, 0, atol=1e-6)
    np.testing.assert_allclose(found.covariance, np.eye(DIRECTIONS), atol=1e-6)
