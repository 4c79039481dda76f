"""Every capture of the published data set: what each method makes of it, on one page.

`python -m experiments.published --out DIR [--data FOLDER] [--only stills,ambient]` writes
`index.html` and `claims.json`; FOLDER is the data set of Saunders, Murray-Bruce and Goyal, Nature
565 (2019), as its owners lay it out; `ps.fetch` downloads it by default. A file that is missing or
damaged is named on the page, and the rest goes on. `--scene SET=SCENE` gives a set, as `periscopy
fetch` names it, a scene of yours, such as one that was calibrated.
"""

from pathlib import Path
from typing import Annotated

import typer

import periscopy_sim as ps
from experiments.page import Out, Page
from experiments.published.setting import PublishedSetting, sets_of_captures

PAGE = Page(
    package="experiments.published",
    title="The published measurements",
    introduction="The raw captures of Saunders, Murray-Bruce and Goyal (Nature 565, 2019), each "
    "averaged down to the film of its scene and divided by its exposure, shutter speed times "
    "number of exposures; a black level of the sensor is not known, and taken as zero. The scenes "
    "are the shipped ones where not said otherwise, as measured by a ruler: an image may stand "
    "beside its place by a patch or two, which 'shifted' allows for. Stated values are those of "
    "the paper (Saunders and Goyal, ICCP 2021).",
    names=("stills", "repeats", "ambient", "video", "single_pixels", "rooms"),
)


def main(
    out: Out,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of the data set, or of its folder 'Data'; else it is fetched."),
    ] = None,
    only: Annotated[str, PAGE.choice()] = "",
    scene: Annotated[
        list[str] | None,
        typer.Option(help="SET=SCENE: a scene of yours for a set that 'periscopy fetch' names."),
    ] = None,
) -> None:
    """Reconstruct the published measurements and write the page."""
    PAGE.carry_out(only, lambda: PublishedSetting(out, data or _fetched(), _scenes(scene or [])))


def _fetched() -> Path:
    """Fetch every set of the collection; return its folder."""
    *_, folder = map(ps.fetch, sets_of_captures())
    return folder


def _scenes(given: list[str]) -> dict[str, str]:
    """Return scenes by set."""
    pairs = [text.partition("=") for text in given]
    for text, (name, sign, file) in zip(given, pairs, strict=True):
        if not (name and sign and file):
            raise ps.PeriscopyError(f"'{text}' names no scene for a set; write SET=SCENE")
    return {name: file for name, _, file in pairs}


if __name__ == "__main__":
    typer.run(main)
