"""Fig. 7: a hidden video, and how its error falls over the first frames.

As in Sec. 4.2 each photograph is A times the true frame, plus ambient light at SBR 0.5 and noise at
60 dB. The paper's coupling (three-dimensional total variation on the pair of frames) stands beside
Eq. 12 as written and beside stills, for a scene that moves and for the same scene at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, draw_means, drawn, label_row, show_light
from experiments.paper.moving_scene import clip
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import SNR, Chair, Setting
from experiments.timing import clocked

Array = NDArray[np.float64]

HIDDEN = (40, 55)
SBR = 0.5
CONDITION = "ceiling_panels"
FRAMES = 24
STARTS = 8
"""Clips, from other moments of the scene and with other noise, over which errors are averaged."""

SHOWN = (0, 1, 2, 5, 11, 17, 23)
COUPLINGS = {
    "total-variation": "3-D total variation",
    "l1": "Eq. 12 as written (l1)",
    "none": "stills",
}
STEADY = slice(6, None)
"""Frames after the burn-in."""


@dataclass(frozen=True, eq=False)
class Coupled:
    """What one coupling made of every clip.

    Attributes
    ----------
    frames
        (F, R, C, 3) of the first clip, gain-matched.
    errors
        (clips, F) mean squared errors.
    live, batch
        Frames a second, one at a time and many at once.
    """

    frames: Array
    errors: Array
    live: float
    batch: float


def run(setting: Setting) -> Section:
    """Reconstruct every clip with every coupling."""
    chair = Chair(HIDDEN, setting.seed)
    scenario, A, periscope = chair.scenario, chair.A, chair.preconditioned
    background = setting.backgrounds([CONDITION])[CONDITION]

    def photographed(truths: list[Array], kind: int) -> list[Array]:
        return [
            photographs_of(
                A, scenario.channel_gain, truth, background, (setting.seed, kind, number)
            )
            for number, truth in enumerate(truths)
        ]

    moving = [clip(HIDDEN, FRAMES, start=0.6 * number) for number in range(STARTS)]
    resting = [np.repeat(frames[:1], FRAMES, axis=0) for frames in moving]
    photographs = photographed(moving, 0)
    found = {name: _reconstruct(periscope, name, moving, photographs) for name in COUPLINGS}
    photographs_at_rest = photographed(resting, 1)
    at_rest = {
        name: _reconstruct(periscope, name, resting, photographs_at_rest) for name in COUPLINGS
    }
    _draw(setting, moving[0], photographs[0], found)
    _draw_errors(setting, found, at_rest)
    return _section(setting, found, at_rest)


def photographs_of(
    A: NDArray[np.float32],
    gain: Array,
    truth: Array,
    background: Array,
    seed: tuple[int, ...],
    sbr: float = SBR,
) -> Array:
    """Photograph the frames of a clip under steady light, as A has them, with noise of `SNR`."""
    signals = [(A @ f.reshape(-1, 3) * gain).reshape(background.shape) for f in truth]
    # The camera's exposure stays, and with it the brightness of the frames.
    exposed = ps.composite(np.stack(signals), np.stack([background] * len(signals)), sbr)
    draws = np.random.SeedSequence(seed).generate_state(len(truth))
    return np.stack([ps.add_noise(y, SNR, int(s)) for y, s in zip(exposed, draws, strict=True)])


def _reconstruct(
    periscope: ps.Periscope, coupling: str, truths: list[Array], photographs: list[Array]
) -> Coupled:
    video = ps.Video(periscope, coupling=coupling)
    video.frames(photographs[0])  # compiles
    clips, seconds = [], []
    for photograph in photographs:
        video.restart()
        took, frames = clocked(lambda y=photograph: np.stack([video.next_frame(p) for p in y]))
        clips.append(frames)
        seconds.append(took / len(photograph))
    at_once = []
    for photograph in photographs:
        video.restart()
        at_once.append(clocked(partial(video.frames, photograph))[0] / len(photograph))
    errors = [
        [ps.mean_squared_error(f, t) for f, t in zip(frames, truth, strict=True)]
        for frames, truth in zip(clips, truths, strict=True)
    ]
    matched = [ps.gain_matched(f, t) for f, t in zip(clips[0], truths[0], strict=True)]
    return Coupled(
        np.stack(matched), np.array(errors), 1 / np.median(seconds), 1 / np.median(at_once)
    )


def _section(setting: Setting, found: dict[str, Coupled], at_rest: dict[str, Coupled]) -> Section:
    paper = found["total-variation"]

    def over_stills(results: dict[str, Coupled], name: str) -> float:
        stills = results["none"].errors[:, STEADY].mean()
        return float(results[name].errors[:, STEADY].mean() / stills)

    def fall(results: dict[str, Coupled]) -> tuple[str, bool]:
        errors = results["total-variation"].errors
        falls = errors[:, 0] - errors[:, STEADY].mean(axis=1)
        text = ", ".join(f"{errors[:, k].mean():.4f}" for k in range(3))
        is_fall = falls.mean() > 2 * falls.std(ddof=1) / np.sqrt(STARTS)
        return f"frames 1, 2, 3: {text}; from 7 on {errors[:, STEADY].mean():.4f}", bool(is_fall)

    moving, resting = fall(found), fall(at_rest)
    return Section(
        name="fig7",
        title="Fig. 7: video",
        text=f"{HIDDEN[1]} x {HIDDEN[0]} patches, SBR {SBR} by {CONDITION.replace('_', ' ')}, "
        f"{SNR:.0f} dB, {STARTS} clips of {FRAMES} frames of a scene of our own, in which a ball "
        "moves by one to two patches a frame. One fixed rule for the weights, the same for stills "
        "and video: the rule that suits stills.",
        claims=[
            Claim(
                "rate of the reconstruction, every stage, frame by frame",
                "16 frames a second",
                f"{paper.live:.0f} (in batches {paper.batch:.0f})",
                Verdict.BETTER if paper.live > 16 else Verdict.DIFFERS,
                "Another machine.",
            ),
            Claim(
                "later frames are better than the first, scene in motion",
                "MSE falls over the first frames",
                moving[0],
                Verdict.of(moving[1]),
                "The second frame is better than the first; then what has moved leaves a trace, "
                "which costs as much as the averaged noise gains. How a frame compares with the "
                "first also depends on what it shows.",
            ),
            Claim(
                "the same, scene at rest",
                "MSE falls over the first frames",
                resting[0],
                Verdict.of(resting[1]),
            ),
            Claim(
                "temporal regularization helps",
                "later frames improve by it",
                "MSE from frame 7 on over that of stills: in motion "
                f"{over_stills(found, 'total-variation'):.2f} (Eq. 12 as written "
                f"{over_stills(found, 'l1'):.2f}), at rest "
                f"{over_stills(at_rest, 'total-variation'):.2f} ({over_stills(at_rest, 'l1'):.2f})",
                Verdict.of(over_stills(found, "total-variation") < 1),
                "The l1 term lets go of what has changed by more than its weight; total variation "
                "on the pair pulls every change back in proportion.",
            ),
        ],
        pictures=[
            Picture(
                setting.out / "fig7.png",
                "The first clip: photographs (white: the 99.5th percentile), hidden frames, and "
                "reconstructions, gain-matched, with their mean squared errors.",
            ),
            Picture(
                setting.out / "fig7_burn_in.png",
                f"Mean squared error of each frame, the scene in motion and at rest; lines: means "
                f"over {STARTS} clips, bands: their standard errors.",
            ),
        ],
        tables=[
            Table(
                "Mean squared error, mean over the clips, and frames a second.",
                ("coupling", "frame 1", "frame 2", "frame 3", "from 7 on", "live", "in batches"),
                [
                    (
                        COUPLINGS[name],
                        *(f"{c.errors[:, k].mean():.4f}" for k in range(3)),
                        f"{c.errors[:, STEADY].mean():.4f}",
                        f"{c.live:.0f}",
                        f"{c.batch:.0f}",
                    )
                    for name, c in found.items()
                ],
            )
        ],
    )


def _draw(setting: Setting, truth: Array, photographs: Array, found: dict[str, Coupled]) -> None:
    white = float(np.percentile(photographs, 99.5))
    with drawn(setting.out, "fig7", PAGE, 5.2) as figure:
        axes = figure.subplots(2 + len(found), len(SHOWN))
        names = ("photograph", "hidden frame", *(COUPLINGS[name] for name in found))
        for ax, name in zip(axes[:, 0], names, strict=True):
            label_row(ax, name.replace(" (", "\n("))
        for column, k in zip(axes.T, SHOWN, strict=True):
            show_light(column[0], photographs[k], white)
            column[0].set_title(f"frame {k + 1}")
            show_light(column[1], truth[k], 1)
            for ax, coupled in zip(column[2:], found.values(), strict=True):
                show_light(ax, coupled.frames[k], 1)
                ax.set_title(f"MSE {coupled.errors[0, k]:.4f}", fontsize=7)


def _draw_errors(setting: Setting, found: dict[str, Coupled], at_rest: dict[str, Coupled]) -> None:
    colors = (COLORS["preconditioned"], COLORS["differencing"], COLORS["bound"])
    with drawn(setting.out, "fig7_burn_in", PAGE, 2.3) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for ax, results, title in zip(
            panels, (found, at_rest), ("a  in motion", "b  at rest"), strict=True
        ):
            for (name, coupled), color, marker in zip(results.items(), colors, "osx", strict=True):
                style = {"color": color, "marker": marker, "label": COUPLINGS[name]}
                draw_means(ax, coupled.errors, markersize=3, **style)
            ax.set(xlabel="frame", title=title, xticks=[1, 6, 12, 18, 24])
        panels[0].set(ylabel="mean squared error", ylim=(0, None))
        panels[0].legend()
