"""Video by the noise-aware method beside the paper's: the error of each frame, and the speed.

The clips, the ambient light and the noise are those of Fig. 7, at two signal-to-background ratios.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import periscopy_sim as ps
from experiments.paper import fig7
from experiments.paper.fig7 import FILM, FRAMES, MOTION, REST, STARTS, in_words
from experiments.report import Claim, Section, Table, Verdict
from experiments.setting import SNR, FittedScene, Setting, chair
from experiments.sweeps import tabulated

if TYPE_CHECKING:
    import xarray as xr

SBRS = (0.5, 0.05)
PAPER, OURS = METHODS = "preconditioned, video", "noise-aware, video"
STILLS = "noise-aware, stills"

LIVE = 60
"""Frames a second that are asked for."""

ROUNDS = 5
"""Runs of which the median time is shown."""


def run(setting: Setting) -> Section:
    """Reconstruct every clip by both methods, coupled and not."""
    background = setting.backgrounds([fig7.CONDITION])[fig7.CONDITION]
    taken, truths = {}, {}
    for kind, (motion, shown) in enumerate(fig7.clips(setting.hidden).items()):
        for sbr in SBRS:
            name, seed = f"{motion}, SBR {sbr}", (setting.seed, kind)
            taken[name] = fig7.photographs_of(setting, shown, background, seed, sbr)
            truths[name] = shown
    errors = fig7.errors_of(_videos(setting), taken, truths)
    later = fig7.steady(errors)
    over_stills, over_paper = (
        later.sel(algorithm=OURS) / later.sel(algorithm=n) for n in (STILLS, PAPER)
    )
    rates = {}
    for scene in (setting, chair(FILM, setting.seed)):
        first = fig7.clips(scene.hidden)[MOTION][:1]
        photographs = ROUNDS * fig7.photographs_of(scene, first, background, (setting.seed, 2))
        for method in METHODS:
            rates[scene.hidden, method] = fig7.rates(_videos(scene)[method], photographs)
    live = rates[setting.hidden, OURS][0]
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
                Verdict.of(bool(over_stills.max() < 1)),
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
        pictures=[fig7.drawn_errors(setting, "noise_aware_video", errors)],
        tables=[
            tabulated("Mean squared error from frame 7 on, mean over the clips.", later, ".1e"),
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


def _videos(scene: FittedScene) -> dict[str, ps.Video | ps.NoiseAwareVideo]:
    return {
        PAPER: ps.Video(scene.preconditioned),
        "preconditioned, stills": ps.Video(scene.preconditioned, coupling="none"),
        OURS: ps.NoiseAwareVideo(scene.noise_aware),
        STILLS: ps.NoiseAwareVideo(scene.noise_aware, coupling="none"),
    }


def _in_words(ratios: xr.DataArray) -> str:
    texts = [f"{ratio:.2f}" for ratio in ratios]
    return f"{MOTION} {texts[0]} and {texts[1]}, {REST} {texts[2]} and {texts[3]}"
