"""The evidence, its slope and its information against dense Gaussian densities."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize, stats

from periscopy_sim.calibration.evidence import FLAT, SmoothExplanation, SmoothImages, smoothness
from periscopy_sim.hidden import Hidden
from periscopy_sim.testing import derivative_test
from tests.scenes.surfaces import alone, screen_and_column

Array = NDArray[np.float64]

SHAPE = (3, 4)
HIDDEN, COARSE = Hidden.of(SHAPE), Hidden.of((2, 3))
PATCHES, PIXELS, LIGHTS = 12, 60, 4
PICTURE = np.random.default_rng(7).random((*SHAPE, 3))


@dataclass(frozen=True, eq=False)
class Wall:
    """A transport matrix, ambient light, photographs, and two changes of the matrix."""

    A: Array
    Q: Array
    y: Array
    changes: Array


@pytest.fixture
def wall() -> Wall:
    random = np.random.default_rng(3)
    A = random.random((PIXELS, PATCHES))
    Q = np.linalg.qr(random.random((PIXELS, LIGHTS)))[0]
    y = A @ (1 + random.random((PATCHES, 3))) + Q @ random.random((LIGHTS, 3))
    changes = random.standard_normal((2, PIXELS, PATCHES))
    return Wall(A, Q, y + 0.05 * random.standard_normal(y.shape), changes)


@pytest.fixture(params=["patches", "hats", "edges", "shown"])
def images(request: pytest.FixtureRequest) -> SmoothImages:
    kinds = {
        "patches": SmoothImages.hats(HIDDEN, HIDDEN),
        "hats": SmoothImages.hats(HIDDEN, COARSE),
        "edges": SmoothImages.like(HIDDEN, PICTURE.reshape(-1, 3)),
        "shown": SmoothImages.shown(PICTURE.reshape(-1, 3)),
    }
    return kinds[request.param]


def columns(A: Array, images: SmoothImages) -> Array:
    """Return X = A S."""
    return np.asarray((images.basis.T @ A.T).T)


def covariance(wall: Wall, A: Array, images: SmoothImages, ratio: float) -> tuple[Array, Array]:
    """Return a photograph's covariance over σ² beyond range(B), and a basis of that space."""
    beyond = np.linalg.svd(wall.Q)[0][:, LIGHTS:]
    X = beyond.T @ columns(A, images)
    return np.eye(len(X)) + X @ np.linalg.solve(images.precision, X.T) / ratio, beyond


def density(wall: Wall, A: Array, images: SmoothImages, c: int, ratio: float) -> float:
    """Return -2 log of the density of a channel's y beyond range(B), σ at its best."""
    S, beyond = covariance(wall, A, images, ratio)
    rest = beyond.T @ wall.y[:, c]
    variance = rest @ np.linalg.solve(S, rest) / len(rest)
    return float(-2 * stats.multivariate_normal(np.zeros(len(S)), variance * S).logpdf(rest))


def constant() -> float:
    """Return by how much the density's -2 log exceeds E_c."""
    freedom = PIXELS - LIGHTS
    return float(freedom * (1 + np.log(2 * np.pi) - np.log(freedom)))


def evidence(wall: Wall, A: Array, images: SmoothImages) -> float:
    """Return the sum over channels of the dense evidence, α by a plain search."""
    unit = np.sum(columns(A - wall.Q @ (wall.Q.T @ A), images) ** 2) / images.precision.shape[0]
    total = 0.0
    for c in range(3):

        def at(log: float, c: int = c) -> float:
            return density(wall, A, images, c, unit * np.exp(log))

        total += optimize.minimize_scalar(at, bounds=(-18, 4), method="bounded").fun - constant()
    return total


def explained(wall: Wall, images: SmoothImages, A: Array | None = None) -> SmoothExplanation:
    return images.explain(wall.A if A is None else A, wall.Q, wall.y)


def test_smoothness_sums_squares_of_differences_with_darkness_around() -> None:
    f = np.random.default_rng(0).standard_normal(SHAPE)
    dark = np.pad(f, 1)
    steps = np.sum(np.diff(dark[:, 1:-1], axis=0) ** 2) + np.sum(np.diff(dark[1:-1], axis=1) ** 2)
    expected = steps + FLAT**2 * np.sum(f**2)
    assert f.ravel() @ smoothness(HIDDEN) @ f.ravel() == pytest.approx(expected)


