"""What more photographs of a laboratory bring, and what a known picture does.

The scenes are those of `wrong_scenes`, path traced, with all of a ruler's errors at once, at 60 dB.
`ps.calibrate` gets the first of 1, 2, 4 and 8 photographs, of pictures that it does not know and of
the same ambient light; or one photograph of `blocks`, which it knows. The image of the first
photograph is then recovered, which the one of `blocks` is not. "Loss" is what the true scene has
more: in dB after the best shift, which uses the truth; by a known picture without a shift.

`python -m experiments.studies.more_photographs --out DIR [--scenes chair,plate] [--draws 3]
[--sbr 0.5] [--rendered DIR]`
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from experiments.page import processor_seconds
from experiments.setting import SNR
from experiments.studies.wrong_scenes.subjects import (
    Photographed,
    path_traced,
    photographed,
    subjects,
)
from periscopy_sim.numerics import Array
from periscopy_sim.storage.outputs import staged_file

COUNTS = 1, 2, 4, 8
PICTURES = "mushroom", "letters", "digits", "still_life", "bars", "siemens", "sunset", "checker"
KNOWN = "blocks"
SAMPLES = 4096
"""Paths a pixel of each of two renderings of each further picture."""

HEADER = """\
| scene | photographs | within 3 standard errors | determined | median error | rms error | \
median standard error | loss, dB | processor seconds |
|---|---|---|---|---|---|---|---|---|"""
"""Errors are over the measurement errors."""


def cases(first: Photographed, sbr: float, draw: int, folder: Path) -> Iterator[dict[str, Any]]:
    """Calibrate from each number of photographs at an SBR, and from a known picture."""
    subject = first.subject
    names = [subject.image, *(name for name in PICTURES if name != subject.image), KNOWN]
    rougher, given = replace(subject, samples=SAMPLES), []
    for number, name in enumerate(names):
        signal = path_traced(rougher, name, folder, 100 + 2 * number) if number else first.signal
        clean = ps.composite(signal, first.ambient, sbr)
        given.append(ps.add_noise(clean, SNR, 1000 * draw + number))
    *unknown, known = given
    for count in COUNTS:
        yield _case(first, draw, unknown[:count], unknown[0], [])
    picture = subject.at().image(KNOWN)
    yield _case(first, draw, [known], unknown[0], [picture])


def _case(
    first: Photographed, draw: int, given: list[Array], photograph: Array, shown: list[Array]
) -> dict[str, Any]:
    """Calibrate by photographs, and compare numbers and the image of one with the true ones."""
    subject, begun = first.subject, processor_seconds()
    parameters: dict[str, str | float] = {**subject.parameters, **subject.measured(draw)}
    result = ps.calibrate(given, subject.scene, subject.hidden, shown=shown, parameters=parameters)
    seconds = processor_seconds() - begun

    def psnr(scene: ps.Scenario) -> float:
        image = scene.method("noise-aware", errors={}).reconstruct(photograph)
        if shown:
            return ps.psnr_gain_matched(image, first.truth)
        return ps.registered(image, first.truth).psnr

    true = dict(zip(subject.errors, subject.true_values, strict=True))
    numbers = result.parameters
    return {
        "scene": subject.name,
        "draw": draw,
        "photographs": f"`{KNOWN}`, known" if shown else str(len(given)),
        "error": [abs(each.value - true[each.name]) / each.ruler_error for each in numbers],
        "standard_error": [each.standard_error / each.ruler_error for each in numbers],
        "determined": [each.determined for each in numbers],
        "loss": psnr(subject.at()) - psnr(subject.at(result.values)),
        "trusted": result.trusted,
        "seconds": seconds,
    }


def row(draws: Sequence[dict[str, Any]]) -> str:
    """Return the draws of a scene and a kind of photographs as a row of `HEADER`'s table."""
    error, standard_error, determined = (
        np.concatenate([case[key] for case in draws])
        for key in ("error", "standard_error", "determined")
    )
    losses = ", ".join(f"{case['loss']:.1f}" for case in draws)
    seconds = [case["seconds"] for case in draws]
    return (
        f"| {draws[0]['scene']} | {draws[0]['photographs']} "
        f"| {np.sum(error <= 3 * standard_error)} of {len(error)} "
        f"| {determined.sum():.0f} | {np.median(error):.2f} | {np.sqrt(np.mean(error**2)):.2f} "
        f"| {np.median(standard_error):.2f} | {losses} | {min(seconds):.0f} to {max(seconds):.0f} |"
    )


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    scenes: Annotated[str, typer.Option(help="By comma.")] = "chair,plate",
    draws: Annotated[int, typer.Option(min=1, help="Of a ruler's errors, of each scene.")] = 3,
    sbr: Annotated[float, typer.Option(help="Signal-to-background ratio.")] = 0.5,
    rendered: Annotated[
        Path | None,
        typer.Option(help="Folder of what is rendered once; OUT/rendered unless given."),
    ] = None,
) -> None:
    """Calibrate from several photographs and from a known picture; print the table, write JSON."""
    folder = rendered or out / "rendered"
    subject, done = subjects(folder), list[dict[str, Any]]()
    for name in scenes.split(","):
        first = photographed(subject[name], folder)
        for draw in range(draws):
            for case in cases(first, sbr, draw, folder):
                done.append(case)
                print(row([case]), flush=True)
                with staged_file(out / "more_photographs.json") as staged:
                    staged.write_text(json.dumps(done, indent=1), "utf-8")
    print(HEADER)
    for kind in dict.fromkeys((case["scene"], case["photographs"]) for case in done):
        print(row([case for case in done if (case["scene"], case["photographs"]) == kind]))


if __name__ == "__main__":
    typer.run(main)
