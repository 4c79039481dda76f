"""Time and memory of the noise-aware method against the number of patches, to 120 x 120.

Each grid has a process of its own, whose largest memory counts.
"""

from __future__ import annotations

import json
import subprocess
import sys
from functools import partial
from typing import Any

import numpy as np

import periscopy_sim as ps
from experiments.benchmarks.scene import photographs_of, seconds_text
from experiments.drawing import PAGE, drawn
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import Chair, Setting
from experiments.timing import clocked
from periscopy_sim.model.spectral_basis import MOST_PATTERNS, SpectralBasis

GRIDS = (15, 18), (29, 36), (36, 45), (54, 68), (72, 90), (120, 120)

LARGEST_OF_TABLE_1 = 72, 90
"""The grid that all patterns are computed for, too: eigenvectors of 6,480 x 6,480, a minute."""

GOALS = {(29, 36): {"still": 0.02}, LARGEST_OF_TABLE_1: {"fit": 20.0, "still": 0.2}}
"""Seconds, on two idle cores."""

WITHIN = 0.2
"""Standard errors that an image may differ by from that of all patterns."""


def fine_grids(setting: Setting) -> Section:
    """Measure each grid, and draw time and memory against the patches."""
    rows = [_measured(grid) for grid in GRIDS]
    claims = []
    for grid, row in zip(GRIDS, rows, strict=True):
        for stage, goal in GOALS.get(grid, {}).items():
            took = row[stage]
            claims.append(
                Claim(
                    f"{stage}, {grid[0]} x {grid[1]} patches",
                    f"at most {seconds_text(goal)}",
                    seconds_text(took),
                    Verdict.of(took <= goal),
                )
            )
        if (off := row["off"]) is not None:
            claims.append(
                Claim(
                    f"image of {MOST_PATTERNS} patterns against that of all, "
                    f"{grid[0]} x {grid[1]} patches",
                    f"within {WITHIN:g} standard errors",
                    f"{off:.2f} at most",
                    Verdict.of(off <= WITHIN),
                    "Chair, SBR 0.5, 60 dB.",
                )
            )
    return Section(
        "fine-grids",
        "Fine grids, chair, 126 x 126 pixels",
        claims=claims,
        pictures=[_draw(setting, rows)],
        tables=[
            Table(
                "Seconds of each stage, and the largest memory of the process",
                ("patches", "A", "fit", "still", "standard errors", "GB"),
                [
                    (
                        f"{row['patches']:,}",
                        *(seconds_text(row[stage]) for stage in ("A", "fit", "still", "errors")),
                        f"{row['memory']:.2f}",
                    )
                    for row in rows
                ],
            )
        ],
    )


def _draw(setting: Setting, rows: list[dict[str, Any]]) -> Picture:
    patches = [row["patches"] for row in rows]
    with drawn(setting.out, "fine_grids", PAGE, 2.6) as figure:
        seconds, memory = figure.subplots(1, 2)
        for stage, label in {"fit": "fit", "errors": "standard errors", "still": "still"}.items():
            seconds.loglog(patches, [row[stage] for row in rows], "o-", label=label)
        seconds.set(xlabel="patches N", ylabel="seconds")
        seconds.legend()
        memory.loglog(patches, [row["memory"] for row in rows], "o-", label="whole process")
        matrix = [4e-9 * row["pixels"] * row["patches"] for row in rows]
        memory.loglog(patches, matrix, "--", label="A alone")
        memory.set(xlabel="patches N", ylabel="largest memory, GB")
        memory.legend()
        for axis in (each for ax in (seconds, memory) for each in (ax.xaxis, ax.yaxis)):
            axis.set_major_formatter("{x:,g}")  # the style shows no powers
    return Picture(
        setting.out / "fine_grids.png",
        f"Time and memory of the noise-aware method; above {MOST_PATTERNS} patches, of as many "
        "patterns.",
    )


def _measured(grid: tuple[int, int]) -> dict[str, Any]:
    """Return a grid's numbers, as a process of its own prints them."""
    command = [sys.executable, "-m", __name__, "{}x{}".format(*grid)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    numbers: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return numbers


def measure(grid: tuple[int, int]) -> dict[str, Any]:
    """Return the seconds of each stage at a grid, the memory, and how far the image is off."""
    import resource

    scene = Chair(grid)
    transport, A = clocked(partial(ps.transport, scene.scenario))
    scene.A = A
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
    return {
        "patches": A.shape[1], "pixels": A.shape[0], "A": transport, "fit": fit, "still": still,
        "errors": errors, "memory": memory, "off": off,
    }  # fmt: skip


if __name__ == "__main__":
    rows, columns = map(int, sys.argv[1].split("x"))
    print(json.dumps(measure((rows, columns))))
