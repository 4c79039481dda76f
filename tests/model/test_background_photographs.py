from functools import partial

import numpy as np
import pytest

from periscopy_sim.hidden import Hidden
from periscopy_sim.methods import fit_method
from periscopy_sim.model.fit import Fit
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.noise_aware import NoiseAware
from periscopy_sim.reconstruction.preconditioned import Periscope
from periscopy_sim.reconstruction.truncated_svd import TruncatedSVD

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
SCENE = {"hidden": HIDDEN, "channel_gain": GAIN, "photograph_shape": PHOTOGRAPH}

METHODS = {
    "periscope": partial(Periscope, **SCENE, repair_threshold=np.inf),
    "noise-aware": partial(NoiseAware, **SCENE, profiles=False, corrections=()),
}


def photographed(*off, y=Y, mask=None):
    """A photograph with others of the monitor off, (M, 3) each."""
    dark = [each.reshape(*PHOTOGRAPH, 3) for each in off]
    return Photograph.of(y.reshape(*PHOTOGRAPH, 3), mask=mask, monitor_off=dark)


def test_singular_vectors_are_those_of_the_matrix_without_the_photographs():
    plain = {"tv_weight": 0, "repair_threshold": np.inf}
    solved = TruncatedSVD(A, **SCENE, fraction=0.5, **plain).solve(photographed(OFF))
    Q = np.linalg.qr(LAMP)[0]
    U, σ, Vt = np.linalg.svd(A - Q @ (Q.T @ A), full_matrices=False)
    y = Y.reshape(M, 3) / GAIN
    expected = Vt[:6].T @ ((U[:, :6].T @ y) / σ[:6, None])
    np.testing.assert_allclose(solved.image.reshape(N, 3), expected, rtol=1e-6)
    left = y - Q @ (Q.T @ y) - U[:, :6] @ (U[:, :6].T @ y)
    np.testing.assert_allclose(solved.noise, np.sqrt(np.sum(left**2, axis=0) / (M - 6 - 3)))


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
def test_noise_of_a_background_photograph_counts_as_often_as_it_is_needed(method):
    # Of one grey lamp the photograph needs c times its background photograph, whose channels may
    # share it. Where they do, with noise τ each, y is left the variance σ² + c² τ²/3.
    σ, τ, c = 0.02, 0.05, 1.5
    lamp = np.random.default_rng(1).uniform(0.5, 1.5, (M, 1))
    variances = []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        y = A @ TRUTH + c * lamp + σ * rng.normal(size=(M, 3))
        off = lamp + τ * rng.normal(size=(M, 3))
        found = METHODS[method](A, B).solve(photographed(off * GAIN, y=y * GAIN))
        variances.append(found.noise**2)
    variances = np.reshape(variances, (40, 3)).mean(axis=1)  # the channels share the lamp's noise
    error = np.std(variances) / np.sqrt(40)
    attenuated = 1 / (1 + τ**2 / 3 / np.var(lamp))  # the least that is left, by weaker columns
    assert attenuated > 0.98
    # Four standard errors: wrong once in 16,000 draws of seeds.
    assert abs(variances.mean() - σ**2 - c**2 * τ**2 / 3) < 4 * error + 0.02 * c**2 * τ**2 / 3
    assert variances.mean() > 1.5 * σ**2


def test_background_photograph_of_much_noise_does_no_harm():
    errors = {"none": [], "given": []}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y = (A @ TRUTH + 0.02 * B @ np.ones((3, 3)) + 0.02 * rng.normal(size=(M, 3))) * GAIN
        off = 1 + rng.normal(size=(M, 3))
        for name, dark in {"none": [], "given": [off]}.items():
            image = METHODS["noise-aware"](A, B).reconstruct(photographed(*dark, y=y))
            errors[name].append(np.mean((image.reshape(N, 3) - TRUTH) ** 2))
    assert np.mean(errors["given"]) < 1.05 * np.mean(errors["none"])


def test_monitor_off_photograph_without_light_where_the_wall_is_used_is_rejected_by_name():
    dark = np.where(MASK[..., None], 0.0, Y)
    with pytest.raises(ValueError, match=r"off\.exr: .*(zero|positive)"):
        Photograph.of(Y, mask=MASK, monitor_off={"off.exr": dark})
    unchecked = Photograph(Y, MASK, {"off.exr": dark})
    with pytest.raises(ValueError, match=r"off\.exr: no value is positive"):
        METHODS["noise-aware"](A, B).reconstruct(unchecked)


def test_joined_columns_are_black_where_the_mask_is():
    off = np.where(MASK[..., None], OFF.reshape(*PHOTOGRAPH, 3), np.inf)
    scene = {"hidden": Hidden.of(HIDDEN), "channel_gain": GAIN}
    seen = Fit(A, B, **scene, conditions=Photograph.of(Y, mask=MASK, monitor_off=[off]))
    joined = seen.whole_background
    expected = np.hstack([B, np.where(MASK.ravel()[:, None], LAMP, 0)])
    np.testing.assert_allclose(joined, expected)
    columns = np.hstack([seen.used(B), seen.monitor_off_columns])
    np.testing.assert_array_equal(seen.used(joined), columns)
    assert Fit(A, B, **scene).whole_background is B


def test_own_method_is_given_columns_of_background_light(tmp_path):
    class Scene:
        photograph_shape, hidden, channel_gain = PHOTOGRAPH, HIDDEN, GAIN

    (tmp_path / "own.py").write_text(
        "class Columns:\n"
        "    def __init__(self, scenario, A, B):\n"
        "        self.B = B\n"
        "    def reconstruct(self, photograph): ...\n"
    )
    fitted = fit_method(f"{tmp_path}/own.py:Columns", Scene(), A, B, photographed(OFF))
    np.testing.assert_allclose(fitted.method.B, np.hstack([B, LAMP]))
