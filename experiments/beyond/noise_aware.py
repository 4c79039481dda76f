"""The noise-aware method beside the paper's, over signal-to-background ratios.

Each photograph is taken under the realistic ambient conditions, with three draws of noise, by the
study noise_aware.yaml. Errors are as the images stand, gain-matched; of a real photograph, whose
monitor's place is known to about a patch, after the best shift of at most 2 patches.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import periscopy_sim as ps
from experiments.drawing import draw_rows
from experiments.page import described
from experiments.report import Claim, Picture, Section, Verdict
from experiments.setting import Setting
from experiments.sweeps import drawn_sweep, swept, tabulated

if TYPE_CHECKING:
    import xarray as xr

SHOWN = (10.0, 0.5, 0.05)
PAPER, OURS = METHODS = ("preconditioned", "noise-aware")
LIGHT = "overcast"
"""Under which the images shown were taken."""


def run(setting: Setting) -> Section:
    """Reconstruct every photograph by both methods."""
    kind, results = setting.measured.kind, swept(setting, __file__, setting.backgrounds())
    if kind == "real":
        results["mean_squared_error"] = 10 ** (-results["psnr_registered"] / 10)
    errors = results["mean_squared_error"]
    ratios = (errors.sel(algorithm=OURS) / errors.sel(algorithm=PAPER)).mean("seed")
    asked, means = ratios.sel(sbr=slice(0.05, None)), errors.mean(["background", "seed"])
    growth = means.sel(algorithm=OURS) / means.sel(algorithm=OURS, sbr=10)
    return Section(
        name="noise_aware",
        title="The noise-aware method over signal-to-background ratios",
        text=described(__doc__),
        claims=[
            Claim(
                "largest mean squared error over the paper's method, any realistic condition, SBR "
                f"0.05 to 10 ({kind})",
                "",
                f"{asked.max():.2f} (mean {asked.mean():.2f})",
                Verdict.MEASURED,
            ),
            Claim(
                f"mean squared error at SBR 0.05 and 0.02 over that at 10 ({kind})",
                "",
                f"{growth.sel(sbr=0.05):.2f}, {growth.sel(sbr=0.02):.2f}",
                Verdict.MEASURED,
            ),
        ],
        pictures=[
            drawn_sweep(
                setting, "noise_aware", errors,
                "Mean squared error over the ambient conditions and noise draws.",
            ),
            _draw_images(setting, results),
        ],
        tables=[
            tabulated(
                "Mean squared error, in thousandths.",
                1e3 * means.transpose("algorithm", "sbr"), ".2f",
            ),
            tabulated("Ratio of the two methods.", ratios.transpose("background", "sbr"), ".3f"),
        ],
    )  # fmt: skip


def _draw_images(setting: Setting, results: xr.Dataset) -> Picture:
    truth, reach = setting.measured.truth, 2.0 if setting.measured.kind == "real" else 0.0
    rows = {}
    for name in METHODS:
        rows[name] = [("hidden image", truth)]
        for sbr in SHOWN:
            cell = results["reconstruction"].sel(background=LIGHT, sbr=sbr, seed=0, algorithm=name)
            best = ps.registered(cell.values, truth, reach=reach)
            rows[name].append((f"SBR {sbr:g}: {best.psnr:.1f} dB", best.image))
    return draw_rows(
        setting.out, "noise_aware_images", rows,
        "Reconstructions under an overcast sky, gain-matched; real ones after the best shift.",
    )  # fmt: skip
