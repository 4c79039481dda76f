"""Measure what goes beyond the paper: the noise-aware method and self-calibration.

`python -m experiments.beyond --out DIR [--only ablation] [--real FILE.npz]` writes `index.html` and
`claims.json`.
"""

import typer

from experiments.page import Page

PAGE = Page(
    package="experiments.beyond",
    title="Beyond the paper: the noise-aware method and self-calibration",
    introduction="The paper states none of these numbers. Times are of this run's machine; other "
    "load on it lengthens them. The provenance is that of the last run in this folder.",
    names=("noise_aware", "ablation", "noise_aware_video", "calibration"),
    stated="asked",
)

if __name__ == "__main__":
    typer.run(PAGE.command())
