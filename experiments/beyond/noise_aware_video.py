"""Video by the noise-aware method beside the paper's: the error of each frame, and the speed.

The clips, the ambient light and the noise are those of Fig. 7, at two signal-to-background ratios.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, draw_means, drawn
from experiments.paper.fig7 import CONDITION, FRAMES, STARTS, STEADY, photographs_of
from experiments.paper.moving_scene import clip
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import SNR, Chair, Setting
from experiments.timing import median_seconds
from periscopy_sim.figures.style import plain_ticks

Array = NDArray[np.float64]
AnyVideo = ps.Video | ps.NoiseAwareVideo
Errors = Mapping[tuple[str, float, str, str], Array]
"""(clips, F) mean squared errors by motion, SBR, method and coupling."""

Rates = Mapping[tuple[tuple[int, int], str], tuple[float, float]]
"""Frames a second, one at a time and many at once, by the hidden image's size and method."""

FILM = (40, 55)
SBRS = (0.5, 0.05)
MOTION, REST = "in motion", "at rest"
PAPER, OURS = "preconditioned", "noise-aware"
VIDEO, STILLS = "video", "stills"
CURVES = {PAPER: COLORS["preconditioned"], OURS: COLORS["noise-aware"]}
LINES = {VIDEO: "-", STILLS: "--"}

LIVE = 60
"""Frames a second that are asked for."""

ROUNDS = 5
"""Runs of which the median time is shown."""


def run(setting: Setting) -> Section:
    """Reconstruct every clip by both methods, coupled and not."""
    scenario, background = setting.scenario, setting.backgrounds([CONDITION])[CONDITION]
    photographed = partial(photographs_of, setting.A, scenario.channel_gain, background=background)
    videos = _videos(setting)
    moving = [clip(setting.hidden, FRAMES, start=0.6 * number) for number in range(STARTS)]
    clips = {MOTION: moving, REST: [frames[[0] * FRAMES] for frames in moving]}
    errors = {}
    for kind, (motion, truths) in enumerate(clips.items()):
        for sbr in SBRS:
            taken = [
                photographed(truth=truth, seed=(setting.seed, kind, number), sbr=sbr)
                for number, truth in enumerate(truths)
            ]
            for name, video in videos.items():
                errors[motion, sbr, *name] = _errors(video, taken, truths)
    rates = {
        **_rates(setting, background),
        **_rates(Chair(FILM, setting.seed), background),
    }
    _draw(setting, errors)
    return _section(setting, errors, rates)


def _videos(chair: Chair) -> dict[tuple[str, str], AnyVideo]:
    return {
        (PAPER, VIDEO): ps.Video(chair.preconditioned),
        (PAPER, STILLS): ps.Video(chair.preconditioned, coupling="none"),
        (OURS, VIDEO): ps.NoiseAwareVideo(chair.noise_aware),
        (OURS, STILLS): ps.NoiseAwareVideo(chair.noise_aware, coupling="none"),
    }


def _errors(video: AnyVideo, photographs: Sequence[Array], truths: Sequence[Array]) -> Array:
    """Mean squared error of each frame: (clips, F)."""
    errors = []
    for taken, truth in zip(photographs, truths, strict=True):
        video.restart()
        frames = video.frames(taken)
        errors.append([ps.mean_squared_error(f, t) for f, t in zip(frames, truth, strict=True)])
    return np.array(errors)


def _rates(chair: Chair, background: Array) -> Rates:
    """Time both methods on a moving clip at the first SBR."""
    gain, truth = chair.scenario.channel_gain, clip(chair.hidden, FRAMES)
    taken = photographs_of(chair.A, gain, truth, background, (chair.seed, 2, 0))
    videos = _videos(chair)

    def one_at_a_time(video: AnyVideo) -> None:
        for y in taken:
            video.next_frame(y)

    def at_once(video: AnyVideo) -> None:
        video.frames(taken)

    def rate(video: AnyVideo, recover: Callable[[AnyVideo], None]) -> float:
        def anew() -> None:
            video.restart()
            recover(video)

        return FRAMES / median_seconds(anew, ROUNDS)

    coupled = {method: videos[method, VIDEO] for method in (PAPER, OURS)}
    return {
        (chair.hidden, method): (rate(video, one_at_a_time), rate(video, at_once))
        for method, video in coupled.items()
    }


