"""Ambient light beyond range(B) against dense algebra, and what it is worth where it is strong."""

import numpy as np
import pytest
from numpy.polynomial import legendre
from periscopy_sim.reconstruction.noise_aware.nuisance import ambient_prior
from periscopy_sim.reconstruction.noise_aware.nuisance.ambient_prior import (
    STRENGTHS,
    TURNS,
    AmbientEstimate,
    AmbientPrior,
    found_beside,
)

from periscopy_sim.evaluation.metrics import mean_squared_error
from periscopy_sim.model.spectral_basis import SpectralBasis, laplacian
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware

WALL, HIDDEN = (36, 40), (6, 7)
PIXELS, N = 1440, 42
V, U = np.meshgrid(*(np.linspace(-1, 1, size) for size in WALL), indexing="ij")


def transport():
    """Columns of A: light that falls off, with the soft shadow of a block."""
    columns = []
    for i in range(HIDDEN[0]):
        for j in range(HIDDEN[1]):
            u, v = U - 0.15 * (j - 3), V - 0.15 * (i - 2.5)
            shadow = np.prod([1 / (1 + np.exp(-12 * t)) for t in (u + 0.3, 0.3 - u, v + 0.4)], 0)
            columns.append((1 - shadow) / (1 + 0.3 * (U - 0.1 * j) ** 2 + 0.3 * (V - 0.1 * i) ** 2))
    return np.array(columns).reshape(N, -1).T


A = transport().astype(np.float32).astype(np.float64)
B = np.stack([np.ones(PIXELS), *(p.ravel() for p in (U, V, U * V, U**2, V**2))], axis=1)
LIGHT = np.array([1.0, 0.8, 0.6])
Q = np.linalg.qr(B)[0]


def image(seed=0):
    f = np.full((*HIDDEN, 3), 0.15)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        i, j = rng.integers(0, 4), rng.integers(0, 4)
        f[i : i + 3, j : j + 3] = rng.uniform(0.1, 1, 3)
    return f


def edge(along, at=0.15):
    """What a straight edge cuts off of light, of rms 1."""
    profile = np.clip((along - at) / 0.5, 0, 1).ravel()
    left = profile - Q @ (Q.T @ profile)
    return left / np.sqrt(np.mean(left**2))


def photograph(seed=0, brightness=20.0, beyond=0.0, noise=1e-3):
    """Of ambient light over the monitor's, and what of it lies beyond range(B)."""
    signal = A @ image(seed).reshape(-1, 3)
    signal /= signal.mean()
    light = (1 + 0.1 * U.ravel() + beyond)[:, None] * (brightness * LIGHT / LIGHT.mean())
    whole = signal + light
    draw = np.random.default_rng(100 + seed).standard_normal(whole.shape)
    return (whole + noise * whole.mean() * draw).reshape(*WALL, 3)


def fitted(mask=None):
    used = slice(None) if mask is None else mask.ravel()
    Q = np.linalg.qr(B[used])[0]
    left = A[used] - Q @ (Q.T @ A[used])
    patterns = SpectralBasis(left.T @ left, HIDDEN)
    seen = patterns.curvatures > 1e-9 * patterns.curvatures[-1]
    rows, curvatures = patterns.rows[seen], patterns.curvatures[seen]
    transport = np.ascontiguousarray(A[used].T, np.float32)
    prior = AmbientPrior(transport, np.ascontiguousarray(Q.T), rows, curvatures, WALL, mask)
    return prior, Q, left, rows, curvatures


def polynomials(used):
    """The polynomials of the three groups and of those compared, by their definition."""
    down, across = (legendre.legvander(np.linspace(-1, 1, n), 14) for n in WALL)
    groups = [[], [], [], []]
    for i in range(15):
        for j in range(15):
            field = np.outer(down[:, i], across[:, j]).ravel()[used]
            if j < 2 and i <= 12:
                groups[0].append(field)
            if i < 2 and j <= 12:
                groups[1].append(field)
            if i > 1 and j > 1 and i + j <= 14:
                groups[2 if i + j <= 12 else 3].append(field)
    return [np.array(group).T for group in groups]


