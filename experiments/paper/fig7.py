"""Fig. 7: a hidden video, and how its error falls over the first frames.

As in Sec. 4.2 each photograph is A times the true frame, plus ambient light at SBR 0.5 and noise at
60 dB. The paper's coupling (three-dimensional total variation on the pair of frames) stands beside
Eq. 12 as written and beside stills, for a scene that moves and for the same scene at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, draw_means, draw_rows, drawn
from experiments.paper.moving_scene import clip
from experiments.report import Claim, Picture, Section, Verdict
from experiments.setting import SNR, FittedScene, Setting, chair
from experiments.timing import clocked
from periscopy_sim.figures.panels import common_white, displayable
from periscopy_sim.figures.style import plain_ticks

Array = NDArray[np.float64]

FILM = (40, 55)
SBR = 0.5
CONDITION = "ceiling_panels"
FRAMES = 24
STARTS = 8
"""Clips, from other moments of the scene and with other noise, over which errors are averaged."""

MOTION, REST = "in motion", "at rest"
SHOWN = (0, 1, 2, 5, 11, 17, 23)
PAPER, STILLS = "total-variation", "none"
COUPLINGS = {
    PAPER: "3-D total variation",
    "l1": "Eq. 12 as written (l1)",
    STILLS: "stills",
}
COLOR = dict(zip(COUPLINGS, ("preconditioned", "differencing", "bound"), strict=True))
STEADY = slice(6, None)
"""Frames after the burn-in."""

Errors = dict[tuple[str, str], Array]
"""(clips, F) mean squared errors by motion and coupling."""


def run(setting: Setting) -> Section:
    """Reconstruct every clip with every coupling."""
    scene, background = chair(FILM, setting.seed), setting.backgrounds([CONDITION])[CONDITION]
    videos = {name: ps.Video(scene.preconditioned, coupling=name) for name in COUPLINGS}
    taken = {
        motion: photographs_of(scene, truths, background, (setting.seed, kind))
        for kind, (motion, truths) in enumerate(clips(FILM).items())
    }
    errors: Errors = {
        (motion, name): errors_of(video, photographs, clips(FILM)[motion])
        for motion, photographs in taken.items()
        for name, video in videos.items()
    }
    speed = rates(videos[PAPER], taken[MOTION])
    first = clips(FILM)[MOTION][0], taken[MOTION][0]
    curves = {
        f"{letter}  {motion}": {
            COUPLINGS[name]: (errors[motion, name], {"color": COLORS[COLOR[name]], "marker": mark})
            for name, mark in zip(COUPLINGS, "osx", strict=True)
        }
        for letter, motion in zip("ab", taken, strict=True)
    }
    return Section(
        name="fig7",
        title="Fig. 7: video",
        text=f"{in_words(FILM)} patches, SBR {SBR} by {CONDITION.replace('_', ' ')}, "
        f"{SNR:.0f} dB, {STARTS} clips of {FRAMES} frames of a scene of our own, in which a ball "
        "moves by one to two patches a frame. One fixed rule for the weights, the same for stills "
        "and video: the rule that suits stills.",
        claims=_claims(errors, *speed),
        pictures=[
            _draw_frames(setting, *first, videos),
            draw_errors(setting, "fig7_burn_in", curves),
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


def errors_of(video: Any, photographs: Sequence[Array], truths: Sequence[Array]) -> Array:
    """Return the mean squared error of each frame: (clips, F)."""
    errors = []
    for taken, truth in zip(photographs, truths, strict=True):
        video.restart()
        frames = video.frames(taken)
        errors.append([ps.mean_squared_error(f, t) for f, t in zip(frames, truth, strict=True)])
    return np.array(errors)


def rates(video: Any, photographs: Sequence[Array]) -> tuple[float, float]:
    """Return frames a second, one at a time and many at once: medians over the clips."""

    def live(taken: Array) -> None:
        for photograph in taken:
            video.next_frame(photograph)

    def rate(task: Any) -> float:
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


def draw_errors(
    setting: Setting, name: str, panels: Mapping[str, Mapping[str, tuple[Array, dict[str, Any]]]]
) -> Picture:
    """Draw the errors of frames: panels by title, in them (clips, F) and a look by label."""
    rows = (len(panels) + 1) // 2
    with drawn(setting.out, name, PAGE, 0.5 + 1.8 * rows) as figure:
        grid = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
        for ax, (title, curves) in zip(grid.flat, panels.items(), strict=True):
            for label, (errors, look) in curves.items():
                draw_means(ax, errors, label=label, markersize=3, **look)
            ax.set(title=title, yscale="log", xticks=[1, 6, 12, 18, 24], xlim=(1, FRAMES))
        for row in grid:
            row[0].set(ylabel="mean squared error")
        for ax in grid[-1]:
            ax.set(xlabel="frame")
        plain_ticks(grid[0, 0].yaxis)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return Picture(
        setting.out / f"{name}.png",
        f"Mean squared error of each frame; lines: means over {STARTS} clips, bands: their "
        "standard errors.",
    )


def _claims(errors: Errors, live: float, batch: float) -> list[Claim]:

    def over_stills(motion: str, name: str) -> float:
        return float(
            errors[motion, name][:, STEADY].mean() / errors[motion, STILLS][:, STEADY].mean()
        )

    def fall(motion: str) -> tuple[str, Verdict]:
        of_motion = errors[motion, PAPER]
        falls = of_motion[:, 0] - of_motion[:, STEADY].mean(axis=1)
        text = ", ".join(f"{of_motion[:, k].mean():.4f}" for k in range(3))
        is_fall = falls.mean() > 2 * falls.std(ddof=1) / np.sqrt(STARTS)
        steady = of_motion[:, STEADY].mean()
        return f"frames 1, 2, 3: {text}; from 7 on {steady:.4f}", Verdict.of(bool(is_fall))

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
            "MSE from frame 7 on over that of stills: in motion "
            f"{over_stills(MOTION, PAPER):.2f} (Eq. 12 as written {over_stills(MOTION, 'l1'):.2f}),"
            f" at rest {over_stills(REST, PAPER):.2f} ({over_stills(REST, 'l1'):.2f})",
            Verdict.of(over_stills(MOTION, PAPER) < 1),
            "The l1 term lets go of what has changed by more than its weight; total variation "
            "on the pair pulls every change back in proportion.",
        ),
    ]


def _draw_frames(
    setting: Setting, truth: Array, photographs: Array, videos: dict[str, ps.Video]
) -> Picture:
    white = common_white(photographs)
    rows = {
        "photograph": [(f"frame {k + 1}", displayable(photographs[k], white)) for k in SHOWN],
        "hidden frame": [("", truth[k]) for k in SHOWN],
    }
    for name, video in videos.items():
        video.restart()
        frames = video.frames(photographs)
        rows[COUPLINGS[name].replace(" (", "\n(")] = [
            (
                f"MSE {ps.mean_squared_error(frames[k], truth[k]):.4f}",
                ps.gain_matched(frames[k], truth[k]),
            )
            for k in SHOWN
        ]
    return draw_rows(
        setting.out, "fig7", rows,
        "The first clip: photographs (white: the 99.5th percentile), hidden frames, and "
        "reconstructions, gain-matched, with their mean squared errors.",
    )  # fmt: skip
