"""What `periscopy video` is given, checked and decoded before anything is rendered."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from periscopy_sim.cli.arguments import progress, warn
from periscopy_sim.cli.video_pictures import picture_names
from periscopy_sim.errors import OutputError

if TYPE_CHECKING:
    from periscopy_sim.figures.panels import Image
    from periscopy_sim.scenario import Scenario
    from periscopy_sim.storage.sequences.frames import Frames


def check_left_over(out: Path, count: int) -> None:
    """Refuse a folder whose pictures would be taken for those of this video.

    Raises
    ------
    OutputError
        Naming the first.
    """
    held = {file.name for file in (out / "frames").glob("*.png")}
    left_over = sorted(held - set(picture_names(count)))
    if left_over:
        raise OutputError(
            f"{out / 'frames' / left_over[0]} is of a longer video; remove {out / 'frames'}, or "
            "name another folder"
        )


def decoded_photographs(
    sequence: Frames, scenario: Scenario, file: Path
) -> tuple[Image, list[str]]:
    """Decode all photographs into a mapped file, and print what was assumed or left out.

    A photograph that cannot serve is thus refused before anything is rendered.
    """
    from periscopy_sim.storage.sequences.stacks import mapped_stack, npy_writer

    shape = (len(sequence), *scenario.photograph_shape, 3)
    warnings = list(sequence.warnings)
    first: dict[str, str] = {}
    times: Counter[str] = Counter()
    with (
        progress("reading the photographs") as report,
        npy_writer(file, shape, np.float64) as write,
    ):
        for k, photograph in enumerate(sequence, 1):
            write(photograph.values)
            for warning in photograph.warnings:
                what = warning.partition(": ")[2]
                first.setdefault(what, warning)
                times[what] += 1
            report(k / len(sequence))
    for what, warning in first.items():
        others = f" (likewise {times[what] - 1} more)" if times[what] > 1 else ""
        warnings.append(warning + others)
    for warning in warnings:
        warn(warning)
    return mapped_stack(file), warnings


def decoded_truth(truth: str, scenario: Scenario, count: int, file: Path) -> Image:
    """Read what was hidden, frame by frame, into a mapped file."""
    from periscopy_sim.shipped import find_image
    from periscopy_sim.storage.sequences.hidden_frames import read_hidden_frames
    from periscopy_sim.storage.sequences.stacks import mapped_stack, npy_writer

    path = Path(truth) if Path(truth).is_dir() else find_image(truth)
    shape = scenario.hidden_shape
    with npy_writer(file, (count, *shape, 3), np.float64) as write:
        for image in read_hidden_frames(path, shape, count):
            write(image)
    return mapped_stack(file)
