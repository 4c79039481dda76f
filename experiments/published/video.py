"""The videos behind the plate, frame by frame."""

from collections.abc import Sequence

import numpy as np

import periscopy_sim as ps
from experiments.published.recovered import Recovered, picture, table
from experiments.published.setting import VIDEOS, Capture, PublishedSetting
from experiments.report import Section
from experiments.setting import FittedScene


def run(setting: PublishedSetting) -> Section:
    """Recover every video by every method."""
    pictures, tables = [], []
    for name in VIDEOS:
        if captures := setting.captures(name):
            frames = _frames(setting.fitted(name), captures)
            pictures.append(picture(setting.out, f"frames of {name}", frames))
            tables.append(table(name, frames))
    return Section(
        "video",
        "Videos",
        text="Frames in the order of their numbers, each photograph divided by its exposure; one "
        "that cannot be read is left out, and the next follows the one before. Field of view and "
        "plate are those written down for each video."
        + ("" if tables else " No frame can be read."),
        pictures=pictures,
        tables=[*tables, *setting.not_read(*VIDEOS)],
    )


def _frames(scene: FittedScene, captures: Sequence[Capture]) -> list[Recovered]:
    photographs = np.stack([capture.photograph for capture in captures])
    ours = scene.noise_aware
    by_method = {
        "noise-aware stills": [ours.reconstruct(photograph) for photograph in photographs],
        "noise-aware video": ps.NoiseAwareVideo(ours).frames(photographs),
        "the paper's video": ps.Video(scene.preconditioned).frames(photographs),
    }
    return [
        Recovered(capture, capture.truth, {m: each[k] for m, each in by_method.items()}, {})
        for k, capture in enumerate(captures)
    ]
