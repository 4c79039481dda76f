"""Calibration, which takes light for direct, where light bounces and where it does not.

The chair of the bright room stands 4 to 6 mm from where its file has it. The photograph is by
another rendering of A, at 60 dB under an overcast sky, without bounces and with all.

`python -m experiments.interreflection --out DIR --only calibration`
"""

from __future__ import annotations

import numpy as np

import periscopy_sim as ps
from experiments.interreflection.rooms import BRIGHT, Workplace, both_matrices, photograph
from experiments.page import described
from experiments.report import Section, Table
from experiments.setting import SNR
from periscopy_sim.cli.ambient import ambient_photographs

HIDDEN = (29, 36)
MOVED = {"occluder_dx": 0.005, "occluder_dy": -0.004, "occluder_dz": 0.006}
SBRS = (0.5, 10.0)
PLACE = "overcast"


def run(place: Workplace) -> Section:
    """Calibrate the chair's place by each photograph."""
    scenario = ps.load_scenario(BRIGHT.scene, HIDDEN, MOVED)
    truth = BRIGHT.shown(HIDDEN)
    matrices = both_matrices(scenario, place.seed + 1, samples=64, pixel_samples=4)
    # The same wherever the chair stands.
    wall = BRIGHT.at(HIDDEN)
    light = ambient_photographs([PLACE], wall, place.rendered, place.seed)[PLACE]
    rows = []
    for words, A in zip(("nothing bounces", "all bounces"), matrices, strict=True):
        signal = photograph(scenario, A, truth)
        for sbr in SBRS:
            y = ps.add_noise(ps.composite(signal, light, sbr), SNR, place.seed)
            found = ps.calibrate(y, BRIGHT.scene, HIDDEN, free=list(MOVED))
            off = [1e3 * (found.values[name] - true) for name, true in MOVED.items()]
            told = [1e3 * parameter.standard_error for parameter in found.parameters]
            rows.append(
                (
                    words,
                    f"{sbr:g}",
                    ", ".join(f"{value:+.2f}" for value in off),
                    ", ".join(f"{value:.2f}" for value in told),
                    f"{np.max(np.abs(np.divide(off, told))):.1f}",
                    f"{np.ptp(found.gain):.2f}",
                    "yes" if found.trusted else "no",
                )
            )
    header = ("photograph", "SBR", "off in x, y, z, mm", "told errors, mm", "farthest, told errors",
              "found gain, range", "trusted")  # fmt: skip
    return Section(
        name="calibration",
        title="Calibration where light bounces",
        text=described(__doc__),
        tables=[Table("The chair's place, 4 to 6 mm off at the start.", header, rows)],
    )
