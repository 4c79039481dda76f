"""What `periscopy video` tells of each frame."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from periscopy_sim.cli.video_methods import Solution
    from periscopy_sim.figures.panels import Image

Record = dict[str, Any]


def record_of(frame: int, name: str, solution: Solution, seconds: float) -> Record:
    """Tell how a frame came about; of noise and λ the root mean square over the channels."""
    from periscopy_sim.reconstruction.noise_aware.still import NoiseAwareReconstruction

    record: Record = {
        "frame": frame,
        "name": name,
        "seconds": seconds,
        "noise": _root_mean_square(solution.noise),
        "lambda": _root_mean_square(np.asarray(solution.weight)),
    }
    if isinstance(solution, NoiseAwareReconstruction):
        return {**record, "iterations": solution.iterations}
    return {**record, "kappa": float(solution.threshold)}


def compare(records: Sequence[Record], images: Image, known: Image) -> None:
    """Add each frame's metrics against the truth to its record."""
    from periscopy_sim.evaluation import metrics

    for record, image, truth in zip(records, images, known, strict=True):
        record["mean_squared_error"] = metrics.mean_squared_error(image, truth)
        record["psnr"] = metrics.psnr(image, truth)


def medians_of(records: Sequence[Record]) -> dict[str, float]:
    """Take the median over the frames of all that is measured."""
    return {
        name: float(np.median([record[name] for record in records]))
        for name in records[0]
        if name not in ("frame", "name")
    }


def write_table(path: Path, records: Sequence[Record]) -> None:
    """Write the records as CSV, one row a frame."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        table = csv.DictWriter(stream, list(records[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(records)


def _root_mean_square(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
