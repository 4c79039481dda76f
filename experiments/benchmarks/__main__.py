"""Measure how fast the package is, beside another library.

`python -m experiments.benchmarks --out DIR [--only stills,denoising]` writes `index.html` and
`claims.json`. Absolute times belong to one machine; the ratios, measured in one run, carry over.
Three run only when named: `--only live` and `--only watch` need a browser, `--only scale` takes
minutes on worker processes. Videos are timed by `python -m experiments.paper --only fig7` and
`python -m experiments.beyond --only noise_aware_video`.
"""

import typer

from experiments.benchmarks.fine_grids import fine_grids
from experiments.benchmarks.live import live
from experiments.benchmarks.scale import scale
from experiments.benchmarks.stills import denoising, stills
from experiments.benchmarks.watch import watch
from experiments.page import Experiment, Page

BENCHMARKS: dict[str, Experiment] = {
    "stills": stills,
    "denoising": denoising,
    "fine-grids": fine_grids,
    "live": live,
    "scale": scale,
    "watch": watch,
}

PAGE = Page(
    package="experiments.benchmarks",
    title="Speed",
    introduction="Medians of several runs on one machine.",
    names=tuple(BENCHMARKS),
    stated="asked",
    functions=BENCHMARKS,
    on_demand=("live", "scale", "watch"),
)

if __name__ == "__main__":
    typer.run(PAGE.command())
