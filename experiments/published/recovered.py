"""Hidden images by several methods, beside what the monitor showed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import periscopy_sim as ps
from experiments.published.setting import Capture
from experiments.report import Picture, Table
from periscopy_sim.figures.panels import displayable, draw_panels
from periscopy_sim.numerics import Array

OURS, PAPER, NATURE = "noise-aware", "the paper's", "[15], converged"

DECIBELS = (
    "PSNR in dB, gain-matched, unshifted and after the best shift of at most 2 patches, by method."
)


@dataclass(frozen=True, eq=False)
class Recovered:
    """A capture and the hidden image by each method.

    Attributes
    ----------
    capture
        The capture.
    truth
        (R, C, 3) what the monitor showed; None if no file tells.
    images
        (R, C, 3) by the method's name.
    numbers
        What else the table has, by column.
    """

    capture: Capture
    truth: Array | None
    images: Mapping[str, Array]
    numbers: Mapping[str, str]

    def psnrs(self, method: str) -> str:
        """Return a method's PSNR unshifted and after the best shift, in dB, as text."""
        if self.truth is None or method not in self.images:
            return "not known"
        image = self.images[method]
        best = ps.registered(image, self.truth)
        return f"{ps.psnr_gain_matched(image, self.truth):.1f} / {best.psnr:.1f}"


def table(title: str, recovered: Sequence[Recovered]) -> Table:
    """Return the PSNR of every capture by every method."""
    first = recovered[0]
    return Table(
        f"{title}: {DECIBELS}",
        ("capture", *first.numbers, *first.images),
        [
            (one.capture.name, *one.numbers.values(), *map(one.psnrs, first.images))
            for one in recovered
        ],
    )


def picture(out: Path, title: str, recovered: Sequence[Recovered]) -> Picture:
    """Draw captures below each other: photograph, truth, and the image by each method."""
    rows = {}
    for one in recovered:
        panels = [("photograph", displayable(one.capture.photograph))]
        if one.truth is not None:
            panels.append(("shown", displayable(one.truth, 1)))
        for method, image in one.images.items():
            matched = displayable(image) if one.truth is None else ps.gain_matched(image, one.truth)
            panels.append((method.replace(", ", ",\n"), matched))
        rows[one.capture.name] = panels
    file = out / f"{title.replace(' ', '_')}.png"
    file.parent.mkdir(parents=True, exist_ok=True)
    draw_panels(file, rows)
    return Picture(
        file,
        f"{title}: photographs (white: the 99.5th percentile of each), what the monitor showed, "
        "and the images, gain-matched where that is known.",
    )
