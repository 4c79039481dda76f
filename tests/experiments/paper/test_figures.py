import importlib

import numpy as np
import pytest

import periscopy_sim as ps
from experiments.paper.fig10 import autocorrelation, imbalance
from experiments.published.ambient import outside
from experiments.setting import GLASS, NO_BEAM, Measured, Setting
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
    def measured(self):
        truth = ps.read_hidden_image(ps.find_image(self.image), self.hidden)
        signal = (self.A @ truth.reshape(-1, 3)).reshape(SHAPE).astype(float)
        return Measured(signal, truth, "simulated")

    @property
    def adversarial(self):
        return self.backgrounds([GLASS, NO_BEAM, *(n for n in ADVERSARIAL if n != GLASS)])

    def place(self, _):
        return np.full((4, 5, 3), 0.5)


LONGER = [
    pytest.param(name, marks=pytest.mark.thorough) for name in ("fig5", "fig6", "fig9", "table1")
]


@pytest.mark.parametrize("name", ["fig3", "fig8", "fig10", *LONGER])
def test_a_figure_is_made_from_a_tiny_scene(name, tmp_path):
    section = importlib.import_module(f"experiments.paper.{name}").run(TinySetting(tmp_path))
    assert section.claims and all(claim.measured for claim in section.claims)
    assert all(picture.file.is_file() for picture in section.pictures)


def test_difference_filter_ignores_uniform_light_and_opposes_its_neighbour():
    filters = np.zeros((2, 8, 8))
    filters[0, 3:5, 2] = -1, 1  # down
    filters[1, 3, 2:4] = -1, 1  # across
    assert imbalance(filters) == pytest.approx(0, abs=1e-15)
    assert imbalance(np.abs(filters)) == 1
    assert autocorrelation(filters) == pytest.approx(
        -0.25
    )  # -0.5 along one axis, 0 along the other


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
