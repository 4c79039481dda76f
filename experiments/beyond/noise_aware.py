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
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import Setting
from experiments.sweeps import drawn_sweep, swept

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
    paper, ours = (results["mean_squared_error"].sel(algorithm=name) for name in METHODS)
    ratios = (ours / paper).mean("seed")
    asked, means = ratios.sel(sbr=slice(0.05, None)), ours.mean(["background", "seed"])
    growth = (f"{means.sel(sbr=low) / means.sel(sbr=10):.2f}" for low in (0.05, 0.02))
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
                ", ".join(growth),
                Verdict.MEASURED,
            ),
        ],
        pictures=[
            drawn_sweep(
                setting, "noise_aware", results,
                "Mean squared error over the ambient conditions and noise draws.",
            ),
            _draw_images(setting, results),
        ],
        tables=[_table(paper, ours, ratios)],
    )  # fmt: skip


def _table(paper: xr.DataArray, ours: xr.DataArray, ratios: xr.DataArray) -> Table:
    def cell(errors: xr.DataArray) -> str:
        return f"{1e3 * errors.mean():.2f} ± {1e3 * errors.std():.2f}"

    return Table(
        "Mean squared error in thousandths (± standard deviation over conditions and draws), and "
        "the ratio of the two methods.",
        ("SBR", "the paper's method", "noise-aware", "ratio", "worst condition"),
        [
            (
                f"{sbr:g}",
                cell(paper.sel(sbr=sbr)),
                cell(ours.sel(sbr=sbr)),
                f"{ratios.sel(sbr=sbr).mean():.3f}",
                f"{ratios.sel(sbr=sbr).max():.3f}",
            )
            for sbr in ratios["sbr"].values
        ],
    )


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
