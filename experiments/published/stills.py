"""Every still without ambient light, by three methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, label_row, show_light
from experiments.published.data_set import Capture
from experiments.published.layout import STILLS
from experiments.published.setting import PublishedSetting, unexplained
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import FittedScene

Array = NDArray[np.float64]

OURS, PAPER, NATURE = "noise-aware", "the paper's", "[15], converged"
FLIPS = {
    "as stored": np.s_[:, :],
    "flipped left to right": np.s_[:, ::-1],
    "flipped up and down": np.s_[::-1, :],
    "turned by 180 degrees": np.s_[::-1, ::-1],
}


@dataclass(frozen=True, eq=False)
class Still:
    """A capture and the hidden image by each method.

    Attributes
    ----------
    capture
        The capture.
    images
        (R, C, 3) by the method's name.
    unexplained
        What scene and noise-aware image leave of the photograph, over its root mean square.
    """

    capture: Capture
    images: Mapping[str, Array]
    unexplained: float

    @property
    def truth(self) -> Array | None:
        """(R, C, 3) the hidden image; None where the file has none."""
        return self.capture.truth


def run(setting: PublishedSetting) -> Section:
    """Reconstruct every still by every method."""
    stills: list[Still] = []
    pictures, tables = [], []
    for folder, names in STILLS.items():
        found = [_still(setting.fitted(folder), c) for c in setting.readable(folder, names)]
        if found:
            file = draw(setting.out, f"stills_{folder}", found)
            pictures.append(Picture(file, f"{folder}: {_CAPTION}"))
            tables.append(_table(folder, found))
        tables += setting.not_read(folder, names)
        stills += found
    known = [still for still in stills if still.truth is not None]
    return Section(
        "stills",
        "Stills without ambient light",
        text="" if stills else "No still can be read.",
        claims=[_orientation(known), _better(known)] if known else [],
        pictures=pictures,
        tables=tables,
    )


def _still(scene: FittedScene, capture: Capture) -> Still:
    ours = scene.noise_aware
    found = ours.solve(capture.photograph)
    images = {
        OURS: found.image,
        PAPER: scene.preconditioned.reconstruct(capture.photograph),
        NATURE: scene.differencing.reconstruct(capture.photograph),
    }
    return Still(capture, images, unexplained(ours, capture.photograph, found))


def _orientation(stills: Sequence[Still]) -> Claim:
    """Say how the ground truth must be turned to agree best with the reconstructions."""
    votes = dict.fromkeys(FLIPS, 0)
    for still in stills:
        truth = _truth(still)
        best = max(
            FLIPS, key=lambda flip: ps.registered(still.images[OURS], truth[FLIPS[flip]]).psnr
        )
        votes[best] += 1
    counts = ", ".join(f"{flip}: {count}" for flip, count in votes.items() if count)
    return Claim(
        "ground truth in the orientation in which it agrees best",
        "as stored",
        f"{counts} of {len(stills)}",
        Verdict.of(max(votes, key=lambda flip: votes[flip]) == "as stored"),
        "If not, an axis of the data is read the wrong way round.",
    )


def _better(stills: Sequence[Still]) -> Claim:
    def median(method: str) -> float:
        return float(np.median([ps.registered(s.images[method], _truth(s)).psnr for s in stills]))

    return Claim(
        "median PSNR over the stills, shifted",
        "",
        ", ".join(f"{method} {median(method):.1f} dB" for method in stills[0].images),
        Verdict.MEASURED,
    )


def _truth(still: Still) -> Array:
    assert still.truth is not None
    return still.truth


def _table(folder: str, stills: Sequence[Still]) -> Table:
    methods = list(stills[0].images)

    def cells(still: Still) -> list[str]:
        if still.truth is None:
            return ["no ground truth"] + [""] * (len(methods) - 1)
        return [psnrs(image, still.truth) for image in still.images.values()]

    return Table(
        f"{folder}: unexplained by scene and noise-aware image, % of the photograph's root mean "
        "square; PSNR in dB, gain-matched, unshifted and after the best shift of at most 2 "
        "patches.",
        ("capture", "exposure", "unexplained", *methods),
        [
            (
                still.capture.name.rpartition("/")[2],
                f"{still.capture.exposure:.4g}",
                f"{100 * still.unexplained:.2f}",
                *cells(still),
            )
            for still in stills
        ],
    )


def psnrs(image: Array, truth: Array) -> str:
    """Return a PSNR unshifted and after the best shift, in dB, as text."""
    return f"{ps.psnr_gain_matched(image, truth):.1f} / {ps.registered(image, truth).psnr:.1f}"


_CAPTION = (
    "photographs (white: the 99.5th percentile), what the monitor showed, and the images, "
    "gain-matched, with their PSNR unshifted and after the best shift."
)


def draw(out: Path, name: str, stills: Sequence[Still]) -> Path:
    """Draw stills below each other: photograph, truth, and the image by each method."""
    methods = list(stills[0].images)
    with drawn(out, name, PAGE, 1.15 * len(stills) + 0.25) as figure:
        axes = figure.subplots(len(stills), 2 + len(methods), squeeze=False)
        for row, still in zip(axes, stills, strict=True):
            truth = still.truth
            label_row(row[0], still.capture.name.rpartition("/")[2].removeprefix("image_test_"))
            show_light(row[0], still.capture.photograph)
            row[1].set_axis_off()
            if truth is not None:
                show_light(row[1], truth, 1)
            for ax, image in zip(row[2:], still.images.values(), strict=True):
                if truth is None:
                    show_light(ax, image)
                else:
                    show_light(ax, ps.gain_matched(image, truth), 1)
                    ax.text(
                        0.5, -0.03, f"{psnrs(image, truth)} dB", transform=ax.transAxes,
                        ha="center", va="top", fontsize=6,
                    )  # fmt: skip
        for ax, title in zip(axes[0], ("photograph", "shown", *methods), strict=True):
            ax.set_title(title)
    return out / f"{name}.png"
