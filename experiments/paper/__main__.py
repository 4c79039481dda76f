"""Reproduce every figure and table of the paper, each claim beside what was measured.

`python -m experiments.paper --out DIR [--only fig4,table1] [--real FILE.npz]` writes `index.html`
and `claims.json`.
"""

import typer

from experiments.page import Page

PAGE = Page(
    package="experiments.paper",
    title="Fast computational periscopy in challenging ambient light, reproduced",
    introduction="This page compares each claim of the paper with this package's measurement, and "
    "explains the differences. Times are of this run's machine; other load on it lengthens them. "
    "The provenance is that of the last run in this folder.",
    names=(
        "fig3", "fig4", "fig5", "fig6", "fig7", "fig8", "fig9", "fig10", "table1", "numbers",
    ),
)  # fmt: skip

if __name__ == "__main__":
    typer.run(PAGE.command())
