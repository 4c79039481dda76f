"""Fig. 5: adversarial ambient light, where it comes from, and what it does to the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, show_light
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import GLASS, NO_BEAM, SNR, Setting

Array = NDArray[np.float64]

SBR = 0.25
PLACES = {
    GLASS: "stained glass, sunbeam",
    NO_BEAM: "stained glass, no beam",
    "snow": "sun and snow",
}


@dataclass(frozen=True, eq=False)
class Trial:
    """One place: its picture, its light, the photograph and what becomes of it."""

    place: Array
    background: Array
    photograph: Array
    image: Array
    twin: Array


def run(setting: Setting) -> Section:
    """Reconstruct under adversarial light."""
    measured = setting.measured
    trials = {}
    for name, background in setting.adversarial.items():
        y = setting.photograph(background, SBR, name)
        trials[name] = Trial(
            setting.place(name),
            background,
            y,
            setting.preconditioned.reconstruct(y),
            setting.differencing.reconstruct(y),
        )
    _draw(setting, trials)
    truth = measured.truth
    realistic = float(
        np.median(
            [
                ps.mean_squared_error(
                    setting.preconditioned.reconstruct(setting.photograph(b, SBR, name)), truth
                )
                for name, b in setting.backgrounds().items()
            ]
        )
    )
    errors = {name: ps.mean_squared_error(t.image, truth) for name, t in trials.items()}
    holds = {name: error < 1.5 * realistic for name, error in errors.items()}
    claims = []
    for name, trial in trials.items():
        reason = ""
        if name == GLASS and holds[NO_BEAM] and not holds[GLASS]:
            reason = (
                "Edges of sunlight on the wall itself are like penumbrae, and no far light of B "
                "makes them. The window alone, below, does no harm: the paper's board stood in "
                "such light, not in the beam."
            )
        claims.append(
            Claim(
                f"recovered under {PLACES[name]} (SBR {SBR}, mean squared error)",
                "recognizable, Fig. 5d",
                f"{errors[name]:.3f}; realistic light, median: {realistic:.3f}; differencing "
                f"{ps.mean_squared_error(trial.twin, truth):.3f}",
                Verdict.of(holds[name]),
                reason,
            )
        )
    return Section(
        name="fig5",
        title="Fig. 5: adversarial ambient light",
        text=f"Composites of the {'real' if measured.real else 'path-traced'} photograph at SBR "
        f"{SBR}, {SNR:.0f} dB. The church is rendered twice: with the sun shining through the "
        "glass on to the wall, and with the window's own coloured light alone.",
        claims=claims,
        pictures=[
            Picture(
                setting.out / "fig5.png",
                "a: the place, with the board. b: its light on the wall, each channel from its "
                "least to its greatest value. c: composite (white: the 99.5th percentile). d: "
                "proposed. e: differencing, converged; both gain-matched.",
            )
        ],
        tables=[_table(setting, trials)],
    )


def _table(setting: Setting, trials: dict[str, Trial]) -> Table:
    P, truth = setting.preconditioned.preconditioner, setting.measured.truth
    rows = []
    for name, trial in trials.items():
        b = trial.background.reshape(-1, 3)
        outside = np.linalg.norm(P.project_out(b)) / np.linalg.norm(b)
        errors = [ps.mean_squared_error(image, truth) for image in (trial.image, trial.twin)]
        rows.append((PLACES[name], f"{100 * outside:.3f} %", *(f"{e:.4f}" for e in errors)))
    return Table(
        "Part of the light outside range(B), Monte Carlo noise included, and mean squared errors "
        f"at SBR {SBR}.",
        ("place", "outside range(B)", "proposed", "differencing"),
        rows,
    )


def _draw(setting: Setting, trials: dict[str, Trial]) -> None:
    truth = setting.measured.truth
    with drawn(setting.out, "fig5", PAGE, 4.1) as figure:
        axes = figure.subplots(len(trials), 5, width_ratios=[1.33, 1, 1, 1.24, 1.24])
        for row, (name, trial) in zip(axes, trials.items(), strict=True):
            # Of the sunlit paper and the bright glass some is left white, so that the rest is seen.
            show_light(row[0], trial.place, float(np.percentile(trial.place, 98)))
            light = trial.background - trial.background.min(axis=(0, 1))
            show_light(row[1], light / light.max(axis=(0, 1)), 1)
            show_light(row[2], trial.photograph)
            for ax, image in zip(row[3:], (trial.image, trial.twin), strict=True):
                show_light(ax, ps.gain_matched(image, truth), 1)
                ax.set_title(f"MSE {ps.mean_squared_error(image, truth):.3f}")
            row[0].set_title(PLACES[name])
        for ax, letter in zip(axes[0], "abcde", strict=True):
            ax.text(0, 1.2, letter, transform=ax.transAxes, fontweight="bold")
