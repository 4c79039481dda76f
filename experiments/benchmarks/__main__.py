"""Measure what fine grids, data sets and streams cost.

`python -m experiments.benchmarks --out DIR [--only fine-grids,watch]` writes `index.html` and
`claims.json`. Times belong to one machine.
Two run only when named: `--only watch` needs a browser, `--only scale` takes minutes on worker
processes. Videos are timed by `python -m experiments.paper --only fig7` and
`python -m experiments.beyond --only noise_aware_video`.
"""

import typer

from experiments.benchmarks.fine_grids import fine_grids
from experiments.benchmarks.scale import scale
from experiments.benchmarks.watch import watch
from experiments.page import Experiment, Page

BENCHMARKS: dict[str, Experiment] = {
    "fine-grids": fine_grids,
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
    on_demand=("scale", "watch"),
)

if __name__ == "__main__":
    typer.run(PAGE.command())
