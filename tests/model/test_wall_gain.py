"""The gain over the wall against joint least squares with everything that may explain the light."""

import numpy as np
import pytest
from scipy import stats

import periscopy_sim as ps
from periscopy_sim.hidden import Hidden
from periscopy_sim.model.fit import Fit, FittedPhotograph
from periscopy_sim.model.wall_gain import WallGain, largest_errors
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.noise_aware import NoiseAware
from tests.scenes.two_walls import write_two_walls

HIDDEN = (4, 5)
WALL = (20, 24)
PIXELS = WALL[0] * WALL[1]
RNG = np.random.default_rng(0)
A = RNG.random((PIXELS, 20)).astype(np.float32).astype(np.float64)
B = RNG.random((PIXELS, 3))
TRUTH = RNG.uniform(0.2, 1, (20, 3))
Y, X = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-1, 1, n) for n in WALL), indexing="ij"))
# Of mean 1 over the square: a factor on all of it cannot be told from a brighter hidden image.
TERMS = np.stack([X, Y, X * Y, X**2 - 1 / 3, Y**2 - 1 / 3], axis=1)
GAIN = 1 + TERMS @ [0.2, -0.1, 0.15, -0.2, 0.05]
AMBIENT = B @ RNG.random((3, 3))
NOISE = np.array([0.02, 0.04, 0.08])


def photograph(gain=1.0, seed=0):
    noise = NOISE * np.random.default_rng(seed).standard_normal((PIXELS, 3))
    signal = np.broadcast_to(gain, PIXELS)[:, None] * (A @ TRUTH)
    return (signal + AMBIENT + noise).reshape(*WALL, 3)


def monomials(highest, lowest=0):
    """All products of powers, which span what Legendre polynomials do."""
    return np.stack(
        [Y**i * X ** (n - i) for n in range(lowest, highest + 1) for i in range(n + 1)], axis=1
    )


def fitted_to(A, B, mask=None):
    given = Photograph.of(photograph(), mask=None if mask is None else mask.reshape(WALL))
    fit = Fit(A, B, hidden=Hidden.of(HIDDEN), conditions=given)
    wall_gain = WallGain(fit)
    Q = fit.background.T
    used = np.asarray(fit.rows, np.float64)
    patterns = fit.patterns.rows[fit.visible].T
    left = (used - Q @ (Q.T @ used)) @ patterns / np.sqrt(fit.curvatures) / fit.unit

    def estimate(rejected, noise, image):
        return wall_gain.estimate(rejected, rejected @ left, noise, image)

    return estimate, Q


def left_over(columns, y):
    """What least squares leaves of y, and the coefficients."""
    coefficients = np.linalg.lstsq(columns, y)[0]
    return y - columns @ coefficients, coefficients


# What makes the ratio least: errors of A that patches share, those and pixels' own, pixels' own.
@pytest.mark.parametrize(("masked", "seed"), [(False, 3), (False, 7), (True, 1)])
def test_coefficients_and_probability_are_those_of_nested_least_squares(masked, seed):
    mask = np.ones(PIXELS, bool)
    if masked:
        mask[50:130] = False
    y = photograph().reshape(-1, 3)
    errors = np.random.default_rng(seed).standard_normal(A.shape) * np.exp(X + Y)[:, None]
    y += 0.1 * errors @ TRUTH  # of A, beside the noise
    estimate, Q = fitted_to(A, B, mask if masked else None)
    image = 0.9 * TRUTH + 0.05
    rejected = y[mask] - Q @ (Q.T @ y[mask])
    found = estimate(np.ascontiguousarray(rejected.T), NOISE, image.T)

    # All channels in one regression, each with its own hidden image and ambient light.
    explaining = np.hstack([A, B, monomials(5)])[mask]
    terms = (TERMS[:, :, None] * (A @ image)[:, None])[mask] / NOISE
    unexplained = (
        np.vstack([left_over(explaining, terms[..., c])[0] for c in range(3)]),
        np.hstack([left_over(explaining, y[mask, c])[0] / NOISE[c] for c in range(3)]),
    )
    left, c = left_over(*unexplained)
    np.testing.assert_allclose(found.field.ravel(), 1 + TERMS @ c, atol=1e-4)
    added = ((TERMS @ c)[:, None] * (A @ image))[mask]
    np.testing.assert_allclose(found.added, rejected_by(Q, added), atol=1e-3)
    gained = np.sum(unexplained[1] ** 2) - np.sum(left**2)
    richer = np.hstack([explaining, monomials(7, 6)[mask]])
    smooth = [
        np.sum(left_over(explaining, channel)[0] ** 2) - np.sum(left_over(richer, channel)[0] ** 2)
        for channel in (y[mask] / NOISE).T
    ]
    # If A's errors make what is left, of which parts t are tried in small steps:
    r = np.stack([left_over(explaining, channel)[0] for channel in (y[mask] / NOISE).T])
    bias = np.zeros((5, 2))
    for k in range(5):
        for channel in range(3):
            g = left_over(np.hstack([A, B])[mask], terms[:, k, channel])[1][:20]
            f = image[:, channel] / NOISE[channel]
            bias[k, 0] += np.sum(TERMS[mask, k] * r[channel] ** 2)
            bias[k, 1] -= np.sum(r[channel] ** 2) * (g @ f) / (f @ f)
    H = unexplained[0].T @ unexplained[0]
    q = unexplained[0].T @ unexplained[1]
    assert q @ np.linalg.solve(H, q) == pytest.approx(gained)
    steps = np.linspace(0, 1, 201)
    tried = (q[:, None, None] + np.tensordot(bias, np.meshgrid(steps, steps), 1)).reshape(5, -1)
    least = np.min(np.sum(tried * np.linalg.solve(H, tried), axis=0))
    assert least < 0.9 * gained
    ratio = (least / 5) / (np.sum(smooth) / 45)
    assert found.probability == pytest.approx(stats.f.sf(ratio, 5, 45), rel=0.005)


