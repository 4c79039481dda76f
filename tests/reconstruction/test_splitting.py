"""What is split off, against minimization by brute force."""

import numpy as np
import pytest
from scipy import linalg

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.fit import Evidence
from periscopy_sim.model.spectral_basis import SpectralBasis
from periscopy_sim.reconstruction.penalized_likelihood import (
    RELAXATION,
    Objective,
    Penalties,
    Schedule,
    Splitting,
    advance,
    right_hand_side,
)
from periscopy_sim.testing import prox_oracle
from tests.scenes.surfaces import alone, screen_and_column

RNG = np.random.default_rng(0)
TARGETS = RNG.normal(0.1, 0.7, (3, 120))
FOLLOWING = Hidden.of((12, 10)).differences.following.astype(np.uintp)
PREVIOUS = np.maximum(RNG.normal(0.2, 0.4, TARGETS.shape), 0)


def drawn(targets, previous, positive, pull):
    """The new v for targets of the over-relaxed image."""
    split = Splitting.zeros(targets.shape)
    f, previous = (array.astype(np.float32) for array in (targets / RELAXATION, previous))
    advance(f, split, FOLLOWING, Penalties(0.1, positive, pull), previous)
    np.testing.assert_allclose(split.v + split.q, targets, atol=1e-6)
    return split.v


@pytest.mark.parametrize("pull", [1e-3, 0.1, 0.5, 2.0])
@pytest.mark.parametrize("positive", [True, False])
def test_image_is_drawn_towards_the_frame_before_as_far_as_is_best(positive, pull):
    """The minimum of ½‖v − t‖² + κ‖v − p‖, patch by patch."""
    v = drawn(TARGETS, PREVIOUS, positive, pull).astype(np.float64)
    assert (v >= 0).all() or not positive
    for n in range(0, TARGETS.shape[1], 5):
        previous, best = PREVIOUS[:, n], v[:, n]

        def value(f, t, previous=previous):
            return 1e-3 + np.sum((f - t) ** 2) / 2 + pull * np.linalg.norm(f - previous)

        lower = 0 if positive else -np.inf
        prox_oracle(lambda _, best=best: best, value, TARGETS[:, n], lower=lower, rtol=1e-4)


def test_an_image_that_becomes_black_ends_the_iterations():
    f = np.full((3, 4), -1e-6, np.float32)
    following = Hidden.of((2, 2)).differences.following.astype(np.uintp)
    residuals = advance(f, Splitting.zeros(f.shape), following, Penalties(1.0, True), None)
    assert residuals.largest() > 0.5 and residuals.largest(black=1.0) < 1e-5


def test_iteration_on_surfaces_is_that_of_the_formulas():
    """With dense differences: u, p, v and q of the module's docstring, and the sums of squares."""
    hidden, κ, α = screen_and_column(), 0.4, RELAXATION
    following = hidden.differences.following.astype(np.uintp)
    D = hidden.differences.matrix.toarray()
    fields = RNG.normal(size=(6, 3, hidden.patches)).astype(np.float32)
    u, p, (v, q) = fields[:2], fields[2:4], fields[4:]
    f = RNG.normal(size=v.shape).astype(np.float32)
    split = Splitting(*(each.copy() for each in (u, p, v, q)))

    def transposed(field):  # (2, 3, N) to (3, 2 N)
        return np.moveaxis(field.astype(np.float64), 1, 0).reshape(3, -1)

    expected = transposed(u - p) @ D + v - q
    np.testing.assert_allclose(right_hand_side(split, following), expected, atol=1e-5)
    residuals = advance(f, split, following, Penalties(κ, True), None)
    steps = np.moveaxis((f @ D.T).reshape(3, 2, -1), 1, 0)
    moved = α * steps + (1 - α) * u + p
    length = np.sqrt(np.sum(moved**2, axis=(0, 1)))
    shrunk = np.maximum(1 - κ / length, 0) * moved
    target = α * f + (1 - α) * v + q
    kept = np.maximum(target, 0)
    for found, right in zip(split, (shrunk, moved - shrunk, kept, target - kept), strict=True):
        np.testing.assert_allclose(found, right, atol=1e-5)
    sums = (
        np.sum((steps - u) ** 2) + np.sum((f - v) ** 2),
        np.sum((shrunk - u) ** 2) + np.sum((kept - v) ** 2),
        np.sum(steps**2) + np.sum(f**2),
        np.sum(shrunk**2) + np.sum(kept**2),
    )
    np.testing.assert_allclose(residuals, sums, rtol=1e-4)


def test_surfaces_that_light_other_pixels_have_the_images_of_each_alone():
    """The minimizer of both, from one spectral basis, is made of the minimizers of either."""
    hidden, noise = screen_and_column(), np.full(3, 0.1)
    grams, rights = [], []
    for one in alone(hidden):
        A = RNG.normal(size=(40, one.patches)) / 6
        grams.append(A.T @ A)
        rights.append(A.T @ (A @ RNG.random((one.patches, 3)) + RNG.normal(0, 0.5, (40, 3))))
    schedule = Schedule(1e-6, 20_000)

    def minimized(gram, right, surfaces, λ=0.05):
        basis = SpectralBasis.of_gram(gram, surfaces)
        evidence = Evidence(right.T @ basis.rows.T, noise, 1.0, 0.0)
        regularization = 2 * λ / np.sqrt(surfaces.patches) / noise.mean()
        objective = Objective(basis, surfaces, np.eye(3), regularization, positive=True)
        return objective.minimize(evidence, schedule).image

    both = minimized(linalg.block_diag(*grams), np.concatenate(rights), hidden)
    parts = zip(alone(hidden), hidden.slices.values(), grams, rights, strict=True)
    for one, part, gram, right in parts:
        np.testing.assert_allclose(both[:, part], minimized(gram, right, one), atol=1e-4)
    assert (both == 0).any() and (both > 0.1).any()
