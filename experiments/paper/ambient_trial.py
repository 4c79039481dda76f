"""Rendered backgrounds, each of them twice, and the photographs that are taken in them."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.setting import AMBIENT_ERROR, SNR, Setting
from periscopy_sim.model.ambient import background_basis
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC
from periscopy_sim.storage.ambient_library import ambient_photographs
from periscopy_sim.storage.formats.exr import read_exr

Array = NDArray[np.float64]
SBR = 0.2


class Trial:
    """Two independent renderings of each background, and the photographs taken in the first."""

    def __init__(self, setting: Setting) -> None:
        self.scenario = setting.scenario
        self.A = setting.A.astype(np.float64)
        self.seed = setting.seed
        self.basis = background_basis(setting.B)
        second = setting.rendered / "second"
        second.mkdir(exist_ok=True)
        names = (*REALISTIC, *ADVERSARIAL)
        self.backgrounds = setting.backgrounds(names)
        self.again = ambient_photographs(
            names, self.scenario, second, self.seed + 1, target=AMBIENT_ERROR
        )
        # The part of the first rendering in the two's squared difference, but for its square.
        errors = {
            name: [
                float(read_exr(folder / f"{name}.exr")[1]["relative_error"])
                for folder in (setting.rendered, second)
            ]
            for name in names
        }
        self.share = {name: e[0] / np.hypot(e[0], e[1]) for name, e in errors.items()}
        self.measured = {"synthetic": setting.synthetic}
        if setting.measured.real:
            self.measured["real"] = setting.measured
        self.photographs = {
            (kind, name): ps.add_noise(ps.composite(m.signal, b, SBR), SNR, self.seed + number)
            for kind, m in self.measured.items()
            for number, (name, b) in enumerate(self.backgrounds.items())
        }

    def rejected(self, photograph: Array) -> Array:
        """Project the paper's B out of a photograph: (rows, columns, 3)."""
        b = photograph.reshape(-1, 3)
        return np.asarray((b - self.basis @ (self.basis.T @ b)).reshape(photograph.shape))

    @cached_property
    def noise(self) -> dict[str, float]:
        """Noise of one rendering outside the paper's B, in percent of the background's norm."""
        return {
            name: percent(self.rejected(b - self.again[name]) * self.share[name], b)
            for name, b in self.backgrounds.items()
        }

    @cached_property
    def shifts(self) -> dict[str, tuple[float, float]]:
        """How a reconstruction is moved onto the truth: a real monitor's place is inexact."""
        periscope = self.periscope(self.basis)
        return {
            kind: ps.registered(periscope.reconstruct(m.signal), m.truth).shift
            if m.real
            else (0.0, 0.0)
            for kind, m in self.measured.items()
        }

    @cached_property
    def bound(self) -> float:
        """Summed Cramér-Rao bounds with A alone."""
        return float(ps.form_preconditioner(self.A).noise_gain.sum())

    def periscope(self, basis: Array) -> ps.Periscope:
        """Fit the paper's method to a basis of B."""
        return ps.Periscope.for_scene(self.scenario, self.A, basis, explicit=False)


def percent(part: Array, whole: Array) -> float:
    """Norm of a part in percent of the whole's."""
    return 100 * float(np.linalg.norm(part) / np.linalg.norm(whole))
