"""Standard errors against dense algebra, against draws from the model, and against true errors."""

import numpy as np
import pytest
from scipy import linalg, sparse

from periscopy_sim.hidden import Hidden
from periscopy_sim.model import uncertainty
from periscopy_sim.model.uncertainty import standard_errors as standard_errors_of_vectors
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.noise_aware import NoiseAware
from tests.scenes.surfaces import alone, screen_and_column

RNG = np.random.default_rng(0)
HIDDEN = (6, 7)
N = 42
A = RNG.random((400, N))
GRAM = A.T @ A
FACTOR = np.linalg.cholesky(GRAM).T
NOISE = np.array([0.1, 0.2, 0.4])
TRUTH = np.zeros((*HIDDEN, 3))
TRUTH[1:4, 2:6] = (0.9, 0.5, 0.2)


def standard_errors(factor, mixing, coordinates, image, *settings):
    """Standard errors of an image, (R, C, 3), likewise."""
    hidden, f = Hidden.of(image.shape[:2]), image.reshape(-1, 3)
    errors = standard_errors_of_vectors(factor, hidden, mixing, coordinates, f, *settings)
    return errors.reshape(image.shape)


def dense_contrast(priors, coordinates, misfit):
    """τ and R by their definitions, from (P, N, N) covariances of independent channels' light."""
    both, expected, pulls = [], 0.0, 0.0
    for prior, y in zip(priors, coordinates, strict=True):
        signals, V = np.linalg.eigh(prior)
        both.append(((V.T @ y) ** 2, np.maximum(signals, 0)))
        X = np.linalg.inv(np.eye(N) + prior)
        expected, pulls = expected + np.sum(X * X.T), pulls + np.trace(X) - np.sum(X * X.T)
    τ = uncertainty.contrast(*(np.array(each) for each in zip(*both, strict=True)))
    return τ, max(1.0, np.sum(misfit**2) / (expected + τ * pulls))


def curvature_by_loops(image, weight):
    """P entry by entry: the precision of each patch's two differences."""
    rows, columns, _ = image.shape
    P = np.zeros((rows * columns, rows * columns))
    for i in range(rows):
        for j in range(columns):
            steps = [(i + 1, j)] * (i + 1 < rows) + [(i, j + 1)] * (j + 1 < columns)
            squared = sum(((image[step] - image[i, j]) ** 2).sum() for step in steps)
            precision = weight / 2 / np.sqrt(squared + (2 * uncertainty.SMOOTHING / weight) ** 2)
            for step in steps:
                d = np.zeros((rows, columns))
                d[step], d[i, j] = 1, -1
                P += precision * np.outer(d, d)
    return P


