"""Fig. 7: a hidden video, and how its error falls over the first frames.

As in Sec. 4.2 each photograph is A times the true frame, plus ambient light at SBR 0.5 and noise at
60 dB. The paper's coupling (three-dimensional total variation on the pair of frames) stands beside
Eq. 12 as written and beside stills, for a scene that moves and for the same scene at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import draw_rows
from experiments.paper.moving_scene import clip
from experiments.report import Claim, Picture, Section, Verdict
from experiments.setting import SNR, FittedScene, Setting, chair
from experiments.sweeps import drawn_sweep
from experiments.timing import clocked
from periscopy_sim.figures.panels import common_white, displayable

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

FILM = (40, 55)
SBR = 0.5
CONDITION = "ceiling_panels"
FRAMES = 24
STARTS = 8
"""Clips, from other moments of the scene and with other noise, over which errors are averaged."""

MOTION, REST = "in motion", "at rest"
SHOWN = (0, 1, 2, 5, 11, 17, 23)
PAPER, AS_WRITTEN, STILLS = "3-D total variation", "Eq. 12 as written (l1)", "stills"
COUPLINGS = {PAPER: "total-variation", AS_WRITTEN: "l1", STILLS: "none"}
BURN_IN = 6
"""Frames."""


def run(setting: Setting) -> Section:
    """Reconstruct every clip with every coupling."""
    scene, background = chair(FILM, setting.seed), setting.backgrounds([CONDITION])[CONDITION]
    videos = {n: ps.Video(scene.preconditioned, coupling=each) for n, each in COUPLINGS.items()}
    truths = clips(FILM)
    taken = {
        motion: photographs_of(scene, truths[motion], background, (setting.seed, kind))
        for kind, motion in enumerate(truths)
    }
    errors = errors_of(videos, taken, truths)
    return Section(
        name="fig7",
        title="Fig. 7: video",
        text=f"{in_words(FILM)} patches, SBR {SBR} by {CONDITION.replace('_', ' ')}, "
        f"{SNR:.0f} dB, {STARTS} clips of {FRAMES} frames of a scene of our own, in which a ball "
        "moves by one to two patches a frame. One fixed rule for the weights, the same for stills "
        "and video: the rule that suits stills.",
        claims=_claims(errors, *rates(videos[PAPER], taken[MOTION])),
        pictures=[
            _draw_frames(setting, truths[MOTION][0], taken[MOTION][0], videos),
            drawn_errors(setting, "fig7_burn_in", errors),
        ],
    )


def clips(hidden: tuple[int, int]) -> dict[str, list[Array]]:
    """Return clips, (F, R, C, 3) each, of the moving scene, and of the first frame of each."""
    moving = [clip(hidden, FRAMES, start=0.6 * number) for number in range(STARTS)]
    return {MOTION: moving, REST: [frames[[0] * FRAMES] for frames in moving]}


def photographs_of(
    scene: FittedScene,
    truths: Sequence[Array],
    background: Array,
    seed: tuple[int, ...],
    sbr: float = SBR,
) -> list[Array]:
    """Photograph clips under steady light, as A has them, with noise of `SNR`."""
    photographs = []
    for number, truth in enumerate(truths):
        signals = scene.A @ truth.reshape(len(truth), -1, 3) * scene.scenario.channel_gain
        lit = np.broadcast_to(background, (len(truth), *background.shape))
        # The camera's exposure stays, and with it the brightness of the frames.
        exposed = ps.composite(signals.reshape(lit.shape), lit, sbr)
        draws = np.random.SeedSequence((*seed, number)).generate_state(len(truth))
        noisy = [ps.add_noise(y, SNR, int(draw)) for y, draw in zip(exposed, draws, strict=True)]
        photographs.append(np.stack(noisy))
    return photographs


def errors_of(
    videos: Mapping[str, Any],
    taken: Mapping[str, Sequence[Array]],
    truths: Mapping[str, Sequence[Array]],
) -> xr.DataArray:
    """Return mean squared errors by video, kind of scene, clip and frame."""
    import xarray as xr

    def of(video: Any, photographs: Array, truth: Array) -> list[float]:
        video.restart()
        frames = video.frames(photographs)
        return [ps.mean_squared_error(f, t) for f, t in zip(frames, truth, strict=True)]

    values = [
        [
            [of(video, *each) for each in zip(taken[kind], truths[kind], strict=True)]
            for kind in taken
        ]
        for video in videos.values()
    ]
    frames = np.arange(1, FRAMES + 1)
    axes = {"algorithm": [*videos], "scene": [*taken], "seed": range(STARTS), "frame": frames}
    return xr.DataArray(values, axes, [*axes])


def steady(errors: xr.DataArray) -> xr.DataArray:
    """Return mean errors of the frames after the burn-in."""
    return errors.sel(frame=slice(BURN_IN + 1, None)).mean(["seed", "frame"])


def rates(video: Any, photographs: Sequence[Array]) -> tuple[float, float]:
    """Return frames a second, one at a time and many at once: medians over the clips."""

    def live(taken: Array) -> None:
        for photograph in taken:
            video.next_frame(photograph)

    def rate(task: Callable[[Array], object]) -> float:
        seconds = []
        for taken in photographs:
            video.restart()
            seconds.append(clocked(partial(task, taken))[0] / len(taken))
        return 1 / float(np.median(seconds))

    video.frames(photographs[0])  # compiles
    return rate(live), rate(video.frames)


def in_words(hidden: tuple[int, int]) -> str:
    """Return a size as the paper writes it, columns first."""
    return f"{hidden[1]} x {hidden[0]}"


def drawn_errors(setting: Setting, name: str, errors: xr.DataArray) -> Picture:
    """Draw the mean errors of frames, each kind of scene in a panel."""
    caption = f"Mean squared error of each frame, over {STARTS} clips."
    return drawn_sweep(setting, name, errors, caption, over="frame", panels="scene")


def _claims(errors: xr.DataArray, live: float, batch: float) -> list[Claim]:
    later = steady(errors)
    ratios = later / later.sel(algorithm=STILLS)

    def over_stills(motion: str) -> str:
        paper, as_written = (ratios.sel(algorithm=n, scene=motion) for n in (PAPER, AS_WRITTEN))
        return f"{motion} {paper:.2f} (Eq. 12 as written {as_written:.2f})"

    def fall(motion: str) -> tuple[str, Verdict]:
        of_motion = errors.sel(algorithm=PAPER, scene=motion)
        after = of_motion.sel(frame=slice(BURN_IN + 1, None)).mean("frame")
        falls = of_motion.sel(frame=1) - after
        is_fall = falls.mean() > 2 * falls.std(ddof=1) / np.sqrt(STARTS)
        first = ", ".join(f"{each:.4f}" for each in of_motion.mean("seed").values[:3])
        return f"frames 1, 2, 3: {first}; from 7 on {after.mean():.4f}", Verdict.of(bool(is_fall))

    return [
        Claim(
            "rate of the reconstruction, every stage, frame by frame",
            "16 frames a second",
            f"{live:.0f} (in batches {batch:.0f})",
            Verdict.BETTER if live > 16 else Verdict.DIFFERS,
            "Another machine.",
        ),
        Claim(
            "later frames are better than the first, scene in motion",
            "MSE falls over the first frames",
            *fall(MOTION),
            "The second frame is better than the first; then what has moved leaves a trace, "
            "which costs as much as the averaged noise gains. How a frame compares with the "
            "first also depends on what it shows.",
        ),
        Claim("the same, scene at rest", "MSE falls over the first frames", *fall(REST)),
        Claim(
            "temporal regularization helps",
            "later frames improve by it",
            f"MSE from frame 7 on over that of stills: {over_stills(MOTION)}, {over_stills(REST)}",
            Verdict.of(bool(ratios.sel(algorithm=PAPER, scene=MOTION) < 1)),
            "The l1 term lets go of what has changed by more than its weight; total variation "
            "on the pair pulls every change back in proportion.",
        ),
    ]


def _draw_frames(
    setting: Setting, truth: Array, photographs: Array, videos: Mapping[str, ps.Video]
) -> Picture:
    white = common_white(photographs)
    rows = {
        "photograph": [(f"frame {k + 1}", displayable(photographs[k], white)) for k in SHOWN],
        "hidden frame": [("", truth[k]) for k in SHOWN],
    }
    for name, video in videos.items():
        video.restart()
        frames = video.frames(photographs)
        errors = [ps.mean_squared_error(frames[k], truth[k]) for k in SHOWN]
        rows[name.replace(" (", "\n(")] = [
            (f"MSE {error:.4f}", ps.gain_matched(frames[k], truth[k]))
            for k, error in zip(SHOWN, errors, strict=True)
        ]
    return draw_rows(
        setting.out, "fig7", rows,
        "The first clip: photographs (white: the 99.5th percentile), hidden frames, and "
        "reconstructions, gain-matched, with their mean squared errors.",
    )  # fmt: skip
