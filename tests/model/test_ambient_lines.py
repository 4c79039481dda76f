"""Lines of ambient light: their likelihood against dense matrices, and what they do to images."""

from dataclasses import replace

import numpy as np
import pytest

import periscopy_sim as ps
from periscopy_sim.model.ambient_lines import AmbientLines, cosines
from periscopy_sim.model.fit import FittedPhotograph
from periscopy_sim.photograph import Photograph

WALL, HIDDEN = (24, 30), (6, 7)


def small_method(mask=None):
    """A method for random light that is smooth, as penumbrae are, under two backgrounds."""
    rng = np.random.default_rng(0)
    A = rng.random((np.prod(WALL), np.prod(HIDDEN)))
    B = np.stack([np.ones(len(A)), np.linspace(0, 1, len(A))], axis=1)
    method = ps.NoiseAware(A, B, hidden=HIDDEN, photograph_shape=WALL, profiles=False)
    return method if mask is None else method.fitted_to(mask)


@pytest.mark.parametrize("masked", [False, True])
def test_likelihood_and_lines_are_those_of_dense_matrices(masked):
    """The covariance of y⊥ written out, in an orthonormal basis of what B leaves."""
    rng = np.random.default_rng(1)
    y = rng.random((*WALL, 3)) * [1, 2, 3]
    given = Photograph.of(y, mask=rng.random(WALL) < 0.8) if masked else None
    fit = small_method(given).fit
    (planes,) = fit.planes(y[None])
    photograph = FittedPhotograph(planes, fit)
    likelihood = AmbientLines(fit)._likelihood(photograph)
    down, across = (cosines(size) for size in WALL)
    L = np.hstack([np.kron(down, np.ones((WALL[1], 1))), np.tile(across, (WALL[0], 1))])
    L = fit.used(L)
    E = np.linalg.svd(fit.basis)[0][:, fit.basis.shape[1] :]
    x = np.log([0.3, 5, 2])
    τ, *v = np.exp(x)
    W = fit.patterns.rows[fit.visible] / np.sqrt(fit.curvatures[:, None]) / fit.unit
    light = E.T @ fit.rows @ W.T
    signals = fit.curvatures / fit.curvatures.mean()
    band = np.floor(np.log2(signals))
    signals = np.array([signals[band == each].mean() for each in band])
    V = np.diag(np.repeat(v, [down.shape[1], across.shape[1]]))
    Σ = τ * signals * light @ light.T + E.T @ L @ V @ L.T @ E + np.eye(len(light))
    data = E.T @ photograph.y.T
    weighted = np.linalg.solve(Σ, data)
    value, o = likelihood.cost(x)
    dense = 3 * np.linalg.slogdet(Σ)[1]
    dense += len(data) * np.sum(np.log(np.sum(data * weighted, axis=0)))
    assert value == pytest.approx(dense, rel=1e-5)
    np.testing.assert_allclose(o, (V @ L.T @ E @ weighted).T, rtol=1e-3, atol=1e-6)


@pytest.fixture(scope="module")
def chair():
    """The chair, its default method, and the light of a picture, (rows, columns, 3)."""
    scene = ps.load_scenario("chair", (15, 18), {"resolution": 63})
    A, B = scene_matrices(scene)
    truth = ps.read_hidden_image(ps.find_image("mushroom"), (15, 18))
    light = (A @ truth.reshape(-1, 3)).reshape(63, 63, 3)
    return ps.NoiseAware.for_scene(scene, A, B), truth, light / light.mean()


def scene_matrices(scene):
    return ps.transport(scene, noise=1e-3), ps.point_light_backgrounds(scene)


def kink(strength):
    """Ambient light that is even but for a crease down the wall."""
    away = np.abs(np.arange(63) - 31.3)
    return np.broadcast_to((1 + strength * np.minimum(away, 3))[None, :, None], (63, 63, 3))


def test_a_crease_of_ambient_light_does_not_spoil_the_image(chair):
    method, truth, light = chair
    plain = ps.NoiseAware(
        method.fit.A, method.fit.B, hidden=(15, 18), photograph_shape=(63, 63), corrections=()
    )
    for seed in range(3):
        y = ps.add_noise(light + 5 * kink(0.01), snr=60, seed=seed)
        solution = method.solve(y)
        assert solution.corrections["ambient_lines_found"]
        assert "ambient_lines" in [note.code for note in method.report(y, solution).notes]
        scores = [ps.psnr_gain_matched(m, truth) for m in (solution.image, plain.reconstruct(y))]
        assert scores[0] > scores[1] + 1


@pytest.mark.parametrize("snr", [40, 60])
def test_without_lines_the_photograph_stays_the_same(chair, snr):
    method, _, light = chair
    for seed in range(3):
        y = ps.add_noise(light + kink(0), snr=snr, seed=seed)
        given = FittedPhotograph(method.fit.planes(y[None])[0], method.fit)
        same, numbers = AmbientLines(method.fit)(given, lambda _: None)
        assert same is given and numbers == {"ambient_lines_found": False}


def test_black_photographs_have_no_lines(chair):
    fit = chair[0].fit
    given = FittedPhotograph(np.zeros((3, fit.pixels)), fit)
    assert AmbientLines(fit)(given, lambda _: None)[0] is given


def test_lines_need_rows_and_columns():
    fit = replace(small_method().fit, photograph_shape=None)
    with pytest.raises(ValueError, match="rows and columns"):
        AmbientLines(fit)
