"""Video by the noise-aware method beside the paper's: the error of each frame, and the speed.

The clips, the ambient light and the noise are those of Fig. 7, at two signal-to-background ratios.
"""

from __future__ import annotations

from collections.abc import Sequence

import periscopy_sim as ps
from experiments.drawing import COLORS
from experiments.paper import fig7
from experiments.paper.fig7 import FILM, FRAMES, MOTION, REST, STARTS, STEADY, in_words
from experiments.report import Claim, Section, Table, Verdict
from experiments.setting import SNR, FittedScene, Setting, chair

SBRS = (0.5, 0.05)
PAPER, OURS = METHODS = "preconditioned", "noise-aware"
LINES = {"video": "-", "stills": "--"}

LIVE = 60
"""Frames a second that are asked for."""

ROUNDS = 5
"""Runs of which the median time is shown."""

Videos = dict[tuple[str, str], ps.Video | ps.NoiseAwareVideo]
"""By method, and ``video`` or ``stills``."""


def run(setting: Setting) -> Section:
    """Reconstruct every clip by both methods, coupled and not."""
    background = setting.backgrounds([fig7.CONDITION])[fig7.CONDITION]
    videos, errors = _videos(setting), {}
    for kind, (motion, truths) in enumerate(fig7.clips(setting.hidden).items()):
        for sbr in SBRS:
            taken = fig7.photographs_of(setting, truths, background, (setting.seed, kind), sbr)
            for name, video in videos.items():
                errors[motion, sbr, *name] = fig7.errors_of(video, taken, truths)
    rates = {}
    for scene in (setting, chair(FILM, setting.seed)):
        first = fig7.clips(scene.hidden)[MOTION][:1]
        taken = ROUNDS * fig7.photographs_of(scene, first, background, (setting.seed, 2))
        for (method, kind), video in _videos(scene).items():
            if kind == "video":
                rates[scene.hidden, method] = fig7.rates(video, taken)
    cases = [(motion, sbr) for motion in (MOTION, REST) for sbr in SBRS]
    steady = {each: float(values[:, STEADY].mean()) for each, values in errors.items()}
    over_stills = [steady[*c, OURS, "video"] / steady[*c, OURS, "stills"] for c in cases]
    over_paper = [steady[*c, OURS, "video"] / steady[*c, PAPER, "video"] for c in cases]
    live = rates[setting.hidden, OURS][0]
    panels = {
        f"{letter}  {motion}, SBR {sbr}": {
            f"{method}, {kind}": (
                errors[motion, sbr, method, kind],
                {"color": COLORS[method], "line": line},
            )
            for method in METHODS
            for kind, line in LINES.items()
        }
        for letter, (sbr, motion) in zip(
            "abcd", ((sbr, motion) for sbr in SBRS for motion in (MOTION, REST)), strict=True
        )
    }
    return Section(
        name="noise_aware_video",
        title="Video by the noise-aware method",
        text=f"{in_words(setting.hidden)} patches, {STARTS} clips of {FRAMES} frames, "
        f"{fig7.CONDITION.replace('_', ' ')} at SBR {SBRS[0]} and {SBRS[1]}, {SNR:.0f} dB. Each "
        "method's weights are its defaults, the same for all clips. The light is rendered; the "
        "photographs are A times the frames.",
        claims=[
            Claim(
                f"{in_words(setting.hidden)}, frame by frame",
                f"at least {LIVE} frames a second",
                f"{live:.0f} ({in_words(FILM)}: {rates[FILM, OURS][0]:.0f})",
                Verdict.of(live >= LIVE),
            ),
            Claim(
                "mean squared error from frame 7 on over that of stills, at both SBRs",
                "below 1",
                _in_words(over_stills),
                Verdict.of(max(over_stills) < 1),
                "Drawn towards the frame before by the distance of its colours, a patch stays as "
                "it was until the photograph has reason enough against it.",
            ),
            Claim(
                "the same, over that of the paper's method for video",
                "",
                _in_words(over_paper),
                Verdict.MEASURED,
            ),
        ],
        pictures=[fig7.draw_errors(setting, "noise_aware_video", panels)],
        tables=[
            Table(
                "Mean squared error from frame 7 on, mean over the clips.",
                ("method", *(f"{motion}, SBR {sbr}" for motion, sbr in cases)),
                [
                    (f"{method}, {kind}", *(f"{steady[*case, method, kind]:.1e}" for case in cases))
                    for method in METHODS
                    for kind in LINES
                ],
            ),
            Table(
                "Frames a second.",
                ("patches", "method", "one at a time", "many at once"),
                [
                    (in_words(hidden), method, *(f"{rate:.0f}" for rate in found))
                    for (hidden, method), found in rates.items()
                ],
            ),
        ],
    )


def _videos(scene: FittedScene) -> Videos:
    return {
        (PAPER, "video"): ps.Video(scene.preconditioned),
        (PAPER, "stills"): ps.Video(scene.preconditioned, coupling="none"),
        (OURS, "video"): ps.NoiseAwareVideo(scene.noise_aware),
        (OURS, "stills"): ps.NoiseAwareVideo(scene.noise_aware, coupling="none"),
    }


def _in_words(ratios: Sequence[float]) -> str:
    texts = [f"{ratio:.2f}" for ratio in ratios]
    return f"{MOTION} {texts[0]} and {texts[1]}, {REST} {texts[2]} and {texts[3]}"