@pytest.mark.thorough
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("beyond", [0.0, 2e-3])
def test_strengths_are_the_likeliest_by_dense_algebra(masked, beyond, monkeypatch):
    monkeypatch.setattr(ambient_prior, "DECISIVE", -np.inf)
    mask = np.ones(WALL, bool)
    mask[3:9, 20:31] = not masked
    prior, Q, left, rows, curvatures = fitted(mask if masked else None)
    y = photograph(1, beyond=beyond * edge(V)).reshape(-1, 3)[mask.ravel()]
    level = np.sqrt(np.mean((y - Q @ (Q.T @ y)) ** 2))
    y, noise = y / level, np.array([1.1e-3, 0.9e-3, 1e-3]) * y.mean() / level
    rejected = y - Q @ (Q.T @ y)
    scales = rows / np.sqrt(curvatures)[:, None]
    z = rejected.T @ left @ scales.T
    found = prior.estimate(np.ascontiguousarray(rejected.T), z, noise, y.mean(axis=0))

    kinds = []
    for group in polynomials(mask.ravel()):
        basis = group - Q @ (Q.T @ group)
        for other in kinds:
            basis -= other @ (other.T @ basis)
        U, sizes, _ = np.linalg.svd(basis / np.linalg.norm(group, axis=0), full_matrices=False)
        kinds.append(U[:, sizes > 1e-5])
    D, sizes = np.hstack(kinds[:3]), [kind.shape[1] for kind in kinds[:3]]
    K = np.linalg.inv(laplacian(HIDDEN))
    shown, axes = np.linalg.eigh(left @ K @ left.T)
    ratios, parts = [], []
    for c, σ in enumerate(noise):
        energies = np.geomspace(1e-6, 1e6, 61) * float(z[c] @ z[c]) / curvatures.sum()
        variances = σ**2 + np.outer(energies, shown)
        along = (axes.T @ rejected[:, c]) ** 2
        best = int(np.argmin(np.sum(along / variances + np.log(variances), axis=1)))
        weak = σ**2 + ambient_prior.CONTRAST * energies[best] * shown
        inverse = (axes / weak) @ axes.T * σ**2
        f = ambient_prior.CONTRAST * energies[best] * K @ left.T @ inverse @ rejected[:, c] / σ**2
        H, q = D.T @ inverse @ D, D.T @ inverse @ rejected[:, c]
        G, p = kinds[3].T @ inverse @ kinds[3], kinds[3].T @ inverse @ rejected[:, c]
        ratios.append(p @ np.linalg.solve(G, p) / σ**2 / len(p))
        parts.append((H, q, max(y[:, c].mean() - (A[mask.ravel()] @ f).mean(), 0)))
    φ = max(1, np.mean(ratios))
    assert found.overdispersion == pytest.approx(φ, rel=1e-3)

    def evidence(strengths):
        whole = 0
        for (H, q, ambient), σ in zip(parts, noise, strict=True):
            v = np.repeat((strengths * ambient) ** 2 * len(y) / np.array(sizes), sizes) / φ
            inner = np.diag(σ**2 / v) + H
            whole += q @ np.linalg.solve(inner, q) / φ / σ**2
            whole -= np.linalg.slogdet(inner)[1] + np.sum(np.log(v / σ**2))
        return whole

    strengths = np.full(3, STRENGTHS[-1])
    for group in range(3):
        tried = [np.where(np.arange(3) == group, κ, strengths) for κ in STRENGTHS]
        strengths = max(tried, key=evidence)
    np.testing.assert_allclose(found.strengths, strengths)
    for c, (*_, ambient) in enumerate(parts):
        v = np.repeat((strengths * ambient) ** 2 * len(y) / np.array(sizes), sizes)
        np.testing.assert_allclose(found.variances[c], v, rtol=5e-3)


def test_image_and_light_found_by_turns_minimize_the_sum_of_their_objectives():
    """Of images with a quadratic penalty: then the minimum is that of linear equations."""
    rng = np.random.default_rng(0)
    D, a = np.linalg.qr(rng.standard_normal((60, 6)))[0], rng.standard_normal((60, 20))
    y, noise, v = rng.standard_normal((3, 60)), np.array([0.5, 1, 2]), rng.uniform(0.2, 9, (3, 6))
    black = AmbientEstimate(np.zeros((3, 6)), D.T.astype(np.float32), np.full(3, 1e-3), v, 1.5)
    S = a.T @ a + 2 * np.eye(20)

    def left_beside(light):
        return y - np.linalg.solve(S, a.T @ (y - light).T).T @ a.T, noise

    found = found_beside(black, left_beside)
    for c, σ in enumerate(noise):
        whole = np.block([[S, a.T @ D], [D.T @ a, np.diag(1 + 1.5 * σ**2 / v[c])]])
        e = np.linalg.solve(whole, np.concatenate([a.T @ y[c], D.T @ y[c]]))[20:]
        np.testing.assert_allclose(found.coefficients[c], e, atol=3e-3 * np.abs(e).max())


