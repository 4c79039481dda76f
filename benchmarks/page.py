"""The leaderboard: one offline page of tables, a plot and pictures, from results that are there."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scoring import METRICS, interval
from benchmarks.suites import SUITES, VERSION, digest
from experiments.drawing import COLORS, PAGE, drawn
from experiments.report import Picture, Section, Table, write_page

_TITLES = {"psnr": "PSNR, dB", "registered": "registered PSNR, dB", "ssim": "SSIM"}
_OTHERS = ("#56B4E9", "#E69F00", "#999999", "#000000", "#F0E442", "#8C564B")
_GIBIBYTE = 2**30
_REFERENCE = "noise-aware"

INTRODUCTION = (
    f"Passive non-line-of-sight imaging, suites version {VERSION}. Each method recovers the hidden "
    "images of geometries drawn by seed, none of which is a shipped scene. Every metric uses the "
    "truth: each channel is scaled by the factor that fits it best; registered means after the "
    "best shift of at most two patches. Brackets hold 95 % confidence intervals by a bootstrap "
    "over geometries and the cells within them. All methods run with their own defaults, the same "
    "in every suite; BLAS has one thread, the package's own compiled products have every core."
)


def write_leaderboard(out: Path, rows: Any, provenance: dict[str, str]) -> Path:
    """Write the page of all rows, as `benchmarks.running.read_rows` returns them; return its path.

    A method's rank in a suite is that of its mean PSNR; cells that failed are counted beside it and
    left out of its means, and a method with failures stands below those without. Over all suites, a
    suite without any cell counts 0 dB.
    """
    suites = [name for name in SUITES if (rows.suite == name).any()]
    labels = sorted(rows.label.unique(), key=lambda label: -_mean(rows, suites, label))
    sections = [_ladder(out, rows, suites, labels)]
    sections += [_suite(out, rows[rows.suite == suite], suite, labels) for suite in suites]
    record = {**provenance, "suites_version": VERSION, "suites_sha256": digest()}
    page = out / "index.html"
    write_page(page, "Leaderboard", sections, introduction=INTRODUCTION, provenance=record)
    return page


def command(label: str, suite: str) -> str:
    """Return the command that makes one row again."""
    return f"python -m benchmarks run --methods {label} --suites {suite} --out out/leaderboard"


def gain(rows: Any, label: str) -> str:
    """Return a method's registered PSNR less the reference's, cell by cell, in the mean."""
    values = [
        rows[(rows.label == name) & (rows.failure == "")].set_index(["geometry", "cell"]).registered
        for name in (label, _REFERENCE)
    ]
    gains = (values[0] - values[1]).dropna()
    if label == _REFERENCE or not len(gains):
        return "-"
    mean, low, high = interval(gains, list(gains.index.get_level_values("geometry")))
    return f"{mean:+.2f} [{low:+.2f}, {high:+.2f}]"


def _mean(rows: Any, suites: Sequence[str], label: str) -> float:
    """Return the mean over suites of a method's mean PSNR; of a suite without any, 0."""
    own = rows[rows.label == label]
    means = [own[own.suite == suite].psnr.mean() for suite in suites]
    return float(np.nan_to_num(means).mean())


def _interval(cells: Any, metric: str) -> tuple[float, float, float] | None:
    good = cells[cells.failure == ""]
    return interval(good[metric], list(good.geometry)) if len(good) else None


def _told(cells: Any, metric: str) -> str:
    found = _interval(cells, metric)
    digits = 3 if metric == "ssim" else 1
    if found is None:
        return "-"
    mean, low, high = (f"{value:.{digits}f}" for value in found)
    return f"{mean} [{low}, {high}]"


def _ladder(out: Path, rows: Any, suites: Sequence[str], labels: Sequence[str]) -> Section:
    """Draw and tabulate every method over every suite."""
    with drawn(out / "pictures", "ladder", PAGE, 2.9) as figure:
        ax = figure.subplots()
        spread = np.linspace(-0.3, 0.3, len(labels)) if len(labels) > 1 else [0.0]
        others = iter(_OTHERS * len(labels))
        for offset, label in zip(spread, labels, strict=True):
            color = COLORS[label] if label in COLORS and label != "pseudoinverse" else next(others)
            found = [
                _interval(rows[(rows.suite == s) & (rows.label == label)], "psnr") for s in suites
            ]
            there = [(k, each) for k, each in enumerate(found) if each is not None]
            if not there:
                continue
            at = np.array([k + offset for k, _ in there])
            mean, low, high = np.array([each for _, each in there]).T
            ax.errorbar(
                at, mean, [mean - low, high - mean], fmt="o", ms=3.5, lw=1, color=color, label=label
            )
        ax.set_xticks(range(len(suites)), suites)
        ax.set_ylabel("PSNR, dB")
        ax.grid(axis="y", lw=0.3)
        ax.margins(x=0.02)
        figure.legend(loc="outside upper center", ncols=4)
    table = Table(
        "Mean PSNR, dB, with 95 % intervals. The order is that of the mean over suites.",
        ("method", *suites),
        [
            (
                label,
                *(_told(rows[(rows.suite == s) & (rows.label == label)], "psnr") for s in suites),
            )
            for label in labels
        ],
    )
    picture = Picture(
        out / "pictures" / "ladder.png",
        "Mean PSNR of every method over every suite, 95 % intervals.",
    )
    return Section("ladder", "The ladder", pictures=[picture], tables=[table])


