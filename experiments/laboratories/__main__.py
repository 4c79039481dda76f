"""Photograph stand-in laboratories.

`python -m experiments.laboratories --out DIR [--only lamp,plate]`
"""

from pathlib import Path
from typing import Annotated

import typer

from experiments.laboratories.making.laboratories import LABORATORIES


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    only: Annotated[
        str, typer.Option(help=f"These alone, by comma: {', '.join(LABORATORIES)}.")
    ] = "",
) -> None:
    """Render the stand-in laboratories."""
    from experiments.laboratories.making.render import make

    for name in only.split(",") if only else LABORATORIES:
        print(f"wrote {make(LABORATORIES[name], out)}", flush=True)


if __name__ == "__main__":
    typer.run(main)
