import numpy as np
import pytest

from periscopy_sim.evaluation.methods import fit_method
from periscopy_sim.model.observation import observation_of
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.baselines.truncated_svd import TruncatedSVD
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
from periscopy_sim.reconstruction.registry import METHODS

PHOTOGRAPH, HIDDEN = (20, 24), (3, 4)
M, N = 480, 12
RNG = np.random.default_rng(70)
A = RNG.uniform(0.1, 1, (M, N))
B = np.hstack([np.ones((M, 1)), RNG.uniform(0.1, 1, (M, 2))])
GAIN = np.array([1.2, 1.0, 0.8])
TRUTH = RNG.uniform(0.2, 1, (N, 3))
LAMP = RNG.uniform(0.5, 1.5, (M, 3))  # of no point light
OFF = LAMP * GAIN
Y = ((A @ TRUTH + LAMP @ RNG.uniform(0, 2, (3, 3))) * GAIN).reshape(*PHOTOGRAPH, 3)
Y += 1e-3 * RNG.normal(size=Y.shape)
MASK = RNG.random(PHOTOGRAPH) > 0.25


class Scene:
    photograph_shape, hidden_shape, channel_gain = PHOTOGRAPH, HIDDEN, GAIN


def photographed(y, off):
    """Return a photograph of (M, 3) light, and of light with the monitor off."""
    return Photograph.of(y.reshape(Y.shape), monitor_off=[off.reshape(Y.shape)])


def test_singular_vectors_are_those_of_the_matrix_without_the_photographs():
    svd = TruncatedSVD.for_scene(Scene, A, fraction=0.5, tv_weight=0, repair_threshold=np.inf)
    solved = svd.solve(photographed(Y, OFF))
    Q = np.linalg.qr(LAMP)[0]
    U, σ, Vt = np.linalg.svd(A - Q @ (Q.T @ A), full_matrices=False)
    y = Y.reshape(M, 3) / GAIN
    expected = Vt[:6].T @ ((U[:, :6].T @ y) / σ[:6, None])
    np.testing.assert_allclose(solved.image.reshape(N, 3), expected, rtol=1e-6)
    left = y - Q @ (Q.T @ y) - U[:, :6] @ (U[:, :6].T @ y)
    np.testing.assert_allclose(solved.noise, np.sqrt(np.sum(left**2, axis=0) / (M - 6 - 3)))


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["preconditioned", "noise-aware", "iterative"])
def test_noise_of_a_background_photograph_counts_as_often_as_it_is_needed(name):
    # Of one grey lamp the photograph needs c times its background photograph, whose channels may
    # share it. Where they do, with noise τ each, y is left the variance σ² + c² τ²/3.
    σ, τ, c = 0.02, 0.05, 1.5
    lamp = np.random.default_rng(1).uniform(0.5, 1.5, (M, 1))
    variances = []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        y = A @ TRUTH + c * lamp + σ * rng.normal(size=(M, 3))
        off = lamp + τ * rng.normal(size=(M, 3))
        found = METHODS[name](Scene, A, B).solve(photographed(y * GAIN, off * GAIN))
        variances.append(found.noise**2)
    variances = np.reshape(variances, (40, 3)).mean(axis=1)  # the channels share the lamp's noise
    error = np.std(variances) / np.sqrt(40)
    attenuated = 1 / (1 + τ**2 / 3 / np.var(lamp))  # the least that is left, by weaker columns
    assert attenuated > 0.98
    # Four standard errors: wrong once in 16,000 draws of seeds.
    assert abs(variances.mean() - σ**2 - c**2 * τ**2 / 3) < 4 * error + 0.02 * c**2 * τ**2 / 3
    assert variances.mean() > 1.5 * σ**2


def test_background_photograph_of_much_noise_does_no_harm():
    method = NoiseAware.for_scene(Scene, A, B, profiles=False, corrections=())
    errors = {"none": [], "given": []}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y = (A @ TRUTH + 0.02 * B @ np.ones((3, 3)) + 0.02 * rng.normal(size=(M, 3))) * GAIN
        off = 1 + rng.normal(size=(M, 3))
        for name, given in {"none": y, "given": photographed(y, off)}.items():
            image = method.reconstruct(given)
            errors[name].append(np.mean((image.reshape(N, 3) - TRUTH) ** 2))
    assert np.mean(errors["given"]) < 1.05 * np.mean(errors["none"])


@pytest.mark.parametrize(
    ("off", "message"),
    [
        (np.ones((19, 24, 3)), "19x24 pixels"),
        (np.where(np.arange(M) == 7, np.nan, 1.0)[:, None] * OFF, "finite"),
        (np.zeros((M, 3)), "no value is positive"),
        (-OFF, "no value is positive"),
        (OFF[:, :2], "shape"),
        (OFF.astype(complex), "real numbers"),
    ],
)
def test_what_is_no_background_photograph_is_rejected_by_name(off, message):
    for given, name in (([off], "photograph 1 of 1"), ({"off.exr": off}, r"off\.exr")):
        with pytest.raises(ValueError, match=f"{name}: .*{message}"):
            observation_of(A, HIDDEN, GAIN, None, PHOTOGRAPH, given)


def test_joined_columns_are_black_where_the_mask_is():
    off = np.where(MASK.ravel()[:, None], OFF, np.inf)
    seen = observation_of(A, HIDDEN, GAIN, MASK, PHOTOGRAPH, [off])
    joined = seen.joined(B)
    expected = np.hstack([B, np.where(MASK.ravel()[:, None], LAMP, 0)])
    np.testing.assert_allclose(joined, expected)
    np.testing.assert_array_equal(seen.used(joined), np.hstack([seen.used(B), seen.ambient()]))
    assert observation_of(A, HIDDEN, GAIN).joined(B) is B


def test_own_method_is_given_columns_or_photographs_as_it_likes(tmp_path):
    (tmp_path / "own.py").write_text(
        "class Columns:\n"
        "    def __init__(self, scenario, A, B):\n"
        "        self.B, self.backgrounds = B, None\n"
        "    def reconstruct(self, photograph): ...\n"
        "class Photographs(Columns):\n"
        "    def __init__(self, scenario, A, B, backgrounds=()):\n"
        "        self.B, self.backgrounds = B, backgrounds\n"
    )
    given = {"off": OFF}
    columns = fit_method(f"{tmp_path}/own.py:Columns", Scene(), A, B, None, given)
    np.testing.assert_allclose(columns.B, np.hstack([B, LAMP]))
    photographs = fit_method(f"{tmp_path}/own.py:Photographs", Scene(), A, B, None, given)
    assert photographs.B is B and photographs.backgrounds is given
