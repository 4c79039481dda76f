"""Metrics of each frame of a recovered video, and its time."""

import csv
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.evaluation import metrics
from periscopy_sim.numerics import Image
from periscopy_sim.reconstruction.video_method import FrameByFrame

Record = dict[str, Any]


def timed_solutions(
    video: FrameByFrame[Any, Any], photographs: Image, batch: int = 16
) -> Iterator[tuple[Any, float]]:
    """Yield solutions in turn, and the seconds of each: its own and its share of its batch's."""
    for start in range(0, len(photographs), batch):
        clock = time.perf_counter()
        remaining: list[Callable[[], Any]] = list(
            video.recoveries(photographs[start : start + batch])
        )
        share = (time.perf_counter() - clock) / len(remaining)
        for finish in remaining:
            clock = time.perf_counter()
            solution = finish()
            yield solution, share + time.perf_counter() - clock


def record_of(seconds: float, numbers: Mapping[str, Any]) -> Record:
    """Return a frame's numbers for the table; of those by channel, the root mean square."""
    means = {
        key: value if isinstance(value, int) else float(np.sqrt(np.mean(np.square(value))))
        for key, value in numbers.items()
    }
    return {"seconds": seconds, **means}


def compare(records: Sequence[Record], images: Image, known: Image, of: str = "") -> None:
    """Add each frame's metrics against the truth to its record, their names ending with `of`."""
    for record, image, truth in zip(records, images, known, strict=True):
        record[f"mean_squared_error{of}"] = metrics.mean_squared_error(image, truth)
        record[f"psnr{of}"] = metrics.psnr_gain_matched(image, truth)


def medians_of(records: Sequence[Record]) -> dict[str, float]:
    """Return the median over the frames of each number."""
    names = (name for name in records[0] if name not in ("frame", "name"))
    return {name: float(np.median([record[name] for record in records])) for name in names}


def write_table(path: Path, records: Sequence[Record]) -> None:
    """Write the records as CSV, one row a frame."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        table = csv.DictWriter(stream, list(records[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(records)