def test_smoothness_of_an_image_is_its_total_variation_where_it_has_edges() -> None:
    """Up to a unit, but for flat parts and for how bright it is."""
    images = 100 * np.random.default_rng(0).random((2, *SHAPE, 1)) * np.ones(3)
    ratios = []
    for image in images:
        dark = np.pad(image[..., 0], 1)
        steps = [np.diff(dark[:, 1:-1], axis=0), np.diff(dark[1:-1], axis=1)]
        weights = [1 / np.sqrt(3 * step**2 + FLAT**2 * np.mean(image**2)) for step in steps]
        mean = np.mean(np.concatenate([each.ravel() for each in weights]))
        expected = sum(float(np.sum(w * d**2)) for w, d in zip(weights, steps, strict=True))
        f = image[..., 0].ravel()
        rough = f @ smoothness(HIDDEN, image.reshape(-1, 3)) @ f - FLAT**2 * f @ f
        assert rough == pytest.approx(expected / mean)
        ratios.append(rough * mean / sum(np.abs(step).sum() for step in steps))
    assert ratios[0] == pytest.approx(ratios[1], rel=0.05)


def test_surfaces_are_as_smooth_as_each_alone() -> None:
    """No difference crosses from one to the other; hats end with their surface."""
    hidden = screen_and_column()
    f = np.random.default_rng(0).random((hidden.patches, 3))
    K, edges = smoothness(hidden), smoothness(hidden, f)
    basis = SmoothImages.hats(hidden, hidden).basis.toarray()
    np.testing.assert_array_equal(basis, np.eye(hidden.patches))
    D = hidden.differences.in_the_dark
    weights = (np.sum((D @ f) ** 2, axis=1) + FLAT**2 * np.mean(f**2)) ** -0.5
    expected = np.sum((weights / weights.mean())[:, None] * (D @ f) ** 2) + FLAT**2 * np.sum(f**2)
    assert np.einsum("nc,nm,mc->", f, edges, f) == pytest.approx(expected)
    for one, part in zip(alone(hidden), hidden.slices.values(), strict=True):
        np.testing.assert_allclose(K[part, part], smoothness(one), atol=1e-12)
        K[part, part] = 0
    assert not K.any()


def test_hats_make_any_bilinear_image() -> None:
    """Between the middles of the outermost hats."""
    down, across = (np.arange(size) for size in (4, 6))
    heights = 1 + 2 * down[:, None] + 3 * across + 0.5 * down[:, None] * across
    basis = SmoothImages.hats(Hidden.of((8, 12)), Hidden.of((4, 6))).basis
    fine = (basis @ heights.ravel()).reshape(8, 12)
    u, v = ((np.arange(size) + 0.5) / 2 - 0.5 for size in (8, 12))
    expected = 1 + 2 * u[:, None] + 3 * v + 0.5 * u[:, None] * v
    np.testing.assert_allclose(fine[1:-1, 1:-1], expected[1:-1, 1:-1])


def test_evidence_and_noise_are_those_of_the_dense_gaussian(
    wall: Wall, images: SmoothImages
) -> None:
    other = wall.A + 0.2 * wall.changes[0]
    explanation = explained(wall, images)
    for A in (wall.A, other):
        found = explained(wall, images, A)
        assert found.cost == pytest.approx(evidence(wall, A, images), abs=2e-2)
    for c, ratio in enumerate(explanation.ratios):
        S, beyond = covariance(wall, wall.A, images, ratio)
        rest = beyond.T @ wall.y[:, c]
        noise = np.sqrt(rest @ np.linalg.solve(S, rest) / len(rest))
        assert explanation.noise[c] == pytest.approx(noise, rel=1e-5)


def test_slope_is_the_derivative_of_the_dense_density(wall: Wall, images: SmoothImages) -> None:
    explanation = explained(wall, images)
    volumes = [float(np.vdot(explanation.volume, change)) for change in wall.changes]
    slopes = volumes + explanation.pull(explanation.motion(wall.changes @ explanation.lights))

    def half(along: Array) -> float:
        A = wall.A + np.tensordot(along, wall.changes, 1)
        return sum(density(wall, A, images, c, α) / 2 for c, α in enumerate(explanation.ratios))

    derivative_test(half, slopes, np.zeros(2), steps=1e-4)


