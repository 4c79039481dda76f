"""Reconstruct hidden worlds other than a monitor.

`python -m experiments.worlds --out DIR` writes `index.html`, `claims.json` and the pictures. What
is rendered stays in DIR: the next run goes on from there.
"""

from dataclasses import dataclass

import typer

from experiments.page import Out, Page

PAGE_OF_WORLDS = Page(
    package="experiments.worlds",
    title="Hidden worlds other than a monitor",
    introduction="Plain Mitsuba renders the photographs; the reconstruction knows the scene file.",
    names=("worlds",),
    stated="asked",
)


@dataclass(frozen=True)
class Folder:
    """The inputs: a folder and a seed."""

    out: Out
    seed: int = 0

    def identity(self) -> bytes:
        """Return nothing: there is no other input."""
        return b""


def main(out: Out) -> None:
    """Photograph and reconstruct every world, and write the page."""
    PAGE_OF_WORLDS.carry_out("", lambda: Folder(out))


if __name__ == "__main__":
    typer.run(main)