def _suite(out: Path, rows: Any, suite: str, labels: Sequence[str]) -> Section:
    """Tabulate one suite and show examples of it."""
    present = [label for label in labels if (rows.label == label).any()]
    present.sort(key=lambda label: _rank(rows[rows.label == label]))
    table = Table(
        f"Over {_REFERENCE}: registered PSNR less {_REFERENCE}'s, cell by cell. Fit: seconds to "
        "fit a method to a scene. Still: median seconds of an image. Memory: GiB by which the "
        "process's peak rises while it fits and reconstructs, A and B not counted.",
        (
            "method",
            *(_TITLES[metric] for metric in METRICS),
            f"over {_REFERENCE}, dB",
            "fit, s",
            "still, s",
            "memory",
            "failed",
        ),
        [_row(rows, label) for label in present],
    )
    commands = Table(
        "Each row again:", ("method", "command"), [(name, command(name, suite)) for name in present]
    )
    picture = _examples(out, rows, suite, present)
    about = SUITES[suite]
    cells = rows[rows.label == present[0]]
    text = (
        f"{about.about} {cells.geometry.nunique()} geometries, {len(cells)} cells; "
        f"{about.hidden[0]} rows of {about.hidden[1]} patches, SNR {about.snr:g} dB."
    )
    return Section(
        suite, suite, text, pictures=[picture], tables=[table, *_failures(rows), commands]
    )


def _rank(cells: Any) -> tuple[bool, float]:
    return bool((cells.failure != "").any()), -float(np.nan_to_num(cells.psnr.mean()))


def _row(rows: Any, label: str) -> tuple[str, ...]:
    cells = rows[rows.label == label]
    good = cells[cells.failure == ""]
    failed = len(cells) - len(good)
    return (
        label,
        *(_told(cells, metric) for metric in METRICS),
        gain(rows, label),
        f"{good.fit_seconds.median():.2f}" if len(good) else "-",
        f"{good.seconds.median():.3f}" if len(good) else "-",
        f"{good.memory.median() / _GIBIBYTE:.2f}" if len(good) else "-",
        f"{failed} of {len(cells)}" if failed else "none",
    )


def _failures(rows: Any) -> list[Table]:
    """Tabulate the cells that failed, each message once for a method."""
    bad = rows[rows.failure != ""]
    if not len(bad):
        return []
    grouped = bad.groupby(["label", "failure"]).size()
    lines = [(label, str(count), message) for (label, message), count in grouped.items()]
    return [Table("Cells that failed.", ("method", "cells", "message"), lines)]


def _examples(out: Path, rows: Any, suite: str, labels: Sequence[str]) -> Picture:
    """Draw the first geometry's first and last image: photograph, truth and each method's."""
    from PIL import Image

    first = rows[rows.geometry == rows.geometry.min()]
    names = list(dict.fromkeys(first.cell))
    shown = [names[0], names[-1]] if len(names) > 1 else names
    width = 2 + len(labels)
    with drawn(out / "pictures", suite, PAGE, 0.95 * len(shown) + 0.1) as figure:
        axes = figure.subplots(len(shown), width, squeeze=False)
        for line, name in zip(axes, shown, strict=True):
            cells = first[first.cell == name].set_index("label")
            any_cell = cells.iloc[0]
            pictures = [("photograph\n", any_cell.photograph), ("hidden\n", any_cell.truth)]
            for label in labels:
                cell = cells.loc[label]
                value = "failed" if cell.failure else f"{cell.psnr:.1f} dB"
                pictures.append((f"{label}\n{value}", cell.recovered))
            for ax, (title, data) in zip(line, pictures, strict=True):
                ax.set_axis_off()
                ax.set_anchor("N")
                ax.set_title(title, fontsize=5)
                if data:
                    ax.imshow(np.asarray(Image.open(io.BytesIO(data))), interpolation="nearest")
    caption = f"Examples of {suite}: " + "; ".join(shown) + ". PSNR above each."
    return Picture(out / "pictures" / f"{suite}.png", caption)
