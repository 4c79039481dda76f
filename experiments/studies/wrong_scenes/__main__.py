"""Wrong scenes: all of a ruler's errors at once, calibrated away from one photograph.

Four scenes (a chair, a plate, and of laboratories of another make a shelf and a sign) are path
traced, all bounces, as their files say, under ambient light, at 60 dB. Then every number that a
ruler gave is drawn anew by the error that the file declares of it, all at once, and calibration
starts there. It knows the photograph and the file with the wrong numbers, nothing of the truth. The
hidden image is recovered by the noise-aware method with the true scene, the ruler's and the
calibrated one, by `ps.sweep`. "Loss" is in registered dB, after the shift that fits the
truth best: a monitor's shift in its plane no photograph tells. An image is in its place if this
shift gains less than 1 dB.

`--scenes` also accepts six plain scenes: boxes, plant, tripod, mesh, edges and mug. Plain Mitsuba
renders them, direct light only, and nobody tuned the calibration on them. The mug serves studies
of known pictures.

Each scene has a folder, in which the same command goes on; one of more draws computes only these.

`python -m experiments.studies.wrong_scenes --out DIR [--scenes chair,plate,shelf,sign]
[--sbr 0.5,10] [--draws 8]`
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import periscopy_sim as ps
from experiments.page import one_line_errors
from experiments.setting import SNR
from experiments.studies.wrong_scenes.plain_scenes import (
    SHOWN,
    photographed_plainly,
    plain_subjects,
)
from experiments.studies.wrong_scenes.subjects import NAMES, Photographed, photographed, subjects

if TYPE_CHECKING:
    import xarray as xr

HEADER = """\
| scene | SBR | draws | ruler, median | calibrated, median | least to most | image in its place | \
trusted | numbers within 1 and 3 standard errors |
|---|---|---|---|---|---|---|---|---|"""


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    scenes: Annotated[
        str, typer.Option(help=f"By comma, of {', '.join((*NAMES, *SHOWN))}.")
    ] = ",".join(NAMES),
    sbr: Annotated[str, typer.Option(help="Signal-to-background ratios, by comma.")] = "0.5,10",
    draws: Annotated[int, typer.Option(min=1, help="Of each scene and ratio.")] = 8,
    rendered: Annotated[
        Path | None,
        typer.Option(help="Folder of what is rendered once; OUT/rendered unless given."),
    ] = None,
) -> None:
    """Calibrate wrong scenes; print a table of what they lose."""
    with one_line_errors():
        folder = rendered or out / "rendered"
        known, rows = subjects(folder) | plain_subjects(), [HEADER]
        for name in scenes.split(","):
            if name not in known:
                raise ps.PeriscopyError(
                    f"--scenes: no scene '{name}'; there are {', '.join(known)}"
                )
            take = photographed_plainly if name in SHOWN else photographed
            ratios = [float(each) for each in sbr.split(",")]
            results = study(take(known[name], folder), ratios, draws, out / name)
            rows += rows_of(name, results)
            print("\n".join(rows), flush=True)


def study(taken: Photographed, ratios: Sequence[float], draws: int, out: Path) -> xr.Dataset:
    """Sweep a scene's photograph over what the method knows of the scene."""
    subject = taken.subject
    return ps.sweep(
        subject.at(), [subject.image], out, methods=["noise-aware"],
        ambient={subject.place: taken.ambient}, sbr=ratios, snr=[SNR],
        photograph=ps.Photograph.of(taken.signal),
        vary={"assumed": ["true", "ruler", "calibrated"], "ruler": range(draws)},
    )  # fmt: skip


def rows_of(name: str, results: xr.Dataset) -> Iterator[str]:
    """Yield a row of `HEADER`'s table for each SBR."""
    for sbr, of_sbr in results.groupby("sbr"):
        draws = of_sbr.squeeze(["sbr", "algorithm", "image", "background", "snr", "seed"])
        true, ruler, found = (draws.sel(assumed=n) for n in ("true", "ruler", "calibrated"))
        loss, cost = (true.psnr_registered - each.psnr_registered for each in (found, ruler))
        is_there = found.psnr > found.psnr_registered - 1
        yield (
            f"| {name} | {sbr:g} | {loss.size} | {float(cost.median()):.1f} "
            f"| {float(loss.median()):.1f} | {float(loss.min()):.1f} to {float(loss.max()):.1f} "
            f"| {int(is_there.sum())} | {int(found.trusted.sum())} "
            f"| {float(found.within_1.mean()):.0%}, {float(found.within_3.mean()):.0%} |"
        )


if __name__ == "__main__":
    typer.run(main)