def _section(setting: Setting, errors: Errors, rates: Rates) -> Section:
    cases = [(motion, sbr) for motion in (MOTION, REST) for sbr in SBRS]

    def steady(case: tuple[str, float], method: str, coupling: str) -> float:
        return float(errors[*case, method, coupling][:, STEADY].mean())

    def ratios_text(ratios: Sequence[float]) -> str:
        texts = [f"{ratio:.2f}" for ratio in ratios]
        return f"{MOTION} {texts[0]} and {texts[1]}, {REST} {texts[2]} and {texts[3]}"

    live = rates[setting.hidden, OURS][0]
    over_stills = [steady(case, OURS, VIDEO) / steady(case, OURS, STILLS) for case in cases]
    over_paper = [steady(case, OURS, VIDEO) / steady(case, PAPER, VIDEO) for case in cases]
    return Section(
        name="noise_aware_video",
        title="Video by the noise-aware method",
        text=f"{_size(setting.hidden)} patches, {STARTS} clips of {FRAMES} frames, "
        f"{CONDITION.replace('_', ' ')} at SBR {SBRS[0]} and {SBRS[1]}, {SNR:.0f} dB. Each "
        "method's weights are its defaults, the same for all clips. The light is rendered; the "
        "photographs are A times the frames.",
        claims=[
            Claim(
                f"{_size(setting.hidden)}, frame by frame",
                f"at least {LIVE} frames a second",
                f"{live:.0f} ({_size(FILM)}: {rates[FILM, OURS][0]:.0f})",
                Verdict.of(live >= LIVE),
            ),
            Claim(
                "mean squared error from frame 7 on over that of stills, at both SBRs",
                "below 1",
                ratios_text(over_stills),
                Verdict.of(max(over_stills) < 1),
                "Drawn towards the frame before by the distance of its colours, a patch stays as "
                "it was until the photograph has reason enough against it.",
            ),
            Claim(
                "the same, over that of the paper's method for video",
                "",
                ratios_text(over_paper),
                Verdict.MEASURED,
            ),
        ],
        pictures=[
            Picture(
                setting.out / "noise_aware_video.png",
                f"Mean squared error of each frame; lines: means over {STARTS} clips, bands: "
                "their standard errors.",
            )
        ],
        tables=[
            Table(
                "Mean squared error from frame 7 on, mean over the clips.",
                ("method", *(f"{motion}, SBR {sbr}" for motion, sbr in cases)),
                [
                    (f"{method}, {kind}", *(f"{steady(case, method, kind):.1e}" for case in cases))
                    for method in CURVES
                    for kind in LINES
                ],
            ),
            Table(
                "Frames a second.",
                ("patches", "method", "one at a time", "many at once"),
                [
                    (_size(hidden), method, *(f"{rate:.0f}" for rate in found))
                    for (hidden, method), found in rates.items()
                ],
            ),
        ],
    )


def _size(hidden: tuple[int, int]) -> str:
    return f"{hidden[1]} x {hidden[0]}"


def _draw(setting: Setting, errors: Errors) -> None:
    with drawn(setting.out, "noise_aware_video", PAGE, 4.2) as figure:
        panels = figure.subplots(len(SBRS), 2, sharex=True, sharey=True)
        for row, sbr, letters in zip(panels, SBRS, ("ab", "cd"), strict=True):
            for ax, motion, letter in zip(row, (MOTION, REST), letters, strict=True):
                for method, color in CURVES.items():
                    for kind, line in LINES.items():
                        values = errors[motion, sbr, method, kind]
                        draw_means(ax, values, line, color=color, label=f"{method}, {kind}")
                ax.set(title=f"{letter}  {motion}, SBR {sbr}", yscale="log")
                ax.set(xticks=[1, 6, 12, 18, 24], xlim=(1, FRAMES))
            row[0].set(ylabel="mean squared error")
        for ax in panels[-1]:
            ax.set(xlabel="frame")
        plain_ticks(panels[0, 0].yaxis)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=4)
