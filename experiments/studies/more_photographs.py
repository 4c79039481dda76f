"""What more photographs of a laboratory bring, and what a known picture does.

The scenes are those of `wrong_scenes`, path traced, with all of a ruler's errors at once, at 60 dB.
`ps.calibrate` gets the first of 1, 2, 4 and 8 photographs, of pictures that it does not know and of
the same ambient light; or one photograph of `blocks`, which it knows. Another picture is then
recovered, by the first photograph. "Loss" is against the true scene: of an unknown picture
registered, which uses the truth; of a known one as it stands.

`python -m experiments.studies.more_photographs --out DIR [--scenes chair,plate] [--draws 3]`
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
from experiments.setting import SNR
from experiments.studies.wrong_scenes.outcome import fitted
from experiments.studies.wrong_scenes.subjects import Photographed, photographed, subjects
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]

COUNTS = 1, 2, 4, 8
PICTURES = "mushroom", "letters", "digits", "still_life", "bars", "siemens", "sunset", "checker"
KNOWN = "blocks"
SAMPLES = 8192
"""Paths a pixel of each further picture."""


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
        file = self.rendered / f"{subject.name}_{picture}.npy"
        if not file.exists():
            shown = ps.read_hidden_image(ps.find_image(picture), subject.hidden)
            scene = ps.load_scenario(subject.lit, subject.hidden, subject.parameters)
            seed = 100 + [*PICTURES, KNOWN].index(picture)
            light = ps.render_photograph(
                scene, shown, samples=SAMPLES, only_monitor=True, seed=seed
            )
            with staged_file(file) as staged:
                np.save(staged, light)
        return np.asarray(np.load(file))

    def photographs(self, pictures: Sequence[str], draw: int) -> list[Array]:
        """Return photographs of pictures, each with its own noise."""
        lit = [ps.composite(self.signal(name), self.first.ambient, self.sbr) for name in pictures]
        return [ps.add_noise(light, SNR, 1000 * draw + k) for k, light in enumerate(lit)]

    def cases(self, draw: int) -> Iterator[dict[str, Any]]:
        """Calibrate from each number of photographs, and from a known picture."""
        subject = self.first.subject
        names = [subject.image, *(name for name in PICTURES if name != subject.image)]
        unknown = self.photographs(names[: max(COUNTS)], draw)
        for count in COUNTS:
            yield self._case(draw, unknown[:count], unknown[0], [])
        known = self.photographs([KNOWN], draw)
        picture = ps.read_hidden_image(ps.find_image(KNOWN), subject.hidden)
        yield self._case(draw, known, unknown[0], [picture])

    def _case(
        self, draw: int, given: list[Array], other: Array, shown: list[Array]
    ) -> dict[str, Any]:
        subject, begun = self.first.subject, processor_seconds()
        parameters: dict[str, str | float] = {**subject.parameters, **subject.measured(draw)}
        result = ps.calibrate(given, subject.scene, subject.hidden, shown=shown,
                              parameters=parameters)  # fmt: skip
        seconds = processor_seconds() - begun
        values = np.array(list(result.values.values()))
        off = np.abs(values - subject.true_values)
        psnr = self._psnr(fitted(subject.at(result.values)), other, bool(shown))
        true = self._psnr(fitted(subject.at()), other, bool(shown))
        return {
            "scene": subject.name,
            "draw": draw,
            "photographs": len(given),
            "known": bool(shown),
            "off": (off / [p.ruler_error for p in result.parameters]).tolist(),
            "standard_error": [p.standard_error / p.ruler_error for p in result.parameters],
            "determined": [p.determined for p in result.parameters],
            "loss": true - psnr,
            "trusted": result.trusted,
            "seconds": seconds,
        }

    def _psnr(self, method: ps.NoiseAware, photograph: Array, stands: bool) -> float:
        image, truth = method.reconstruct(photograph), self.first.truth
        return ps.psnr(image, truth) if stands else ps.registered(image, truth).psnr


def row(cases: Sequence[dict[str, Any]]) -> str:
    """Return the draws of a scene and a kind of photographs as a line of a Markdown table."""
    off, error, told = (
        np.concatenate([case[key] for case in cases])
        for key in ("off", "standard_error", "determined")
    )
    first = cases[0]
    kind = f"known (`{KNOWN}`)" if first["known"] else str(first["photographs"])
    losses = ", ".join(f"{case['loss']:.1f}" for case in cases)
    seconds = [case["seconds"] for case in cases]
    return (
        f"| {first['scene']} | {kind} | {np.sum(off <= 3 * error)} of {len(off)} | {told.sum()} "
        f"| {np.median(off):.2f} | {np.sqrt(np.mean(off**2)):.2f} | {np.median(error):.2f} "
        f"| {losses} | {min(seconds):.0f} to {max(seconds):.0f} |"
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
    known, cases = subjects(folder), []
    for name in scenes.split(","):
        laboratory = Laboratory(photographed(known[name], folder), sbr, folder)
        for draw in range(draws):
            for case in laboratory.cases(draw):
                cases.append(case)
                print(row([case]), flush=True)
                with staged_file(out / "more_photographs.json") as staged:
                    staged.write_text(json.dumps(cases, indent=1), "utf-8")
    kinds = {(case["scene"], case["known"], case["photographs"]) for case in cases}
    for kind in sorted(kinds):
        print(row([c for c in cases if (c["scene"], c["known"], c["photographs"]) == kind]))


if __name__ == "__main__":
    typer.run(main)
