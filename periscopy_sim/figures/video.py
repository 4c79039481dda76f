"""Pictures of a reconstructed video: its frames, the animation and the contact sheet."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from periscopy_sim.evaluation import metrics
from periscopy_sim.figures import contact_sheet, panels
from periscopy_sim.figures.animation import draw_animation
from periscopy_sim.figures.movie import draw_movie
from periscopy_sim.figures.panels import Image

SHEET_COLUMNS = 8
"""Most frames on the contact sheet."""

MOST_VALUES = 2**24
"""Most values that the white of a sequence is taken from."""


def picture_names(count: int) -> list[str]:
    """Name the picture of each frame: 0000.png and so on."""
    digits = max(4, len(str(count - 1)))
    return [f"{k:0{digits}}.png" for k in range(count)]


def white_of(frames: Image) -> float:
    """Choose one white for a whole sequence, so that its brightness does not flicker.

    The 99.5th percentile; of a long sequence, that of frames evenly chosen.
    """
    most = max(2, MOST_VALUES // frames[0].size)
    return float(np.percentile(frames[contact_sheet.evenly_chosen(len(frames), most)], 99.5))


def draw_frames(
    folder: Path,
    images: Image,
    white: float,
    text: dict[str, str],
    progress: Callable[[float], None],
) -> None:
    """Draw each frame as a picture of its own, with one white for all."""
    folder.mkdir()
    names = picture_names(len(images))
    for k, (name, image) in enumerate(zip(names, images, strict=True), 1):
        panels.write_enlarged(folder / name, panels.displayable(image, white), text)
        progress(k / len(images))


def draw_sheet(
    path: Path,
    photographs: Image,
    known: Image,
    images: Image,
    errors: Sequence[float],
    text: dict[str, str],
) -> None:
    """Draw photograph, hidden image and gain-matched image of evenly chosen frames (Fig. 7).

    The frames' mean squared errors, `errors`, stand beneath.
    """
    chosen = contact_sheet.evenly_chosen(len(errors), SHEET_COLUMNS)
    white = white_of(photographs)
    contact_sheet.draw_contact_sheet(
        path,
        [
            ("photograph", [panels.displayable(photographs[k], white) for k in chosen]),
            ("hidden image", [panels.displayable(known[k], 1) for k in chosen]),
            ("reconstruction", [metrics.gain_matched(images[k], known[k]) for k in chosen]),
        ],
        titles=[f"frame {k}" for k in chosen],
        notes=[f"MSE {errors[k]:.2g}" for k in chosen],
        metadata=text,
    )


def draw_video(
    path: Path,
    photographs: Image,
    images: Image,
    known: Image | None,
    white: float,
    rate: float,
    text: dict[str, str],
    progress: Callable[[float], None],
) -> None:
    """Draw photograph, reconstruction and, where it is known, the truth side by side in time.

    By the path's ending an animated PNG, or a video of `movie.ENCODINGS`.
    """
    columns = [
        ("photograph", photographs, white_of(photographs)),
        ("reconstruction", images, white),
    ]
    if known is not None:
        columns.append(("truth", known, 1.0))
    count = len(images)

    def moments() -> Iterator[list[Image]]:
        for k in range(count):
            yield [panels.displayable(shown[k], level) for _, shown, level in columns]
            progress((k + 1) / count)

    titles = [title for title, _, _ in columns]
    if path.suffix == ".png":
        draw_animation(path, titles, moments(), count=count, rate=rate, metadata=text)
    else:
        draw_movie(path, titles, moments(), rate=rate, metadata=text)
