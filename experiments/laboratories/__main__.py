"""What the package's commands make of laboratories that it did not render.

`python -m experiments.laboratories --out DIR [--only lamp,plate] [--rulers 1]` photographs the
stand-ins into OUT/rendered, unless they are there, and takes each the way that a user goes: the
photograph as it comes before the scene as a ruler gives it, `prepare` with points of the wall, a
photograph with the monitor off, `calibrate`. `index.html` shows the picture after each.
"""

from functools import partial
from typing import Annotated

import typer

from experiments.laboratories.making.laboratory import LABORATORIES
from experiments.laboratories.stages import Workplace, run
from experiments.page import Out, Page, Rendered

PAGE = Page(
    package="experiments.laboratories",
    title="Laboratories that nobody here rendered with this package",
    introduction="Stand-ins for real laboratories: plain Mitsuba and Dr.Jit, light that bounces up "
    "to six times, uneven paint, posters, a camera's lens and noise, a ruler's errors of 1 cm and "
    "2 degrees. The commands see what a user has; the truth is only compared with.",
    names=tuple(LABORATORIES),
    stated="asked",
    functions={name: partial(run, laboratory) for name, laboratory in LABORATORIES.items()},
)


def main(
    out: Out,
    only: Annotated[str, PAGE.choice()] = "",
    rulers: Annotated[int, typer.Option(help="Persons who measure each.", min=1, max=4)] = 4,
    rendered: Rendered = None,
) -> None:
    """Photograph laboratories, take each the way that a user goes, and write the page."""
    PAGE.carry_out(only, lambda: Workplace(out, rendered or out / "rendered", rulers))


if __name__ == "__main__":
    typer.run(main)
