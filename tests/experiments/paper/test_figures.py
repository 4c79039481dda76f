import importlib

import numpy as np
import pytest
import xarray as xr

import periscopy_sim as ps
from experiments.paper import fig4
from experiments.paper.fig10 import radial_spectrum, row_statistics
from experiments.published.ambient import outside
from experiments.setting import GLASS, NO_BEAM, Measured, Setting
from experiments.sweeps import errors_of
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC

SHAPE = (24, 24, 3)


class TinySetting(Setting):
    """The setting with 6 x 8 patches, 24 x 24 pixels, and nothing path traced."""

    def __init__(self, out):
        super().__init__(out)
        self.hidden, self.parameters = (6, 8), {"resolution": "24"}

    def backgrounds(self, names=REALISTIC):
        lights = {name: np.random.default_rng(k).random((512, 3)) for k, name in enumerate(names)}
        return {name: (self.B @ light).reshape(SHAPE) for name, light in lights.items()}

    @property
    def synthetic(self):
        truth = ps.read_hidden_image(ps.find_image(self.image), self.hidden)
        signal = (self.A @ truth.reshape(-1, 3)).reshape(SHAPE).astype(float)
        return Measured(signal, truth, real=False)

    @property
    def adversarial(self):
        return self.backgrounds([GLASS, NO_BEAM, *(n for n in ADVERSARIAL if n != GLASS)])

    def place(self, _):
        return np.full((4, 5, 3), 0.5)


LONGER = [pytest.param(name, marks=pytest.mark.thorough) for name in ("fig6", "table1")]


@pytest.mark.parametrize("name", ["fig3", "fig5", "fig8", "fig9", "fig10", *LONGER])
def test_a_figure_is_made_from_a_tiny_scene(name, tmp_path):
    section = importlib.import_module(f"experiments.paper.{name}").run(TinySetting(tmp_path))
    assert section.claims and all(claim.measured for claim in section.claims)
    assert all(picture.file.is_file() for picture in section.pictures)


SBRS = np.array(fig4.SBRS)
LIGHTS = [f"{name}{flip}" for name in ("a", "b") for flip in ("", " up-down")]
FLAT = np.full(len(SBRS), 0.04)


def results(**errors):
    """Mean squared errors by method (in identifiers), (SBRs,) or (SBRs, backgrounds)."""
    names = {"noise_aware": "noise-aware", "without_repair": "without repair"}
    values = [np.broadcast_to(np.transpose(e), (len(LIGHTS), len(SBRS))) for e in errors.values()]
    error = np.stack(values)[..., None]
    dims = ("algorithm", "background", "sbr", "seed")
    methods = [names.get(name, name) for name in errors]
    return xr.Dataset(
        {"mean_squared_error": (dims, error), "psnr_registered": (dims, -10 * np.log10(error / 2))},
        {"algorithm": methods, "background": LIGHTS, "sbr": SBRS, "seed": [0]},
    )


def test_errors_are_those_of_the_method_by_sbr_background_and_draw():
    by_light = np.arange(1.0, 5) * np.ones((len(SBRS), 1))
    data = results(preconditioned=by_light, differencing=FLAT)
    error = errors_of(data.transpose("seed", "sbr", "background", "algorithm"), "preconditioned")
    assert error.shape == (len(SBRS), len(LIGHTS), 1)
    np.testing.assert_array_equal(error[..., 0], by_light)
    np.testing.assert_allclose(errors_of(data, "preconditioned", registered=True), error / 2)


def test_difference_filter_ignores_uniform_light_and_opposes_its_neighbour():
    filters = np.zeros((2, 8, 8))
    filters[0, 3:5, 2] = -1, 1  # down
    filters[1, 3, 2:4] = -1, 1  # across
    found = row_statistics(filters)
    np.testing.assert_allclose(found.sum, 0, atol=1e-15)
    np.testing.assert_allclose(found.down, [-0.5, 0])
    np.testing.assert_allclose(found.across, [0, -0.5])
    np.testing.assert_allclose(found.opposite, 1 / 112)  # of 2 x 7 x 8 neighbouring pairs


def test_white_noise_has_neighbours_of_either_sign_and_a_flat_spectrum():
    rows = np.random.default_rng(0).normal(size=(64, 32, 32))
    found = row_statistics(rows)
    # 64 rows of 1984 pairs: five standard errors.
    assert abs(found.opposite.mean() - 0.5) < 5 * 0.5 / np.sqrt(64 * 1984)
    assert abs(found.down.mean()) < 5 / np.sqrt(64 * 992)
    frequency, power = radial_spectrum(rows, 0.01)
    assert frequency[1] == pytest.approx(1 / 0.32)
    # A ring of n coefficients over 64 rows scatters by about 1/sqrt(64 n / 2).
    np.testing.assert_allclose(power[4:], 1, atol=0.2)


def test_part_outside_a_subspace_is_found_beneath_independent_noise():
    rng = np.random.default_rng(1)
    Q = np.linalg.qr(rng.normal(size=(4000, 3)))[0]
    away = rng.normal(size=(4000, 3))
    away -= Q @ (Q.T @ away)
    within = Q @ rng.normal(size=(3, 3))
    b = within / np.linalg.norm(within) + 0.1 * away / np.linalg.norm(away)
    noisy = (b + 0.1 / np.sqrt(b.size) * rng.normal(size=b.shape) for _ in range(2))
    found = outside(Q, *(image.reshape(40, 100, 3) for image in noisy))
    assert found[0] == 1
    # One rendering alone would say 0.141; the product's error is about 0.1² / sqrt(12000).
    assert found[-1] == pytest.approx(0.1 / np.hypot(1, 0.1), rel=0.02)
