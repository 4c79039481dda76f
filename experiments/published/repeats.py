"""Repeats of one image: noise in time, drift, and the scatter of what is recovered."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import periscopy_sim as ps
from experiments.published.recovered import OURS, PAPER
from experiments.published.setting import REPEATS, Capture, PublishedSetting
from experiments.report import Claim, Section, Table, Verdict
from experiments.setting import FittedScene
from periscopy_sim.numerics import Array

IMAGES = {"mushroom": "*/Mush/*", "Tommy": "*/tommy/*"}
"""Repeated images, and which files are of each."""

LEAST = 3
"""Repeats from which the page reports scatter."""


@dataclass(frozen=True, eq=False)
class Repeated:
    """Repeats of one image, each divided by its photograph's mean, as drift is reported apart.

    Attributes
    ----------
    levels
        (K,) means of the photographs.
    signal_to_noise
        Of one photograph, dB, by what differs between repeats once each has the same mean.
    truth
        What the monitor showed, if a file tells.
    images
        (K, R, C, 3) by method.
    of_mean
        The image of the mean photograph, by method.
    standard_errors
        (R, C, 3) that the noise-aware method reports of the first repeat.
    """

    levels: Array
    signal_to_noise: float
    truth: Array | None
    images: Mapping[str, Array]
    of_mean: Mapping[str, Array]
    standard_errors: Array


def run(setting: PublishedSetting) -> Section:
    """Reconstruct every repeat and summarize what differs."""
    found = {}
    for name, pattern in IMAGES.items():
        captures = setting.captures(REPEATS, pattern)
        if len(captures) >= LEAST:
            found[name] = _repeated(setting.fitted(REPEATS), captures)
    return Section(
        "repeats",
        "Repeats of one image",
        text="Repeats differ by noise alone, but for drift, which is divided out. The scatter of a "
        "patch is its standard deviation over the repeats. Reported standard errors also count "
        "what is alike in all repeats, what total variation does to the image and an uneven wall, "
        "so that the scatter should stay below them."
        if found
        else f"Fewer than {LEAST} repeats of an image can be read.",
        claims=[_claim(*each) for each in found.items()],
        tables=[*([_table(found)] if found else []), *setting.not_read(REPEATS)],
    )


def _repeated(scene: FittedScene, captures: Sequence[Capture]) -> Repeated:
    ours = scene.noise_aware
    photographs = np.stack([capture.photograph for capture in captures])
    levels = photographs.mean(axis=(1, 2, 3))
    photographs /= levels[:, None, None, None]
    methods = {OURS: ours, PAPER: scene.preconditioned}
    variance = photographs.var(axis=0, ddof=1).mean()
    mean = photographs.mean(axis=0)
    return Repeated(
        levels,
        float(10 * np.log10(np.mean(photographs**2) / variance)),
        next((c.truth for c in captures if c.truth is not None), None),
        {name: np.stack([m.reconstruct(y) for y in photographs]) for name, m in methods.items()},
        {name: np.asarray(m.reconstruct(mean), np.float64) for name, m in methods.items()},
        ours.standard_errors(ours.solve(photographs[0])),
    )


def _claim(name: str, repeated: Repeated) -> Claim:
    decibels, count = repeated.signal_to_noise, len(repeated.levels)
    return Claim(
        f"signal-to-noise ratio of a photograph ({name})",
        "60 dB, similar to that of the experimental data",
        f"{decibels:.1f} dB",
        Verdict.of(abs(decibels - 60) < 3),
        f"Root mean square over the standard deviation in time, {count} repeats.",
    )


def _table(found: Mapping[str, Repeated]) -> Table:
    def cells(repeated: Repeated, method: str) -> tuple[str, ...]:
        images, truth = repeated.images[method], repeated.truth
        scatter = np.sqrt(np.mean(images.var(axis=0, ddof=1)))
        percent = 100 * scatter / np.percentile(repeated.of_mean[method], 99)
        reported = np.sqrt(np.mean(repeated.standard_errors**2))
        ratio = f"{scatter / reported:.2f}" if method == OURS else ""
        if truth is None:
            return f"{percent:.2f}", ratio, "", ""
        each = [ps.registered(image, truth).psnr for image in images]
        best = ps.registered(repeated.of_mean[method], truth).psnr
        psnrs = f"{np.mean(each):.2f} ± {np.std(each, ddof=1):.2f}"
        return f"{percent:.2f}", ratio, psnrs, f"{best:.2f}"

    def drift(levels: Array) -> str:
        return f"{100 * levels.std(ddof=1) / levels.mean():.3f}"

    return Table(
        "Drift: standard deviation of the photographs' means, %; scatter of a patch, root mean "
        "square, % of the image's 99th percentile, and over the reported standard errors; PSNR in "
        "dB, shifted, mean and standard deviation over the repeats, and of the mean photograph.",
        ("image", "repeats", "drift", "method", "scatter", "over reported", "PSNR", "of the mean"),
        [
            (name, str(len(one.levels)), drift(one.levels), method, *cells(one, method))
            for name, one in found.items()
            for method in one.images
        ],
    )
