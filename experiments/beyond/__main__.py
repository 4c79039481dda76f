"""Measure the noise-aware method, which goes beyond the paper.

`python -m experiments.beyond --out DIR [--only noise_aware] [--real FILE.npz]` writes `index.html`
and `claims.json`.
"""

import typer

from experiments.page import Page

PAGE = Page(
    package="experiments.beyond",
    title="Beyond the paper: the noise-aware method",
    introduction="The paper states none of these numbers. Times are of this run's machine; other "
    "load on it lengthens them. The provenance is that of the last run in this folder.",
    names=("noise_aware", "noise_aware_video"),
    stated="asked",
)

if __name__ == "__main__":
    typer.run(PAGE.command())
