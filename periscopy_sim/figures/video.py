"""Pictures of a reconstructed video: its frames, the animation and the contact sheet."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from periscopy_sim.evaluation.metrics import gain_matched
from periscopy_sim.figures import animation
from periscopy_sim.figures.panels import displayable, write_enlarged
from periscopy_sim.numerics import Image


def white_of(frames: Image, most: int = 1000) -> float:
    """Choose one white for a whole sequence, so that its brightness does not flicker.

    The 99.5th percentile; of a long sequence, that of `most` frames evenly chosen.
    """
    return float(np.percentile(frames[animation.evenly_chosen(len(frames), most)], 99.5))


def draw_frames(
    folder: Path,
    images: Image,
    white: float,
    text: dict[str, str],
    progress: Callable[[float], None],
) -> None:
    """Draw each frame as a picture of its own, 0000.png and so on, with one white for all."""
    folder.mkdir()
    digits = max(4, len(str(len(images) - 1)))
    for k, image in enumerate(images):
        write_enlarged(folder / f"{k:0{digits}}.png", displayable(image, white), text)
        progress((k + 1) / len(images))


def draw_sheet(
    path: Path,
    photographs: Image,
    known: Image,
    images: Image,
    errors: Sequence[float],
    text: dict[str, str],
    most: int = 8,
) -> None:
    """Draw photograph, hidden image and gain-matched image of evenly chosen frames (Fig. 7).

    The frames' mean squared errors, `errors`, stand beneath.
    """
    chosen = animation.evenly_chosen(len(errors), most)
    white = white_of(photographs)
    rows = [
        ("photograph", [displayable(photographs[k], white) for k in chosen]),
        ("hidden image", [displayable(known[k], 1) for k in chosen]),
        ("reconstruction", [gain_matched(images[k], known[k]) for k in chosen]),
    ]
    titles, notes = [f"frame {k}" for k in chosen], [f"MSE {errors[k]:.2g}" for k in chosen]
    animation.draw_contact_sheet(path, rows, titles=titles, notes=notes, metadata=text)


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
    """Draw photograph, reconstruction and, if it is known, the truth side by side in time.

    The path's ending sets the format, see `draw_animation`.
    """
    panels = {
        "photograph": (photographs, white_of(photographs)),
        "reconstruction": (images, white),
        **({} if known is None else {"truth": (known, 1.0)}),
    }

    def moments() -> Iterator[list[Image]]:
        for k in range(len(images)):
            yield [displayable(shown[k], level) for shown, level in panels.values()]
            progress((k + 1) / len(images))

    animation.draw_animation(path, list(panels), moments(), rate=rate, metadata=text)
