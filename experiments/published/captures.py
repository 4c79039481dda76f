"""All captures: which are there, how they were exposed, how bright and how noisy they are."""

from __future__ import annotations

from itertools import groupby

import numpy as np

from experiments.published.data_set import Capture
from experiments.published.layout import captures
from experiments.published.setting import PublishedSetting
from experiments.report import Section, Table


def run(setting: PublishedSetting) -> Section:
    """Read every capture."""
    rows, problems, read, known = [], [], 0, captures()
    for folder, names in groupby(known, key=lambda name: name.rpartition("/")[0]):
        own = [name.rpartition("/")[2] for name in names]
        found = setting.readable(folder, own)
        problems += setting.data.problems_of(folder, own)
        read += len(found)
        rows.append((folder, f"{len(found)} of {len(own)}", *_ranges(found)))
    tables = [
        Table(
            "Captures read; exposure: shutter speed times exposures; counts: mean of all pixels "
            "for each unit of exposure; noise: standard deviation over the mean, %, between the "
            "sensor pixels that one pixel averages (theirs in time, and from pixel to pixel).",
            ("folder", "read", "exposure", "counts", "noise", "without ground truth"),
            rows,
        )
    ]
    if problems:
        tables.append(Table("Not read.", ("capture", "why"), problems))
    if strangers := setting.data.unknown():
        rows = [(name,) for name in strangers]
        tables.append(Table("Files that the layout does not name, left out.", (), rows))
    return Section(
        "captures",
        "The captures",
        text=f"{read} of the {len(known)} captures of the data set can be read.",
        tables=tables,
    )


def _ranges(found: list[Capture]) -> tuple[str, str, str, str]:
    """Return ranges of exposure, counts and noise over captures, and how many lack the truth."""
    if not found:
        return ("", "", "", "")
    exposures = [capture.exposure for capture in found]
    means = [float(capture.photograph.mean()) for capture in found]
    noises = [
        float(100 * np.mean(capture.noise / capture.photograph.mean(axis=(0, 1))))
        for capture in found
    ]
    lacking = sum(capture.truth is None for capture in found)
    return (_range(exposures), _range(means), _range(noises, ".2f"), str(lacking or ""))


def _range(values: list[float], form: str = ".4g") -> str:
    """Return the least and largest value, or one if they are written alike."""
    return " to ".join(dict.fromkeys(format(value, form) for value in (min(values), max(values))))