def test_where_turns_do_not_settle_the_light_that_moves_least_is_taken():
    """An image that leaves other light at each turn, but nothing new beside one of them."""
    D, rng = np.eye(60)[:, :6], np.random.default_rng(2)
    black = AmbientEstimate(
        np.zeros((3, 6)), D.T.astype(np.float32), np.ones(3), np.ones((3, 6)), 1
    )

    def left_beside(light):
        e = light[:, :6]
        left = e + (0.1 if len(asked) == 8 else 1.0) * rng.standard_normal(e.shape)
        return 2 * left @ D.T, np.ones(3)  # half of it is ambient light's

    asked = []
    found = found_beside(black, lambda light: (asked.append(light[:, :6]), left_beside(light))[1])
    np.testing.assert_allclose(found.coefficients, asked[7], atol=1e-12)
    assert len(asked) > TURNS


def test_errors_of_light_are_those_beside_an_unknown_image():
    prior, _, left, *_ = fitted()
    noise, D = np.array([0.1, 0.2, 0.3]), prior_rows(prior).T
    v = np.random.default_rng(1).uniform(0.01, 1, (3, D.shape[1]))
    found = AmbientEstimate(np.zeros(v.shape), prior._rows, np.full(3, 1e-3), v, 1.5)
    moved = prior.response(np.ascontiguousarray(A.T, np.float32), found, noise)
    moved = moved.reshape(3, -1, 3, N)
    for c, σ in enumerate(noise):
        about = np.diag(1 + 1.5 * σ**2 / v[c])
        whole = np.block([[left.T @ left, left.T @ D], [D.T @ left, about]])
        covariance = 1.5 * σ**2 * np.linalg.inv(whole)[N:, N:]
        expected = left.T @ D @ covariance @ D.T @ left
        size = np.abs(expected).max()
        np.testing.assert_allclose(moved[c, :, c].T @ moved[c, :, c], expected, atol=2e-3 * size)
        assert not np.delete(moved[c], c, axis=1).any()


def prior_rows(prior):
    return np.asarray(prior._rows, np.float64)


@pytest.fixture(scope="module")
def methods():
    known = {"hidden_shape": HIDDEN, "photograph_shape": WALL}
    return [NoiseAware(A, B, **known, ambient_prior=wanted) for wanted in (False, True)]


# The block's own shadow has a level edge, too.
@pytest.mark.thorough
@pytest.mark.parametrize(("along", "part"), [(V, 0.9), (U, 0.75)], ids=["level", "upright"])
def test_light_that_an_edge_cuts_off_does_less_harm(methods, along, part):
    errors = []
    for seed in range(4):
        y = photograph(seed, beyond=1e-3 * edge(along), noise=3e-4)
        errors.append([mean_squared_error(m.reconstruct(y), image(seed)) for m in methods])
    without, freed = np.mean(errors, axis=0)
    assert freed < part * without


def test_light_that_an_image_can_show_is_left_to_it(methods, monkeypatch):
    """Wherever it is looked for: no ghosts beside images under light that lamps explain."""
    monkeypatch.setattr(ambient_prior, "DECISIVE", -np.inf)
    errors = []
    for seed in range(6):
        y = photograph(seed, brightness=2.0)
        errors.append([mean_squared_error(m.reconstruct(y), image(seed)) for m in methods])
    without, freed = np.mean(errors, axis=0)
    assert freed < 1.1 * without


def test_light_that_lamps_explain_is_left_to_them(methods):
    for seed in range(4):
        without, found = (m.solve(photograph(seed)) for m in methods)
        assert found.ambient is None
        np.testing.assert_array_equal(found.image, without.image)


def test_hardly_any_ambient_light_has_no_edges_that_matter(methods):
    # A scene that is off leaves structure everywhere, but of no ambient light.
    y = photograph(0, brightness=0.02)
    y *= 1 + 0.02 * edge(V).reshape(*WALL, 1)
    assert methods[1].solve(y).ambient is None