@pytest.mark.parametrize("shape", [(6, 7), (1, 5), (5, 1)])
def test_curvature_is_that_of_both_differences(shape):
    image = np.random.default_rng(1).random((*shape, 3))
    differences = Hidden.of(shape).differences
    found = uncertainty.curvature_of_total_variation(
        differences, image.reshape(-1, 3), 20.0
    ).toarray()
    np.testing.assert_allclose(found, curvature_by_loops(image, 20.0), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("shape", [(6, 7), (7, 3), (1, 5), (5, 1), (1, 1)])
def test_block_elimination_inverts_what_joins_neighbours(shape):
    hidden, rng = Hidden.of(shape), np.random.default_rng(4)
    f, vectors = rng.random((hidden.patches, 3)), rng.standard_normal((hidden.patches, 2))
    P = uncertainty.curvature_of_total_variation(hidden.differences, f, 20.0)
    P = (P + sparse.eye_array(hidden.patches)).tocsr()
    inverse, dense = uncertainty.GridInverse(P, shape), np.linalg.inv(P.toarray())
    np.testing.assert_allclose(inverse(vectors), dense @ vectors, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(inverse.diagonal, np.diag(dense), rtol=1e-9)


def test_surfaces_that_light_other_pixels_curve_and_move_as_each_alone():
    hidden = screen_and_column()
    random = np.random.default_rng(5)
    f, response = random.random((hidden.patches, 3)), random.normal(size=(2, 3, hidden.patches))
    factors = [FACTOR[:n, :n] for n in (each.patches for each in alone(hidden))]
    P = uncertainty.curvature_of_total_variation(hidden.differences, f, 20.0).toarray()
    places = uncertainty.displacement(linalg.block_diag(*factors), hidden, f, response)
    for k, (one, part) in enumerate(zip(alone(hidden), hidden.slices.values(), strict=True)):
        own = uncertainty.curvature_of_total_variation(one.differences, f[part], 20.0).toarray()
        np.testing.assert_allclose(P[part, part], own, atol=1e-12)
        P[part, part] = 0
        expected = uncertainty.displacement(factors[k], one, f[part], response[..., part])
        np.testing.assert_allclose(places[k : k + 1], expected, rtol=1e-9)
    assert not P.any()  # nothing joins the surfaces


ERRORS = np.random.default_rng(6).standard_normal((3, N))
CONSTANT_MODE = np.eye(N) / (N * (uncertainty.CONSTANT * TRUTH.max()) ** 2)
LIGHT = (FACTOR @ TRUTH.reshape(-1, 3)).T


@pytest.mark.parametrize("size", [0.1, 1.0, 20.0])
def test_errors_are_the_roots_of_the_covariance(size):
    weight, coordinates = 30.0, LIGHT / NOISE[:, None] + size * ERRORS
    P = curvature_by_loops(TRUTH, weight)
    prior = FACTOR @ np.linalg.inv(P + CONSTANT_MODE) @ FACTOR.T
    τ, ratio = dense_contrast([prior / σ**2 for σ in NOISE], coordinates, size * ERRORS)
    found = standard_errors(FACTOR, np.diag(1 / NOISE), coordinates, TRUTH, weight)
    for channel, σ in enumerate(NOISE):
        inverse = np.linalg.inv(GRAM / σ**2 + P)
        covariance = ratio * inverse @ (GRAM / σ**2 + τ * P) @ inverse
        np.testing.assert_allclose(
            found[..., channel].ravel(), np.sqrt(np.diag(covariance)), rtol=1e-4
        )


def test_a_colour_matrix_couples_the_channels():
    M = np.array([[0.7, 0.25, 0.05], [0.2, 1.0, 0.3], [0.0, 0.3, 1.2]]) / NOISE[:, None]
    weight, coordinates = 30.0, M @ TRUTH.reshape(-1, 3).T @ FACTOR.T + 20 * ERRORS
    Π, P = M.T @ M, curvature_by_loops(TRUTH, weight)
    data, pull = np.kron(GRAM, Π), np.kron(P, np.eye(3))
    inverse = np.linalg.inv(data + pull)
    left, sizes, _ = np.linalg.svd(M)
    prior = FACTOR @ np.linalg.inv(P + CONSTANT_MODE) @ FACTOR.T
    τ, ratio = dense_contrast([s**2 * prior for s in sizes], left.T @ coordinates, 20 * ERRORS)
    response = np.random.default_rng(3).standard_normal((2, 3, N))
    moved = np.einsum("dc,jcn->jnd", Π, response @ FACTOR).reshape(2, -1) @ inverse
    covariance = ratio * inverse @ (data + τ * pull) @ inverse + moved.T @ moved
    found = standard_errors(FACTOR, M, coordinates, TRUTH, weight, response)
    np.testing.assert_allclose(found.ravel(), np.sqrt(np.diag(covariance)), rtol=1e-4)


def test_what_the_wall_does_not_show_does_not_change_the_contrast():
    """A patch more that no pixel shows leaves the errors of the others as they were."""
    factor, mixing = np.hstack([FACTOR, np.zeros((N, 1))]), np.diag(1 / NOISE)
    line = np.concatenate([TRUTH.reshape(1, N, 3), np.zeros((1, 1, 3))], axis=1)
    one = standard_errors(FACTOR, mixing, 20 * ERRORS, line[:, :N], 30.0)
    other = standard_errors(factor, mixing, 20 * ERRORS, line, 30.0)
    np.testing.assert_allclose(other[:, :N], one, rtol=1e-5)
    assert (other[:, N] > other[:, N - 1]).all()


@pytest.mark.parametrize("τ", [0.1, 1.0, 5.0, 400.0])
def test_contrast_is_that_of_the_energies(τ):
    signals = np.geomspace(1e-3, 1e3, 30000).reshape(3, -1)
    assert uncertainty.contrast(1 + τ * signals, signals) == pytest.approx(τ, rel=0.3)


def test_contrast_is_that_of_the_prior_unless_the_photograph_shows_another():
    assert uncertainty.contrast(np.ones((3, 4)), np.full((3, 4), 1e-6)) == pytest.approx(1, rel=0.1)
    assert uncertainty.contrast(np.ones((3, 4)), np.zeros((3, 4))) == pytest.approx(1, rel=0.1)
    few, many = (
        uncertainty.contrast(np.ones((3, count)), np.ones((3, count))) for count in (4, 400)
    )
    assert many < 0.01 < few < 0.5


BLURRED = A * np.geomspace(1, 0.02, N)[np.random.default_rng(1).permutation(N)]
DOTS = np.zeros((*HIDDEN, 3))
DOTS[(1, 3, 4), (2, 5, 1)] = [(0.9, 0.2, 0.2), (0.5, 0.9, 0.4), (0.8, 0.8, 0.9)]
SPECKLE = np.random.default_rng(3).random((*HIDDEN, 3))


@pytest.mark.parametrize("noise", [0.01, 0.2])
@pytest.mark.parametrize(
    ("truth", "least"),
    [(TRUTH, 0.4), (DOTS, 0.0), (SPECKLE, 0.4)],
    ids=["block", "dots", "speckle"],
)
def test_errors_are_of_the_size_and_at_the_places_reported(truth, least, noise):
    method = NoiseAware(BLURRED, hidden=HIDDEN)
    errors, stated = [], []
    for seed in range(20):
        y = BLURRED @ truth.reshape(-1, 3)
        found = method.solve(y + noise * np.random.default_rng(seed).normal(size=y.shape))
        errors.append(found.image - truth)
        stated.append(method.standard_errors(found))
    ratio = np.sqrt(np.mean((np.array(errors) / stated) ** 2))
    assert 0.35 < ratio < 1.3
    actual, expected = (np.sqrt(np.mean(np.square(e), axis=0)).ravel() for e in (errors, stated))
    assert np.corrcoef(actual, expected)[0, 1] > least


CHANGES = 0.3 * RNG.standard_normal((2, 400, N)).astype(np.float32)


def uncertain_by(names, changes):
    """Errors of 1 that change A so."""

    def slopes(image):
        return changes @ image.reshape(-1, 3)

    return uncertainty.UncertainTransport(names, np.eye(len(names)), slopes)


UNCERTAIN = uncertain_by(("x", "turn"), CHANGES)


@pytest.mark.parametrize("masked", [False, True])
def test_uncertain_scenes_widen_standard_errors_and_leave_the_image_alone(masked):
    mask = np.arange(400).reshape(20, 20) % 5 > 0 if masked else None
    y = A @ TRUTH.reshape(-1, 3) + 0.05 * np.random.default_rng(0).normal(size=(400, 3))
    y = Photograph.of(y.reshape(20, 20, 3), mask=mask)
    plain = NoiseAware(A, hidden=HIDDEN)
    uncertain = NoiseAware(A, hidden=HIDDEN, uncertain=UNCERTAIN)
    one, other = plain.solve(y), uncertain.solve(y)
    np.testing.assert_array_equal(one.image, other.image)
    narrow, wide = (m.report(y, s) for m, s in ((plain, one), (uncertain, other)))
    assert (wide.standard_errors > narrow.standard_errors).all()
    assert narrow.numbers["standard_errors_count"] == []
    assert wide.numbers["standard_errors_count"] == ["x", "turn"]


def test_errors_of_a_scene_that_errs_are_of_the_size_reported():
    """Monte Carlo: each photograph is of another scene, drawn from the prior."""
    shifted = A[:, np.arange(N).reshape(HIDDEN)[:, [0, *range(6)]].ravel()]
    change = 0.3 * (shifted - A)[None].astype(np.float32)  # a third of a patch
    uncertain = uncertain_by(("dx",), change)
    methods = [
        NoiseAware(A, hidden=HIDDEN, max_iterations=5000, uncertain=each)
        for each in (uncertain, None)
    ]
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        light = (A + rng.standard_normal() * change[0]) @ TRUTH.reshape(-1, 3)
        solution = methods[0].solve(light + 0.02 * rng.normal(size=(400, 3)))
        errors = (solution.image - TRUTH)[TRUTH > 0]  # black patches are cut off at zero
        ratios.append([errors / m.standard_errors(solution)[TRUTH > 0] for m in methods])
    wide, narrow = np.sqrt(np.mean(np.square(ratios), axis=(0, 2)))
    assert 0.5 < wide < 1.2 and narrow > 2 * wide


RANDOM = np.random.default_rng(0)
DERIVATIVES = RANDOM.standard_normal((2, 8, 5))
TRANSPORT = uncertainty.UncertainTransport(
    ("x", "turn"), RANDOM.standard_normal((2, 3)), lambda image: DERIVATIVES @ image.reshape(-1, 3)
)
MASK = np.array([[True, False, True, True], [False, True, True, True]])


@pytest.mark.parametrize("mask", [None, MASK, MASK.ravel()])
def test_light_is_that_of_every_direction_in_the_pixels_used(mask):
    image = RANDOM.random((1, 5, 3))
    expected = np.einsum("pk,pmn,nc->kcm", TRANSPORT.directions, DERIVATIVES, image[0])
    expected = expected if mask is None else expected[..., MASK.ravel()]
    np.testing.assert_allclose(TRANSPORT.lights(image, mask), expected, atol=1e-12)