def method(corrections=(WallGain,), **settings):
    known = {"hidden": HIDDEN, "photograph_shape": WALL, "regularization": 0.003}
    known["corrections"] = corrections
    return NoiseAware(A, B, profiles=False, **(known | settings))


def corrected(y, fit, unit=1.0):
    """Return what the correction makes of a photograph whose hidden image is known."""
    given = FittedPhotograph(fit.planes(unit * y[None])[0], fit)
    return given, *WallGain(fit)(given, lambda _: unit * TRUTH.reshape(*HIDDEN, 3))


def test_known_gain_is_recovered_and_the_image_is_better_for_it():
    for seed in range(3):
        y = photograph(GAIN, seed)
        found, without = method().solve(y), method(()).solve(y)
        assert found.corrections["wall_gain_found"] and not without.corrections
        limits = found.corrections["wall_gain_range"]
        assert limits == pytest.approx([GAIN.min(), GAIN.max()], abs=0.05)
        truth = TRUTH.reshape(*HIDDEN, 3)
        assert np.sum((found.image - truth) ** 2) < 0.3 * np.sum((without.image - truth) ** 2)
        assert (found.noise < without.noise).all()


@pytest.mark.parametrize("unit", [1.0, 1e6])
def test_light_that_the_gain_adds_is_subtracted(unit):
    fit = Fit(A, B, hidden=Hidden.of(HIDDEN), photograph_shape=WALL)
    given, even, found = corrected(photograph(GAIN), fit, unit)
    assert found["wall_gain_found"]
    added = unit * (GAIN - 1)[:, None] * (A @ TRUTH)
    removed = given.planes - even.planes
    distance = np.linalg.norm(removed - rejected_by(np.linalg.qr(B)[0], added))
    assert distance < 0.15 * np.linalg.norm(removed)
    given, even, found = corrected(photograph(), fit, unit)
    assert even is given and found == {"wall_gain_found": False, "wall_gain_range": [1, 1]}


def test_one_photograph_in_ten_thousand_may_have_a_gain_by_chance():
    # Probabilities hold, see above; weaker and weaker gains of one photograph have all of them.
    estimate, Q = fitted_to(A, B)
    probabilities, accepted = [], []
    for strength in np.geomspace(1e-3, 1, 60):
        y = photograph(1 + strength * (GAIN - 1)).reshape(-1, 3)
        found = estimate(rejected_by(Q, y), NOISE, TRUTH.T)
        probabilities.append(found.probability)
        accepted.append(found.accepted)
    doubtful = (np.array(probabilities) > 1e-4) & (np.array(probabilities) < 1e-2)
    assert doubtful.any() and min(probabilities) < 1e-6
    np.testing.assert_array_equal(accepted, np.array(probabilities) < 1e-4)


def test_gain_is_found_where_the_light_itself_explains_smooth_polynomials():
    # Their part that is left is one of rounding, unless it is projected out again and again.
    bumps = bumps_of_light(4).astype(np.float32).astype(np.float64)
    estimate, Q = fitted_to(bumps, np.ones((PIXELS, 1)))
    for seed in range(5):
        errors = 0.003 * np.random.default_rng(seed).standard_normal((PIXELS, 3))
        y = GAIN[:, None] * (bumps @ TRUTH) + errors
        found = estimate(rejected_by(Q, y), np.full(3, 0.003), TRUTH.T)
        assert found.accepted and np.abs(found.field.ravel() - GAIN).max() < 0.1