def test_units_do_not_matter(methods):
    y = photograph(2, beyond=1e-3 * edge(V))
    one, other = methods[1].solve(y), methods[1].solve(1e4 * y)
    np.testing.assert_allclose(other.ambient.light, 1e4 * one.ambient.light, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(other.image, 1e4 * one.image, rtol=1e-3, atol=1)


@pytest.mark.parametrize("unit", [1e-6, 1e4])
def test_errors_are_told_in_any_unit_alike(methods, unit):
    y = photograph(2, beyond=1e-3 * edge(V))
    one, other = (methods[1].standard_errors(methods[1].solve(u * y)) for u in (1, unit))
    np.testing.assert_allclose(other, unit * one, rtol=0.02)


def test_residual_is_without_the_light_found(methods):
    y = photograph(1, beyond=1e-3 * edge(V))
    left = [m.residual(y, m.solve(y)).unexplained for m in methods]
    assert left[1] < 0.9 * left[0]
    assert left[1] == pytest.approx(1e-3, rel=0.1)


def test_summary_tells_the_strengths(methods):
    y = photograph(1, beyond=1e-3 * edge(V))
    assert methods[0].told(methods[0].solve(y))["ambient_light_beyond_lamps"] == []
    told = methods[1].told(methods[1].solve(y))["ambient_light_beyond_lamps"]
    assert len(told) == 3 and told[0] == STRENGTHS[-1]


def test_no_prior_without_lamps_or_rows_and_columns():
    y = photograph(beyond=1e-3 * edge(V))
    alone = NoiseAware(A, hidden_shape=HIDDEN, photograph_shape=WALL)
    flat = NoiseAware(A, B, hidden_shape=HIDDEN)
    assert alone.solve(y).ambient is None
    assert flat.solve(y.reshape(-1, 3)).ambient is None


def test_no_prior_where_a_background_photograph_shows_the_light(methods):
    beyond = 1e-3 * edge(V)
    off = ((1 + 0.1 * U.ravel() + beyond)[:, None] * LIGHT).reshape(*WALL, 3)
    off *= 1 + 1e-4 * np.random.default_rng(1).standard_normal(off.shape)
    known = {"hidden_shape": HIDDEN, "photograph_shape": WALL}
    shown = NoiseAware(A, B, **known, backgrounds=[off])
    assert methods[1].solve(photograph(1, beyond=beyond)).ambient is not None
    assert shown.solve(photograph(1, beyond=beyond)).ambient is None


@pytest.mark.parametrize("shape", [(1, 1440), (3, 480), (1440, 1)])
def test_walls_of_few_rows_have_fewer_polynomials(shape, monkeypatch):
    monkeypatch.setattr(ambient_prior, "DECISIVE", -np.inf)
    method = NoiseAware(A, B, hidden_shape=HIDDEN, photograph_shape=shape)
    found = method.solve(photograph().reshape(*shape, 3))
    assert np.isfinite(found.image).all() and np.isfinite(found.ambient.light).all()


@pytest.mark.parametrize("noise", [1e-4, 1e-5])
def test_patterns_that_rounding_hides_stop_nothing(noise):
    """Shadows far softer than patches are small, and hardly any noise."""
    hidden, columns = (12, 14), []
    for i in range(hidden[0]):
        for j in range(hidden[1]):
            u, v = U - 0.9 * ((j + 0.5) / 14 - 0.5), V - 0.9 * ((i + 0.5) / 12 - 0.5)
            shadow = np.prod([1 / (1 + np.exp(-12 * t)) for t in (u + 0.3, 0.3 - u, v + 0.4)], 0)
            columns.append(((1 - shadow) / (1 + 0.3 * u**2 + 0.3 * v**2) ** 2).ravel())
    soft = np.array(columns).T.astype(np.float32).astype(np.float64)
    rng = np.random.default_rng(0)
    signal = soft @ rng.uniform(0.1, 1, (168, 3))
    light = 20 * (1 + 0.1 * U.ravel() + 2e-3 * edge(U))[:, None] * LIGHT
    y = signal / signal.mean() + light
    y += noise * y.mean() * rng.standard_normal(y.shape)
    method = NoiseAware(soft, B, hidden_shape=hidden, photograph_shape=WALL)
    found = method.solve(y.reshape(*WALL, 3))
    assert found.image.max() > 0 and np.isfinite(method.standard_errors(found)).all()


def test_standard_errors_count_what_is_not_known_of_the_light(methods, monkeypatch):
    """Light drawn from the prior itself; ratios are squares of errors over those told.

    Patches are few here, and the light is 20 times theirs: errors of total variation's pull, which
    noise follows, are told a little too small.
    """
    method, ratios = methods[1], []
    prior = method._ambient_prior
    roots = np.sqrt(PIXELS / np.repeat(prior._sizes, prior._sizes))
    level = 20 * LIGHT / LIGHT.mean()

    def ratio(found, seed):
        truth = image(seed) / (A @ image(seed).reshape(-1, 3)).mean()
        return np.mean(((found.image - truth) / method.standard_errors(found)) ** 2)

    for seed in range(12):
        e = np.random.default_rng(seed).standard_normal((3, len(prior._rows)))
        light = (1e-3 * level[:, None] * roots * e) @ prior._rows
        found = method.solve(photograph(seed, noise=3e-4) + light.T.reshape(*WALL, 3))
        assert found.ambient is not None
        counted = ratio(found, seed)
        with monkeypatch.context() as patch:
            patch.setattr(method, "_error_response", lambda _: None)
            ratios.append([counted, ratio(found, seed)])
    counted, alone = np.mean(ratios, axis=0)
    assert counted < 1.6
    assert alone > 1.7 * counted
