"""The videos behind the plate, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, label_row, show_light
from experiments.published.data_set import Capture
from experiments.published.layout import FRAMES
from experiments.published.setting import PublishedSetting
from experiments.report import Picture, Section, Table
from experiments.setting import FittedScene

Array = NDArray[np.float64]

STILLS, OURS, PAPER = "noise-aware stills", "noise-aware video", "the paper's video"


@dataclass(frozen=True, eq=False)
class Recovered:
    """A video: its captures in time's order, and its frames by each method, (F, R, C, 3)."""

    folder: str
    captures: Sequence[Capture]
    frames: Mapping[str, Array]


def run(setting: PublishedSetting) -> Section:
    """Recover every video by every method."""
    videos: list[Recovered] = []
    pictures, tables = [], []
    for folder, names in FRAMES.items():
        captures = setting.readable(folder, names)
        if captures:
            video = Recovered(folder, captures, _frames(setting.fitted(folder), captures))
            pictures.append(Picture(_draw(setting.out, video), f"{folder}: {_CAPTION}"))
            videos.append(video)
        tables += setting.not_read(folder, names)
    if videos:
        tables.insert(0, _table(videos))
    return Section(
        "video",
        "Videos",
        text="Frames in the order of their numbers, each photograph divided by its exposure; one "
        "that cannot be read is left out, and the next follows the one before. Field of view and "
        "plate are those written down for each video."
        + ("" if videos else " No frame can be read."),
        pictures=pictures,
        tables=tables,
    )


def _frames(scene: FittedScene, captures: Sequence[Capture]) -> dict[str, Array]:
    photographs = np.stack([capture.photograph for capture in captures])
    ours = scene.noise_aware
    return {
        STILLS: np.stack([ours.reconstruct(photograph) for photograph in photographs]),
        OURS: ps.NoiseAwareVideo(ours).frames(photographs),
        PAPER: ps.Video(scene.preconditioned).frames(photographs),
    }


def _table(videos: Sequence[Recovered]) -> Table:
    rows = []
    for video in videos:
        for number, capture in enumerate(video.captures):
            if capture.truth is None:
                cells = ["no ground truth", "", ""]
            else:
                cells = [
                    f"{ps.registered(frames[number], capture.truth).psnr:.1f}"
                    for frames in video.frames.values()
                ]
            rows.append((video.folder, capture.name.rpartition("/")[2], *cells))
    return Table(
        "PSNR of each frame, gain-matched, after the best shift of at most 2 patches, dB.",
        ("folder", "frame", STILLS, OURS, PAPER),
        rows,
    )


_CAPTION = (
    "photographs (white: the 99.5th percentile of each), what the monitor showed, and the frames, "
    "gain-matched where that is known."
)


def _draw(out: Path, video: Recovered) -> Path:
    name = f"video_{video.folder.replace('/', '_')}"
    count = len(video.captures)
    with drawn(out, name, PAGE, 0.55 * (2 + len(video.frames)) + 0.3) as figure:
        axes = figure.subplots(2 + len(video.frames), count, squeeze=False)
        for column, capture in enumerate(video.captures):
            show_light(axes[0, column], capture.photograph)
            axes[0, column].set_title(capture.name.rpartition("_")[2])
            axes[1, column].set_axis_off()
            if capture.truth is not None:
                show_light(axes[1, column], capture.truth, 1)
            for ax, frames in zip(axes[2:, column], video.frames.values(), strict=True):
                if capture.truth is None:
                    show_light(ax, frames[column])
                else:
                    show_light(ax, ps.gain_matched(frames[column], capture.truth), 1)
        for ax, text in zip(axes[:, 0], ("photograph", "shown", *video.frames), strict=True):
            label_row(ax, text.replace(" ", "\n"))
    return out / f"{name}.png"
