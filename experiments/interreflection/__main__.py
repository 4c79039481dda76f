"""Measure light that bounces: three rooms, A f beside path-traced photographs, what methods lose.

`python -m experiments.interreflection --out DIR [--only agreement,cost]` writes `index.html` and
`claims.json`.
"""

from __future__ import annotations

from typing import Annotated

import typer

from experiments.interreflection.rooms import Workplace
from experiments.page import Out, Page, Rendered

PAGE = Page(
    package="experiments.interreflection",
    title="Light that bounces",
    introduction="The monitor also lights what stands about the wall, and that lights the wall. "
    "Shares are of a white image's photograph. Times are of this run's machine; other load on it "
    "lengthens them.",
    names=("agreement", "cost", "calibration"),
    stated="asked",
)


def main(out: Out, only: Annotated[str, PAGE.choice()] = "", rendered: Rendered = None) -> None:
    """Measure light that bounces, and write the page."""
    PAGE.carry_out(only, lambda: Workplace(out, rendered or out / "rendered"))


if __name__ == "__main__":
    typer.run(main)