def test_information_is_of_what_no_image_can_follow(wall: Wall, images: SmoothImages) -> None:
    explanation = explained(wall, images)
    motion = explanation.motion(np.array([change @ explanation.lights for change in wall.changes]))
    information = np.einsum("imc,jmc->ij", explanation.beyond_image(motion), motion)
    expected = np.zeros((2, 2))
    for c, ratio in enumerate(explanation.ratios):
        S, beyond = covariance(wall, wall.A, images, ratio)
        moves = motion[:, :, c] @ beyond
        expected += moves @ np.linalg.solve(S, moves.T)
    np.testing.assert_allclose(information, expected, rtol=1e-6)


def test_ambient_light_of_any_strength_changes_nothing(wall: Wall, images: SmoothImages) -> None:
    light = 1e3 * wall.Q @ np.random.default_rng(1).standard_normal((LIGHTS, 3))
    dark = explained(wall, images)
    lit = images.explain(wall.A, wall.Q, wall.y + light)
    assert lit.cost == pytest.approx(dark.cost, abs=1e-4)
    np.testing.assert_allclose(lit.lights, dark.lights, atol=1e-6)


@pytest.mark.parametrize("unit", [1e5])
def test_the_unit_of_the_matrix_changes_nothing(
    wall: Wall, images: SmoothImages, unit: float
) -> None:
    one, other = explained(wall, images), explained(wall, images, unit * wall.A)
    assert other.cost == pytest.approx(one.cost, abs=1e-4)
    np.testing.assert_allclose(unit * other.lights, one.lights, rtol=1e-5)


def test_a_black_channel_is_explained_by_darkness(wall: Wall, images: SmoothImages) -> None:
    wall.y[:, 1] = 0
    found = explained(wall, images)
    assert np.isfinite(found.cost)
    np.testing.assert_array_equal(found.lights[:, 1], 0)


def test_a_known_picture_in_mixed_colours_is_explained_to_the_noise(wall: Wall) -> None:
    mixture = np.array([[0.9, 0.2, 0.1], [0.1, 0.8, 0.2], [0, 0.3, 0.7]])
    light = wall.A @ PICTURE.reshape(-1, 3) @ mixture.T
    y = light + 1e-4 * np.random.default_rng(0).standard_normal(light.shape)
    found = SmoothImages.shown(PICTURE.reshape(-1, 3)).explain(wall.A, wall.Q, y)
    np.testing.assert_allclose(found.coefficients.T, mixture, atol=1e-3)
    np.testing.assert_allclose(found.noise, 1e-4, rtol=0.3)


ROW = np.array([0.7, 0.2, 0.1]), 0.01 * np.array([[2, -1, -1], [-1, 2, -1], [-1, -1, 2]])


@pytest.mark.parametrize("exposure", [1e-3, 40.0])
def test_colours_that_a_picture_does_not_show_are_the_priors_at_any_exposure(
    wall: Wall, exposure: float
) -> None:
    """Red and green are shown alike: their difference is the prior's, blue is the picture's."""
    picture = PICTURE.reshape(-1, 3)[:, [0, 0, 2]]
    row = np.array([0.5, 0.2, 0.3])
    y = exposure * (wall.A @ picture @ row)[:, None]
    y += 1e-4 * exposure * np.random.default_rng(0).standard_normal(y.shape)
    found = SmoothImages.shown(picture, ROW).explain(wall.A, wall.Q, y)
    mixture, errors = found.coefficients[:, 0], np.sqrt(np.diag(found.covariance))
    # Of the normal prior, given the sum of red and green over the row's.
    mean, covariance = ROW
    gain = (covariance[0] + covariance[1]) @ np.array([1, 0, 0]) / covariance[:2, :2].sum()
    red = mean[0] + gain * (row[:2].sum() - mean[:2].sum())
    spread = np.sqrt(covariance[0, 0] - gain**2 * covariance[:2, :2].sum())
    np.testing.assert_allclose(mixture / exposure, [red, 0.7 - red, 0.3], atol=1e-3)
    np.testing.assert_allclose(errors[:2] / exposure, spread, rtol=0.01)
    assert errors[2] < 1e-3 * exposure
