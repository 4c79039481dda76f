"""Figures of the paper, run on a scene of few pixels and ambient light of far lamps."""

import importlib

import numpy as np
import pytest

import periscopy_sim as ps
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
