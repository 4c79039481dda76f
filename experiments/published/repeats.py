"""Repeats of one image: noise in time, drift, and the scatter of what is recovered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, label_row, show_light
from experiments.published.data_set import Capture
from experiments.published.layout import REPEATS
from experiments.published.setting import PublishedSetting
from experiments.published.stills import OURS, PAPER
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import FittedScene

Array = NDArray[np.float64]

LEAST = 3
"""Repeats from which the page reports scatter."""


@dataclass(frozen=True, eq=False)
class Repeated:
    """Repeats of one image.

    Attributes
    ----------
    folder
        Of the data set.
    captures
        The repeats.
    images
        (K, R, C, 3) by method; each divided by its photograph's mean, as drift is reported apart.
    of_mean
        The image of the mean photograph, by method.
    standard_errors
        (R, C, 3) as the noise-aware method tells them of the first repeat, likewise divided.
    """

    folder: str
    captures: Sequence[Capture]
    images: dict[str, Array]
    of_mean: dict[str, Array]
    standard_errors: Array

    @property
    def levels(self) -> Array:
        """(K,) means of the photographs."""
        return np.array([capture.photograph.mean() for capture in self.captures])

    @property
    def signal_to_noise(self) -> float:
        """Of one photograph, dB, by what differs between repeats once each has the same mean."""
        photographs = np.stack([capture.photograph for capture in self.captures])
        photographs /= self.levels[:, None, None, None]
        variance = photographs.var(axis=0, ddof=1).mean()
        return float(10 * np.log10(np.mean(photographs**2) / variance))

    @property
    def truth(self) -> Array | None:
        """What the monitor showed, if a file tells."""
        return next((c.truth for c in self.captures if c.truth is not None), None)


def run(setting: PublishedSetting) -> Section:
    """Reconstruct every repeat and summarize what differs."""
    found, tables = [], []
    for folder, names in REPEATS.items():
        captures = setting.readable(folder, names)
        if len(captures) >= LEAST:
            found.append(_repeated(setting.fitted(folder), folder, captures))
        tables += setting.not_read(folder, names)
    if not found:
        text = f"Fewer than {LEAST} repeats of an image can be read."
        return Section("repeats", _TITLE, text=text, tables=tables)
    _draw(setting, found)
    return Section(
        "repeats",
        _TITLE,
        text="Repeats differ by noise alone, but for drift, which is divided out. The scatter of a "
        "patch is its standard deviation over the repeats. Told standard errors also count what "
        "is alike in all repeats, what total variation does to the image and an uneven wall, so "
        "that the scatter should stay below them.",
        claims=[_claim(repeated) for repeated in found],
        pictures=[
            Picture(
                setting.out / "repeats.png",
                "The first repeat's image, that of the mean photograph, and the scatter over the "
                "repeats beside the reported standard errors (mean over the channels, % of the "
                "image's 99th percentile).",
            )
        ],
        tables=[_table(found), *tables],
    )


_TITLE = "Repeats of one image"


def _repeated(scene: FittedScene, folder: str, captures: Sequence[Capture]) -> Repeated:
    ours = scene.noise_aware
    levels = [capture.photograph.mean() for capture in captures]
    photographs = [c.photograph / level for c, level in zip(captures, levels, strict=True)]
    mean = np.mean(photographs, axis=0)
    methods = {OURS: ours, PAPER: scene.preconditioned}
    return Repeated(
        folder,
        captures,
        {name: np.stack([m.reconstruct(y) for y in photographs]) for name, m in methods.items()},
        {name: np.asarray(m.reconstruct(mean), np.float64) for name, m in methods.items()},
        ours.standard_errors(ours.solve(photographs[0])),
    )


def _claim(repeated: Repeated) -> Claim:
    decibels = repeated.signal_to_noise
    return Claim(
        f"signal-to-noise ratio of a photograph ({repeated.folder})",
        "60 dB, similar to that of the experimental data",
        f"{decibels:.1f} dB",
        Verdict.of(abs(decibels - 60) < 3),
        f"Root mean square over the standard deviation in time, {len(repeated.captures)} repeats.",
    )


def _table(found: Sequence[Repeated]) -> Table:
    def cells(repeated: Repeated, method: str) -> tuple[str, ...]:
        images, truth = repeated.images[method], repeated.truth
        scatter = images.std(axis=0, ddof=1)
        scale = np.percentile(repeated.of_mean[method], 99)
        ratio = ""
        if method == OURS:
            ratio = f"{np.sqrt(np.mean(scatter**2) / np.mean(repeated.standard_errors**2)):.2f}"
        quality = ("", "")
        if truth is not None:
            each = [ps.registered(image, truth).psnr for image in images]
            best = ps.registered(repeated.of_mean[method], truth).psnr
            quality = (f"{np.mean(each):.2f} ± {np.std(each, ddof=1):.2f}", f"{best:.2f}")
        return (f"{100 * np.sqrt(np.mean(scatter**2)) / scale:.2f}", ratio, *quality)

    return Table(
        "Drift: standard deviation of the photographs' means, %; scatter of a patch, root mean "
        "square, % of the image's 99th percentile, and over the reported standard errors; PSNR in "
        "dB, shifted, mean and standard deviation over the repeats, and of the mean photograph.",
        (
            "folder", "repeats", "drift", "method", "scatter", "over reported", "PSNR",
            "of the mean",
        ),
        [
            (
                repeated.folder,
                str(len(repeated.captures)),
                f"{100 * repeated.levels.std(ddof=1) / repeated.levels.mean():.3f}",
                method,
                *cells(repeated, method),
            )
            for repeated in found
            for method in repeated.images
        ],
    )  # fmt: skip


def _draw(setting: PublishedSetting, found: Sequence[Repeated]) -> None:
    with drawn(setting.out, "repeats", PAGE, 1.6 * len(found)) as figure:
        axes = figure.subplots(len(found), 4, squeeze=False)
        for row, repeated in zip(axes, found, strict=True):
            label_row(row[0], repeated.folder)
            show_light(row[0], repeated.images[OURS][0])
            show_light(row[1], repeated.of_mean[OURS])
            percent = 100 / np.percentile(repeated.of_mean[OURS], 99)
            scatter = percent * repeated.images[OURS].std(axis=0, ddof=1).mean(axis=2)
            errors = percent * repeated.standard_errors.mean(axis=2)
            for ax, values in ((row[2], scatter), (row[3], errors)):
                image = ax.imshow(values, vmin=0, vmax=max(scatter.max(), errors.max()))
                ax.set_axis_off()
            figure.colorbar(image, ax=list(row[2:]), shrink=0.8)
        titles = ("first repeat", "mean photograph", "scatter", "standard errors")
        for ax, title in zip(axes[0], titles, strict=True):
            ax.set_title(title)