@pytest.mark.thorough
def test_smooth_light_that_no_background_explains_is_no_gain():
    for seed in range(20):
        lit = 20 * NOISE.mean() * np.random.default_rng(seed).normal(size=(36, 3))
        y = photograph(seed=seed) + (monomials(7) @ lit).reshape(*WALL, 3)
        assert not method().solve(y).corrections["wall_gain_found"]


def bumps_of_light(steepness):
    """Return a transport matrix unlike penumbrae in that each patch lights a place of its own."""
    down, across = (
        axis.ravel() for axis in np.mgrid[-1 : 1 : HIDDEN[0] * 1j, -1 : 1 : HIDDEN[1] * 1j]
    )
    return np.exp(-steepness * ((Y[:, None] - down) ** 2 + (X[:, None] - across) ** 2))


def rejected_by(Q, y):
    return np.ascontiguousarray((y - Q @ (Q.T @ y)).T)


@pytest.mark.parametrize("dark", [False, True])
def test_errors_of_the_transport_matrix_are_no_gain(dark):
    bumps = bumps_of_light(6)
    hidden = TRUTH * np.linspace(0, 2, 20)[:, None]
    probabilities = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        rendered = bumps + 0.004 * (1 + 0.9 * X[:, None]) * rng.standard_normal(bumps.shape)
        if dark:  # a patch that the wall does not see has no errors
            rendered[:, 0] = bumps[:, 0] = 0
        estimate, Q = fitted_to(rendered, np.ones((PIXELS, 1)))
        y = bumps @ hidden + 1e-3 * rng.standard_normal((PIXELS, 3))
        left = left_over(np.hstack([rendered, Q, monomials(5)]), y)[0]
        noise = np.sqrt(np.sum(left**2, axis=0) / (PIXELS - 41))
        probabilities.append(estimate(rejected_by(Q, y), noise, hidden.T).probability)
    # By chance, more than 7 of 40 are below 5 % in 0.07 % of all seeds.
    assert np.sum(np.array(probabilities) < 0.05) <= 7


@pytest.mark.parametrize("ambient", [1, 60])
@pytest.mark.parametrize("size", [1e-3, 1e-2])
def test_errors_of_the_transport_matrix_are_no_larger_than_its_weakest_image_shows(size, ambient):
    smooth = bumps_of_light(0.5)  # its weakest image has next to no light
    smooth[:, :5] *= 0.02
    rng = np.random.default_rng(0)
    background = rng.standard_normal((PIXELS, ambient))
    Q = np.linalg.qr(background)[0]
    energies = np.sum((smooth - Q @ (Q.T @ smooth)) ** 2, axis=0)
    errors = size * np.sqrt(energies / PIXELS) * rng.standard_normal(smooth.shape)
    exact, bounds = (
        largest_errors(Fit(each, background, hidden=Hidden.of(HIDDEN)))
        for each in (smooth, smooth + errors)
    )
    errors -= Q @ (Q.T @ errors)
    of_columns = np.sum(errors**2, axis=0)
    assert (exact < 0.1 * of_columns).all() and (bounds > 0.8 * of_columns).all()
    assert of_columns.sum() < bounds.sum() < 3 * of_columns.sum()


def test_dark_and_noiseless_photographs_have_no_gain():
    for y in (np.zeros((*WALL, 3)), (A @ TRUTH + AMBIENT).reshape(*WALL, 3)):
        limits = method().solve(y).corrections["wall_gain_range"]
        assert limits == pytest.approx([1, 1], abs=1e-4)  # single precision


def test_gain_that_cannot_be_is_not_believed():
    # It is negative on the left.
    estimate, Q = fitted_to(A, B)
    y = photograph(1 + 2 * X).reshape(-1, 3)
    found = estimate(rejected_by(Q, y), NOISE, TRUTH.T)
    assert found.probability < 1e-6 and found.field.min() < 0 and not found.accepted


def test_no_gain_is_found_where_noise_hides_hardly_a_pattern(tmp_path):
    scenario = ps.load_scenario(write_two_walls(tmp_path), (12, 16), camera="right")
    A = ps.transport(scenario)
    method = NoiseAware.for_scene(scenario, A, ps.point_light_backgrounds(scenario))
    down, across = np.mgrid[0:1:12j, 0:1:16j]
    disc = (across - 0.5) ** 2 + (down - 0.4) ** 2 < 0.08
    truth = np.stack([across, disc, down], axis=-1)
    light = (A @ truth.reshape(-1, 3)).reshape(*scenario.photograph_shape, 3)
    for seed in range(3):
        solution = method.solve(ps.add_noise(light, 70, seed))
        assert not solution.corrections["wall_gain_found"]
        assert np.sqrt(np.mean((solution.image - truth) ** 2)) < 0.05
