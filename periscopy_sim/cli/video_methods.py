"""The methods of `periscopy video`: which options are theirs, and how each frame is recovered."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from periscopy_sim.errors import PeriscopyError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from periscopy_sim.cli.masks import Mask
    from periscopy_sim.figures.panels import Image
    from periscopy_sim.reconstruction.noise_aware.still import NoiseAwareReconstruction
    from periscopy_sim.reconstruction.noise_aware.video import NoiseAwareVideo
    from periscopy_sim.reconstruction.preconditioned.still import Reconstruction
    from periscopy_sim.reconstruction.preconditioned.video import Video
    from periscopy_sim.scenario import Array, Scenario

    AnyVideo = Video | NoiseAwareVideo
    Solution = Reconstruction | NoiseAwareReconstruction

LIVE_FRAMES = 16
"""Most frames on which the rate of frames that come one at a time is measured."""

BYTES_FOR_P = 24
"""For each entry of A, while P is formed: A and P in single precision, each in double beside."""


class VideoMethod(StrEnum):
    """How frames are recovered; see `Video` and `NoiseAwareVideo`."""

    preconditioned = "preconditioned"
    noise_aware = "noise-aware"


class Coupling(StrEnum):
    """How a frame is tied to the one before it; see `Video`."""

    total_variation = "total-variation"
    l1 = "l1"
    none = "none"


WEIGHTS = {"temporal_weight": Coupling.total_variation, "l1_weight": Coupling.l1}
"""The coupling that each weight belongs to."""

PRECONDITIONED = {"tv_weight": 1.0, "repair_threshold": 0.1, "rank_tolerance": 1e-10}
"""What belongs to the preconditioned method alone, and its defaults."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A method that knows its scene.

    Attributes
    ----------
    video
        Recovers the frames.
    settings
        What the summary tells of it.
    """

    video: AnyVideo
    settings: dict[str, Any]


# -- what is given -------------------------------------------------------------------------------


def checked_settings(
    method: VideoMethod, coupling: Coupling, weights: dict[str, float | None], **given: float | None
) -> tuple[dict[str, float], dict[str, float]]:
    """Keep the weights of the coupling that are given, and fill in the method's other settings.

    Raises
    ------
    PeriscopyError
        If one belongs to another coupling or method.
    """
    if method is VideoMethod.noise_aware and coupling is Coupling.total_variation:
        raise PeriscopyError(
            f"--coupling {coupling.value} belongs to --method {VideoMethod.preconditioned.value}; "
            f"{method.value} takes {Coupling.l1.value} or {Coupling.none.value}"
        )
    kept = {name: value for name, value in weights.items() if value is not None}
    for name in kept:
        if WEIGHTS[name] is not coupling:
            raise PeriscopyError(
                f"--{name.replace('_', '-')} belongs to --coupling {WEIGHTS[name].value}, not to "
                f"{coupling.value}; leave it out"
            )
    if method is VideoMethod.preconditioned:
        return kept, {
            name: PRECONDITIONED[name] if value is None else value for name, value in given.items()
        }
    for name, value in given.items():
        if value is not None:
            raise PeriscopyError(
                f"--{name.replace('_', '-')} belongs to --method "
                f"{VideoMethod.preconditioned.value}, not to {method.value}; leave it out"
            )
    return kept, {}


def fits_in_memory(size: int) -> bool:
    """Tell whether so many bytes are less than half of this machine's memory."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return True
    return 2 * size < memory


# -- the methods ---------------------------------------------------------------------------------


def fitted(
    method: VideoMethod,
    coupling: Coupling,
    weights: dict[str, float],
    settings: dict[str, float],
    scenario: Scenario,
    A: NDArray[Any],
    B: Array,
    mask: Mask | None,
) -> Fitted:
    """Fit a method to a scene; weights and settings are those of `checked_settings`."""
    from periscopy_sim.reconstruction.noise_aware.still import NoiseAware
    from periscopy_sim.reconstruction.noise_aware.video import NoiseAwareVideo
    from periscopy_sim.reconstruction.preconditioned.still import Periscope
    from periscopy_sim.reconstruction.preconditioned.video import Video

    video: AnyVideo
    if method is VideoMethod.noise_aware:
        still = NoiseAware.for_scene(scenario, A, B, mask=mask)
        named: Any = coupling.value
        video, told = NoiseAwareVideo(still, coupling=named, **weights), {}
    else:
        explicit = fits_in_memory(BYTES_FOR_P * A.size)
        periscope = Periscope.for_scene(
            scenario,
            A,
            B,
            rank_tolerance=settings["rank_tolerance"],
            tv_weight=settings["tv_weight"],
            repair_threshold=settings["repair_threshold"],
            explicit=explicit,
            mask=mask,
        )
        video = Video(periscope, coupling=coupling.value, **weights)
        rank = periscope.preconditioner.Q.shape[1]
        told = {**settings, "background_rank": rank, "explicit": explicit}
    used = {n: getattr(video, n) for n, owner in WEIGHTS.items() if owner is coupling}
    return Fitted(video, {"method": method.value, **told, "coupling": coupling.value, **used})


def live_rate(video: AnyVideo, photographs: Image) -> float:
    """Measure frames a second when they come one at a time and the compiled code is loaded."""
    for photograph in photographs[:2]:  # a first frame and one that follows
        video.next_frame(photograph)
    shown = photographs[:LIVE_FRAMES]
    start = time.perf_counter()
    for photograph in shown:
        video.next_frame(photograph)
    seconds = time.perf_counter() - start
    video.restart()
    return len(shown) / seconds


def solutions(video: AnyVideo, photographs: Image, batch: int) -> Iterator[tuple[Solution, float]]:
    """Frames in turn, with the seconds each took: its own and its share of its batch's product."""
    for start in range(0, len(photographs), batch):
        clock = time.perf_counter()
        remaining: list[Callable[[], Solution]] = list(
            video.begun(photographs[start : start + batch])
        )
        share = (time.perf_counter() - clock) / len(remaining)
        for finish in remaining:
            clock = time.perf_counter()
            solution = finish()
            yield solution, share + time.perf_counter() - clock
