"""What more photographs of a laboratory bring, and what a known picture does.

The scenes are those of `wrong_scenes`, path traced, with all of a ruler's errors at once, at 60 dB.
`ps.calibrate` gets the first of 1, 2, 4 and 8 photographs, of pictures that it does not know and of
the same ambient light; or one photograph of `blocks`, which it knows. The image of the first
photograph is then recovered, which the one of `blocks` is not. "Loss" is what the true scene has
more: in dB after the best shift, which uses the truth; by a known picture without a shift.

`python -m experiments.studies.more_photographs --out DIR [--scenes chair,plate] [--draws 3]
[--sbr 0.5] [--rendered DIR]`
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.page import processor_seconds
from experiments.setting import SNR, kept
from experiments.studies.wrong_scenes.subjects import Photographed, photographed, subjects
from periscopy_sim.storage.outputs.provenance import scene_sha256
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]

COUNTS = 1, 2, 4, 8
PICTURES = "mushroom", "letters", "digits", "still_life", "bars", "siemens", "sunset", "checker"
KNOWN = "blocks"
SAMPLES = 8192
"""Paths a pixel of each further picture."""

HEADER = """\
| scene | photographs | within 3 standard errors | determined | median error | rms error | \
median standard error | loss, dB | processor seconds |
|---|---|---|---|---|---|---|---|---|"""
"""Errors are over the measurement errors."""


@dataclass(frozen=True, eq=False)
class Laboratory:
    """One scene whose monitor shows picture after picture, at one SBR."""

    first: Photographed
    sbr: float
    rendered: Path

    def signal(self, picture: str) -> Array:
        """Return a picture's light on the wall, path traced once."""
        subject = self.first.subject
        if picture == subject.image:
            return self.first.signal
        shown = ps.read_hidden_image(ps.find_image(picture), subject.hidden)
        scene = ps.load_scenario(subject.lit, subject.hidden, subject.parameters)
        seed = 100 + [*PICTURES, KNOWN].index(picture)

        def render() -> Array:
            return ps.render_photograph(scene, shown, samples=SAMPLES, only_monitor=True, seed=seed)

        depends = {"scene_sha256": scene_sha256(subject.lit), "size": str(subject.hidden)}
        depends |= {"samples": str(SAMPLES), "seed": str(seed)}
        return kept(self.rendered / f"{subject.name}_{picture}.exr", depends, render)

    def photograph(self, picture: str, seed: int) -> Array:
        """Return a photograph of a picture."""
        clean = ps.composite(self.signal(picture), self.first.ambient, self.sbr)
        return ps.add_noise(clean, SNR, seed)

    def cases(self, draw: int) -> Iterator[dict[str, Any]]:
        """Calibrate from each number of photographs, and from a known picture."""
        subject = self.first.subject
        names = [subject.image, *(name for name in PICTURES if name != subject.image), KNOWN]
        *unknown, known = (self.photograph(n, 1000 * draw + k) for k, n in enumerate(names))
        for count in COUNTS:
            yield self._case(draw, unknown[:count], unknown[0], [])
        picture = ps.read_hidden_image(ps.find_image(KNOWN), subject.hidden)
        yield self._case(draw, [known], unknown[0], [picture])

    def _case(
        self, draw: int, given: list[Array], first: Array, shown: list[Array]
    ) -> dict[str, Any]:
        subject, begun = self.first.subject, processor_seconds()
        parameters: dict[str, str | float] = {**subject.parameters, **subject.measured(draw)}
        result = ps.calibrate(
            given, subject.scene, subject.hidden, shown=shown, parameters=parameters
        )
        seconds = processor_seconds() - begun
        errors = np.abs(np.array(list(result.values.values())) - subject.true_values)
        found, true = (
            self._psnr(fitted(subject.at(values)), first, shift=not shown)
            for values in (result.values, None)
        )
        return {
            "scene": subject.name,
            "draw": draw,
            "photographs": len(given),
            "is_known": bool(shown),
            "error": (errors / [p.ruler_error for p in result.parameters]).tolist(),
            "standard_error": [p.standard_error / p.ruler_error for p in result.parameters],
            "determined": [p.determined for p in result.parameters],
            "loss": true - found,
            "trusted": result.trusted,
            "seconds": seconds,
        }

    def _psnr(self, method: ps.NoiseAware, photograph: Array, shift: bool) -> float:
        image, truth = method.reconstruct(photograph), self.first.truth
        return ps.registered(image, truth).psnr if shift else ps.psnr_gain_matched(image, truth)


def fitted(scene: ps.Scenario) -> ps.NoiseAware:
    """Return the noise-aware method of a scene."""
    A, B = ps.transport(scene, by="areas"), ps.point_light_backgrounds(scene)
    return ps.NoiseAware.for_scene(scene, A, B)


def row(cases: Sequence[dict[str, Any]]) -> str:
    """Return the draws of a scene and a kind of photographs as a row of `HEADER`'s table."""
    error, standard_error, determined = (
        np.concatenate([case[key] for case in cases])
        for key in ("error", "standard_error", "determined")
    )
    first = cases[0]
    kind = f"`{KNOWN}`, known" if first["is_known"] else str(first["photographs"])
    losses = ", ".join(f"{case['loss']:.1f}" for case in cases)
    seconds = [case["seconds"] for case in cases]
    return (
        f"| {first['scene']} | {kind} | {np.sum(error <= 3 * standard_error)} of {len(error)} "
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
    subject, cases = subjects(folder), []
    for name in scenes.split(","):
        laboratory = Laboratory(photographed(subject[name], folder), sbr, folder)
        for draw in range(draws):
            for case in laboratory.cases(draw):
                cases.append(case)
                print(row([case]), flush=True)
                with staged_file(out / "more_photographs.json") as staged:
                    staged.write_text(json.dumps(cases, indent=1), "utf-8")
    print(HEADER)
    kinds = {(case["scene"], case["is_known"], case["photographs"]) for case in cases}
    for kind in sorted(kinds):
        print(row([c for c in cases if (c["scene"], c["is_known"], c["photographs"]) == kind]))


if __name__ == "__main__":
    typer.run(main)
