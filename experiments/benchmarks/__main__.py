"""Measure how fast the package is: ratios to other libraries and to the machine's limits.

`python -m experiments.benchmarks --out DIR [--only stills,scale]` writes `index.html`,
`claims.json` and the plot of cost against size. Absolute times belong to one machine; the ratios,
measured in one run, carry over. One runs only when named: `--only live` needs a browser.
"""

import typer

from experiments.benchmarks.learned import learned
from experiments.benchmarks.live import live
from experiments.benchmarks.machine_limits import machine
from experiments.benchmarks.operators import operators
from experiments.benchmarks.scale import scale, transport
from experiments.benchmarks.stills import denoising, stills, video
from experiments.page import Experiment, Page

BENCHMARKS: dict[str, Experiment] = {
    "machine": machine,
    "stills": stills,
    "denoising": denoising,
    "scale": scale,
    "video": video,
    "transport": transport,
    "operators": operators,
    "learned": learned,
    "live": live,
}

PAGE = Page(
    package="experiments.benchmarks",
    title="Speed",
    introduction="Medians of several runs on one machine.",
    names=tuple(BENCHMARKS),
    stated="asked",
    functions=BENCHMARKS,
    on_demand=("live",),
)

if __name__ == "__main__":
    typer.run(PAGE.command())
