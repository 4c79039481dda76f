"""The noise-aware method beside the paper's, over signal-to-background ratios.

Each photograph is taken under the realistic ambient conditions, with three draws of noise; bands
hold nine tenths of them. Errors are as the images stand, gain-matched; of a real photograph, whose
monitor's place is known to about a patch, after the best shift of at most 2 patches.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, drawn, label_row, show_light
from experiments.page import described
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import Setting
from experiments.sweeps import errors_of, of_method, swept
from periscopy_sim.figures.style import plain_ticks

Array = NDArray[np.float64]

SBRS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 4.0, 10.0)
DRAWS = 3
SHOWN = (10.0, 0.5, 0.05)
PAPER, OURS = METHODS = ("preconditioned", "noise-aware")
LIGHT = "overcast"
"""Under which the images shown were taken."""


def run(setting: Setting) -> Section:
    """Reconstruct every photograph by both methods."""
    methods = {PAPER: setting.preconditioned, OURS: setting.noise_aware}
    measured = {"rendered": setting.synthetic}
    if setting.measured.real:
        measured["real"] = setting.measured
    errors: dict[tuple[str, str], Array] = {}
    shown: dict[tuple[str, float, str], Array] = {}
    for kind, it in measured.items():
        name = f"noise_aware_{kind}"
        results = swept(setting, name, it, methods, setting.backgrounds(), SBRS, DRAWS)
        for method in methods:
            errors[kind, method] = errors_of(results, method, registered=it.real)
            images = of_method(results, method)["reconstruction"]
            for sbr in SHOWN:
                shown[kind, sbr, method] = images.sel(background=LIGHT, sbr=sbr, seed=0).values
    _draw_errors(setting, errors, tuple(measured))
    _draw_images(setting, shown, tuple(measured))
    return Section(
        name="noise_aware",
        title="The noise-aware method over signal-to-background ratios",
        text=described(__doc__),
        claims=list(_claims(errors, tuple(measured))),
        pictures=[
            Picture(
                setting.out / "noise_aware.png",
                "Mean squared error over the ambient conditions and noise draws: mean (line), nine "
                "tenths of them (band), the worst condition (dots).",
            ),
            Picture(
                setting.out / "noise_aware_images.png",
                "Reconstructions under an overcast sky, gain-matched; real ones after the best "
                "shift.",
            ),
        ],
        tables=[_table(errors, kind) for kind in measured],
    )


def _claims(errors: Mapping[tuple[str, str], Array], kinds: tuple[str, ...]) -> list[Claim]:
    ratios = (errors["rendered", OURS] / errors["rendered", PAPER]).mean(axis=2)
    asked = [i for i, sbr in enumerate(SBRS) if sbr >= 0.05]
    worst = ratios[asked].max()
    claims = [
        Claim(
            "largest mean squared error over the paper's method, any realistic condition, SBR 0.05 "
            "to 10",
            "",
            f"{worst:.2f} (mean {ratios[asked].mean():.2f})",
            Verdict.MEASURED,
        )
    ]
    for kind in kinds:
        means = dict(zip(SBRS, errors[kind, OURS].mean(axis=(1, 2)), strict=True))
        claims.append(
            Claim(
                f"{kind}: mean squared error at SBR 0.05 and 0.02 over that at 10",
                "",
                f"{means[0.05] / means[10.0]:.2f}, {means[0.02] / means[10.0]:.2f}",
                Verdict.MEASURED,
            )
        )
    return claims


def _table(errors: Mapping[tuple[str, str], Array], kind: str) -> Table:
    rows = []
    for i, sbr in enumerate(SBRS):
        ours, paper = errors[kind, OURS][i], errors[kind, PAPER][i]
        ratios = (ours / paper).mean(axis=1)
        rows.append(
            (
                f"{sbr:g}",
                f"{1e3 * paper.mean():.2f} ± {1e3 * paper.std():.2f}",
                f"{1e3 * ours.mean():.2f} ± {1e3 * ours.std():.2f}",
                f"{ratios.mean():.3f}",
                f"{ratios.max():.3f}",
            )
        )
    return Table(
        f"The {kind} photograph: mean squared error in thousandths (± standard deviation over "
        "conditions and draws), and the ratio of the two methods.",
        ("SBR", "the paper's method", "noise-aware", "ratio", "worst condition"),
        rows,
    )


def _draw_errors(
    setting: Setting, errors: Mapping[tuple[str, str], Array], kinds: tuple[str, ...]
) -> None:
    with drawn(setting.out, "noise_aware", PAGE, 2.6) as figure:
        axes = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
        for ax, kind in zip(axes, kinds, strict=True):
            for name in METHODS:
                values = errors[kind, name].reshape(len(SBRS), -1)
                low, high = np.percentile(values, [5, 95], axis=1)
                ax.fill_between(SBRS, low, high, color=COLORS[name], alpha=0.25, linewidth=0)
                ax.plot(SBRS, values.mean(axis=1), color=COLORS[name], label=name)
                worst = errors[kind, name].mean(axis=2).max(axis=1)
                ax.plot(SBRS, worst, ".", color=COLORS[name], markersize=3)
            ax.set(xscale="log", yscale="log", xlabel="SBR", title=f"{kind} photograph")
            ax.set_xticks([0.02, 0.1, 1, 10], ["0.02", "0.1", "1", "10"])
            ax.grid(visible=True, which="major", linewidth=0.3)
        axes[0].set_ylabel("mean squared error")
        plain_ticks(axes[0].yaxis)
        axes[0].legend()


def _draw_images(
    setting: Setting, shown: Mapping[tuple[str, float, str], Array], kinds: tuple[str, ...]
) -> None:
    with drawn(setting.out, "noise_aware_images", PAGE, 1.55 * 2 * len(kinds)) as figure:
        rows = [(kind, name) for kind in kinds for name in METHODS]
        grid = figure.subplots(len(rows), 1 + len(SHOWN))
        for row, (kind, name) in zip(grid, rows, strict=True):
            truth = (setting.measured if kind == "real" else setting.synthetic).truth
            show_light(row[0], truth, 1)
            row[0].set_title(f"hidden image ({kind})" if name == PAPER else "")
            label_row(row[0], name)
            for ax, sbr in zip(row[1:], SHOWN, strict=True):
                image = shown[kind, sbr, name]
                if kind == "real":
                    best = ps.registered(image, truth)
                    matched, error = best.image, best.psnr
                else:
                    matched = ps.gain_matched(image, truth)
                    error = ps.psnr_gain_matched(image, truth)
                show_light(ax, matched, 1)
                ax.set_title(f"SBR {sbr:g}: {error:.1f} dB")
