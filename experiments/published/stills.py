"""Every still without ambient light, by three methods."""

from collections.abc import Mapping, Sequence

import numpy as np

import periscopy_sim as ps
from experiments.published.recovered import NATURE, OURS, PAPER, Recovered, picture, table
from experiments.published.setting import AMBIENT, CHAIR, PLATE, Capture, PublishedSetting
from experiments.report import Claim, Section, Verdict
from experiments.setting import FittedScene

STILLS: Mapping[str, Sequence[str]] = {
    CHAIR: ("*_mushroom", "*_bur", "*_colbar", "*_smilehat", "*_it0"),
    AMBIENT: ("*_it0",),
    PLATE: ("*",),
}
"""Captures of one image each without ambient light, by set."""


def run(setting: PublishedSetting) -> Section:
    """Reconstruct every still by every method."""
    stills, pictures, tables = list[Recovered](), [], []
    for name, patterns in STILLS.items():
        captures = setting.captures(name, *patterns)
        if captures:
            found = [_still(setting.fitted(name), capture) for capture in captures]
            pictures.append(picture(setting.out, f"stills of {name}", found))
            tables.append(table(name, found))
            stills += found
    return Section(
        "stills",
        "Stills without ambient light",
        text="" if stills else "No still can be read.",
        claims=[_medians(stills)] if any(still.truth is not None for still in stills) else [],
        pictures=pictures,
        tables=[*tables, *setting.not_read(*STILLS)],
    )


def _still(scene: FittedScene, capture: Capture) -> Recovered:
    ours, photograph = scene.noise_aware, capture.photograph
    solution = ours.solve(photograph)
    residual = ours.residual(photograph, solution)
    assert residual is not None
    images = {
        OURS: solution.image,
        PAPER: scene.preconditioned.reconstruct(photograph),
        NATURE: scene.method("differencing").reconstruct(photograph),
    }
    numbers = {"unexplained, %": f"{100 * residual.unexplained:.2f}"}
    return Recovered(capture, capture.truth, images, numbers)


def _medians(stills: Sequence[Recovered]) -> Claim:
    psnrs = {
        method: [
            ps.registered(still.images[method], still.truth).psnr
            for still in stills
            if still.truth is not None
        ]
        for method in (OURS, PAPER, NATURE)
    }
    medians = (f"{method} {np.median(each):.1f} dB" for method, each in psnrs.items())
    what = "median PSNR over the stills, after the best shift"
    return Claim(what, "", ", ".join(medians), Verdict.MEASURED)
