"""Time and memory of the noise-aware method against the number of patches, to 120 x 120.

Each grid has a process of its own, whose largest memory counts.
"""

import json
import subprocess
import sys
from functools import partial
from typing import Any

import numpy as np

import periscopy_sim as ps
from experiments.benchmarks.scene import photographs_of, seconds_text
from experiments.report import Claim, Section, Table, Verdict
from experiments.setting import Setting, chair
from experiments.timing import clocked
from periscopy_sim.model.spectral_basis import MOST_PATTERNS, SpectralBasis

GRIDS = (15, 18), (29, 36), (36, 45), (54, 68), (72, 90), (120, 120)

LARGEST_OF_TABLE_1 = 72, 90
"""The grid that all patterns are computed for, too: eigenvectors of 6,480 x 6,480, a minute."""

WITHIN = 0.2
"""Standard errors that an image may differ by from that of all patterns."""


def fine_grids(_: Setting) -> Section:
    """Measure each grid in a process of its own."""
    rows = {grid: _measured("{}x{}".format(*grid)) for grid in GRIDS}
    off = rows[LARGEST_OF_TABLE_1]["off"]
    return Section(
        "fine-grids",
        "Fine grids, chair, 126 x 126 pixels",
        text=f"Above {MOST_PATTERNS} patches the method computes as many patterns.",
        claims=[
            Claim(
                f"image of {MOST_PATTERNS} patterns against that of all, 72 x 90 patches",
                f"within {WITHIN:g} standard errors",
                f"{off:.2f} at most",
                Verdict.of(off <= WITHIN),
                "Chair, SBR 0.5, 60 dB.",
            )
        ],
        tables=[
            Table(
                "Seconds of each stage, and the largest memory of the process; A alone takes "
                "64 kB a patch.",
                ("patches", "A", "fit", "still", "standard errors", "GB"),
                [
                    (
                        f"{grid[0] * grid[1]:,}",
                        *(seconds_text(row[stage]) for stage in ("A", "fit", "still", "errors")),
                        f"{row['memory']:.2f}",
                    )
                    for grid, row in rows.items()
                ],
            )
        ],
    )


def _measured(grid: str) -> dict[str, Any]:
    """Return a grid's numbers, as a process of its own prints them."""
    command = [sys.executable, "-m", __name__, grid]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    numbers: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return numbers


def measure(grid: tuple[int, int]) -> dict[str, Any]:
    """Return the seconds of each stage at a grid, the memory, and how far the image is off."""
    import resource

    scene = chair(grid, light=ps.Light())
    transport, A = clocked(scene.scenario.transport)
    (photograph,) = photographs_of(scene, 1)
    method = ps.NoiseAware.for_scene(scene.scenario, A, scene.B)
    fit, _ = clocked(method.prepare)
    method.solve(photograph)  # compiles
    still, solution = clocked(partial(method.solve, photograph), 21)
    errors, deviation = clocked(partial(method.standard_errors, solution))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    off = None
    if grid == LARGEST_OF_TABLE_1:
        whole = ps.NoiseAware.for_scene(scene.scenario, A, scene.B)
        gram = whole.fit.operator.gram / whole.fit.unit**2
        vars(whole.fit)["patterns"] = SpectralBasis.of_gram(gram, whole.hidden)
        off = float(np.abs((whole.solve(photograph).image - solution.image) / deviation).max())
    seconds = {"A": transport, "fit": fit, "still": still, "errors": errors}
    return {**seconds, "memory": memory, "off": off}


if __name__ == "__main__":
    rows, columns = map(int, sys.argv[1].split("x"))
    print(json.dumps(measure((rows, columns))))
