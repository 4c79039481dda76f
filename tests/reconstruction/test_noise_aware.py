"""The noise-aware method against brute-force minimization of its objective."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from periscopy_sim.model.ambient_lines import AmbientLines
from periscopy_sim.model.paint import Paint
from periscopy_sim.model.wall_gain import WallGain
from periscopy_sim.photograph import ColourMatrix, Photograph
from periscopy_sim.reconstruction.noise_aware import NoiseAware
from periscopy_sim.reconstruction.preconditioned import Periscope

HIDDEN = (4, 5)
PHOTOGRAPH = (12, 15)
RNG = np.random.default_rng(0)
A = RNG.random((180, 20)) + 0.1
B = RNG.random((180, 4))
TRUTH = np.zeros((*HIDDEN, 3))
TRUTH[1:3, 1:4] = (0.9, 0.5, 0.2)
SIGNAL = (A @ TRUTH.reshape(-1, 3) + 2 * B @ RNG.random((4, 3))).reshape(*PHOTOGRAPH, 3)
NOISE = np.array([0.05, 0.1, 0.2])
MIXING = ColourMatrix(np.array([[0.7, 0.25, 0.05], [0.2, 1.0, 0.3], [0.0, 0.3, 1.2]]))


def photograph(seed=0):
    return SIGNAL + NOISE * np.random.default_rng(seed).standard_normal(SIGNAL.shape)


def projected():
    Q = np.linalg.qr(B)[0]
    return A - Q @ (Q.T @ A), Q


def gradient(f):
    image = f.reshape(*HIDDEN, 3)
    down = np.diff(image, axis=0, append=image[-1:])
    across = np.diff(image, axis=1, append=image[:, -1:])
    return down, across


def objective(f, y, noise, weight, M, smoothing=0.0):
    rejected, Q = projected()
    left = rejected @ f.reshape(-1, 3) @ M.T - (y - Q @ (Q.T @ y))
    squares = sum((part**2).sum(axis=2) for part in gradient(f))
    variation = np.sqrt(squares + smoothing**2) - smoothing
    return np.sum(left**2 / noise**2) + weight * variation.sum()


def slope(f, y, noise, weight, M, smoothing):
    """Return the gradient of the objective rounded off."""
    rejected, Q = projected()
    left = rejected @ f.reshape(-1, 3) @ M.T - (y - Q @ (Q.T @ y))
    down, across = gradient(f)
    length = np.sqrt((down**2 + across**2).sum(axis=2) + smoothing**2)[..., None]
    slopes = np.zeros((*HIDDEN, 3))
    slopes[:-1] -= (down / length)[:-1]
    slopes[1:] += (down / length)[:-1]
    slopes[:, :-1] -= (across / length)[:, :-1]
    slopes[:, 1:] += (across / length)[:, :-1]
    return (2 * rejected.T @ (left / noise**2) @ M).ravel() + weight * slopes.ravel()


def brute_force(y, noise, weight, M, positive):
    """Quasi-Newton steps on a total variation rounded off a little, in ever sharper stages."""
    f = np.full(60, 0.1)
    bounds = [(0, None)] * 60 if positive else None
    for smoothing in (1e-1, 1e-2, 1e-3, 1e-4):
        f = minimize(
            objective, f, (y, noise, weight, M, smoothing), "L-BFGS-B", slope, bounds=bounds,
            options={"maxiter": 20_000, "maxfun": 10**6, "ftol": 1e-15, "gtol": 1e-9},
        ).x  # fmt: skip
    return f.reshape(*HIDDEN, 3)


@pytest.mark.parametrize("positive", [True, False])
@pytest.mark.parametrize("regularization", [0.01, 0.1])
@pytest.mark.parametrize("matrix", [None, MIXING])
def test_image_minimizes_the_penalized_likelihood(positive, regularization, matrix):
    y, M = photograph(), np.eye(3)
    if matrix is not None:
        y, M = matrix.mix(SIGNAL) + photograph() - SIGNAL, matrix.matrix
    method = NoiseAware(
        A, B, hidden=HIDDEN, regularization=regularization, positive=positive, tolerance=1e-6,
        max_iterations=20_000, profiles=False, corrections=(),
    )  # fmt: skip
    found = method.solve(Photograph.of(y, colour_matrix=matrix))
    arguments = (y.reshape(-1, 3), found.noise, found.weight, M)
    expected = brute_force(*arguments, positive)
    least = objective(expected.ravel(), *arguments)
    assert objective(found.image.ravel(), *arguments) < least * (1 + 1e-4)
    assert np.abs(found.image - expected).max() < 0.01 * np.abs(expected).max()
    assert (found.image >= 0).all() == positive


def test_default_tolerance_is_near_the_minimum():
    y = photograph()
    method = NoiseAware(A, B, hidden=HIDDEN)
    found = method.solve(y)
    exact = NoiseAware(A, B, hidden=HIDDEN, tolerance=1e-6, max_iterations=20_000).solve(y)
    assert found.converged and found.iterations < exact.iterations
    assert np.linalg.norm(found.image - exact.image) < 0.02 * np.linalg.norm(exact.image)


def test_weight_grows_where_there_is_more_noise_than_signal():
    rejected, Q = projected()
    method = NoiseAware(A, B, hidden=HIDDEN)
    bright = SIGNAL.reshape(-1, 3) - Q @ (Q.T @ SIGNAL.reshape(-1, 3))
    for noise in np.array([0.3, 1.0, 3.0]) * np.sqrt(np.mean(bright**2)):
        weights, ratios = [], []
        for seed in range(20):
            y = SIGNAL + noise * np.random.default_rng(seed).standard_normal(SIGNAL.shape)
            found = method.solve(y)
            weights.append(found.weight / (0.02 * np.linalg.norm(rejected) / found.noise.mean()))
            left = y.reshape(-1, 3) - Q @ (Q.T @ y.reshape(-1, 3))
            energy = 176 * np.sum(found.noise**2)
            least = np.sqrt(2 * 20 * np.sum(found.noise**4))
            ratios.append(max(1, energy / max(np.sum(left**2) - energy, least)))
        np.testing.assert_allclose(weights, np.sqrt(ratios), rtol=1e-4)
        # The energies of 528 numbers scatter by 6 %, and so their roots' ratio.
        assert np.median(weights) == pytest.approx(
            max(1, noise**2 / np.mean(bright**2)) ** 0.5, rel=0.25
        )


def test_it_errs_less_than_the_papers_method():
    ours, theirs = [], []
    methods = [kind(A, B, hidden=HIDDEN) for kind in (NoiseAware, Periscope)]
    for seed in range(20):
        y = photograph(seed)
        for errors, method in zip((ours, theirs), methods, strict=True):
            errors.append(np.mean((method.reconstruct(y) - TRUTH) ** 2))
    assert np.mean(ours) < 0.5 * np.mean(theirs)


def test_channels_share_their_edges():
    # A grey scene of which one channel is nearly all noise: the others show it where edges are.
    grey = np.repeat(TRUTH[..., :1], 3, axis=2)
    noise = np.array([0.05, 0.05, 0.5])
    method = NoiseAware(A, hidden=HIDDEN)
    together, apart = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y = A @ grey.reshape(-1, 3) + noise * rng.standard_normal((180, 3))
        third = y[:, 2:] + np.zeros(3)  # the same channel thrice: nothing to learn from
        together.append(np.mean((method.reconstruct(y) - grey)[..., 2] ** 2))
        apart.append(np.mean((method.reconstruct(third) - grey)[..., 2] ** 2))
    gains = np.array(apart) - together
    assert gains.mean() > 4 * gains.std(ddof=1) / np.sqrt(len(gains))


def test_patches_that_the_wall_does_not_show_take_their_neighbours_light():
    dark = A.copy()
    dark[:, 7] = 0
    image = NoiseAware(dark, B, hidden=HIDDEN).reconstruct(
        photograph() - (A[:, 7:8] @ TRUTH.reshape(-1, 3)[7:8]).reshape(SIGNAL.shape)
    )
    assert np.isfinite(image).all()
    assert image[1, 2, 0] == pytest.approx(image[1, 1, 0], abs=0.3)


def warns(y):
    method = NoiseAware(A, B, hidden=HIDDEN)
    solution = method.solve(y)
    codes = [note.code for note in method.report(y, solution).warnings]
    assert codes in ([], ["no_hidden_image"])
    return bool(codes), solution


@pytest.mark.filterwarnings("ignore:noise-aware recovery stopped")
@pytest.mark.parametrize("light", [0, 1, 1e9])
def test_photograph_of_ambient_light_alone_shows_no_hidden_image(light):
    warned, solution = warns(light * (B @ np.ones((4, 3))))
    assert warned and solution.image.max() <= 1e-3 * light


def test_photograph_of_noise_or_of_one_bright_pixel_shows_no_hidden_image():
    noise = B @ np.ones((4, 3)) + 0.1 * np.random.default_rng(0).standard_normal((180, 3))
    dot = np.zeros((180, 3))
    dot[77] = 1
    assert warns(noise)[0] and warns(dot)[0]


@pytest.mark.parametrize("noise", [1e-6, 1, 3])
def test_photograph_that_shows_something_is_not_warned_of(noise):
    assert not warns(SIGNAL + noise * (photograph() - SIGNAL))[0]


class Twice:
    """A correction that asks for two first images and halves the photograph."""

    def __init__(self, fit):
        self.fit = fit
        self.images = []

    def __call__(self, photograph, first_image):
        self.images = [first_image(photograph) for _ in range(2)]
        return replace(photograph, planes=photograph.planes / 2), {"halved": True}


def test_a_correction_is_given_the_fit_and_first_images_and_changes_the_photograph():
    settings = {"hidden": HIDDEN, "tolerance": 1e-5, "max_iterations": 20_000}
    method, plain = (
        NoiseAware(A, B, corrections=corrections, **settings) for corrections in ([Twice], ())
    )
    y = photograph()
    solution, expected = method.solve(y), plain.solve(y)
    (correction,) = method.corrections
    assert correction.fit is method.fit
    np.testing.assert_allclose(2 * solution.image, expected.image, atol=1e-3)
    np.testing.assert_allclose(2 * solution.noise, expected.noise)
    assert solution.corrections == {"halved": True} and expected.corrections == {}
    assert solution.numbers()["halved"] is True
    np.testing.assert_allclose(2 * method.corrected(y, solution), plain.corrected(y, expected))
    for image in correction.images:
        assert np.linalg.norm(image - expected.image) < 0.3 * np.linalg.norm(expected.image)


@pytest.mark.parametrize("most", [1, 2, 3, 30])
def test_iterations_for_first_images_are_counted(most):
    method = NoiseAware(
        A, B, hidden=HIDDEN, corrections=[Twice], max_iterations=most, tolerance=1e-7
    )
    with pytest.warns(RuntimeWarning, match="stopped"):
        solution = method.solve(photograph())
    assert not solution.converged and solution.iterations == most
    assert np.isfinite(solution.image).all()


def test_default_corrections_are_those_that_the_photographs_allow():
    def kinds(photograph=SIGNAL, B=B, **settings):
        method = NoiseAware(A, B, hidden=HIDDEN, **settings).fitted_to(photograph)
        return [type(each) for each in method.corrections]

    known, dark = {"photograph_shape": PHOTOGRAPH}, Photograph.of(SIGNAL, monitor_off=[SIGNAL])
    assert kinds() == []
    masked = Photograph.of(SIGNAL, mask=np.ones(PHOTOGRAPH, bool))
    assert kinds(**known) == kinds(masked) == kinds(dark, None) == [AmbientLines, WallGain]
    assert kinds(dark) == [Paint, AmbientLines, WallGain]
    assert kinds(**known, corrections=()) == []
