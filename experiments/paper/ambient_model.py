"""Ambient against the model: what of rendered backgrounds lies outside the span of B (Sec. 3.1).

B holds the responses of point lights (Eq. 4); real ambient light comes from windows, lamps and
everything that they light. Several choices of B are compared: by the part of each background that
they leave, by what of it enters a reconstruction, and by what they cost in noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLUMN, PAGE, drawn
from experiments.paper.ambient_trial import SBR, Trial, percent
from experiments.paper.background_models import (
    AREA,
    FINER,
    NEARER,
    PAPER,
    POLYNOMIAL,
    RENDERED,
    Choice,
    choices,
)
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import GLASS, SNR, Setting
from periscopy_sim.evaluation.metrics import shifted
from periscopy_sim.model.ambient import RANK_TOLERANCE
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC

Array = NDArray[np.float64]
RANKS = (20, 44)
CURVES = {PAPER: "#0072B2", NEARER: "#D55E00", POLYNOMIAL: "#009E73", RENDERED: "#CC79A7"}
NOISE = "(noise of one rendering, paper's grid)"
CASES = ("median", "largest", *(name.replace("_", " ") for name in ADVERSARIAL))


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one choice of B leaves and costs.

    Attributes
    ----------
    choice
        The choice.
    rank
        Dimension kept; the largest over the conditions.
    outside
        For each condition (r + 1,) the part of its norm outside the first 0 to r basis vectors,
        beyond what Monte Carlo noise explains.
    leak
        For each condition the root mean square of P b over that of the sensor's noise in P y.
    rendering_noise
        For each condition the same of the noise of one rendering.
    bound_ratio
        Summed Cramér-Rao bounds with A alone over those with [A, B]; the smallest.
    psnr
        For each kind of photograph and condition, dB.
    """

    choice: Choice
    rank: int
    outside: Mapping[str, Array]
    leak: Mapping[str, float]
    rendering_noise: Mapping[str, float]
    bound_ratio: float
    psnr: Mapping[str, Mapping[str, float]]


def outside(Q: Array, first: Array, second: Array) -> Array:
    """Part of a background's norm outside the first k basis vectors, k = 0 to r, without its noise.

    From two renderings b₁, b₂ whose noise is independent: b₁ᵀ (I − Q_k Q_kᵀ) b₂ / b₁ᵀ b₂ is the
    squared part, on average over the noise. Its root is 0 where noise makes it negative.
    """
    b1, b2 = first.reshape(-1, 3), second.reshape(-1, 3)
    inside = np.cumsum(np.sum((Q.T @ b1) * (Q.T @ b2), axis=1)) / np.sum(b1 * b2)
    return np.asarray(np.sqrt(np.maximum(1 - np.concatenate([[0.0], inside]), 0)))


def evaluate(trial: Trial, choice: Choice) -> Outcome:
    """Try one choice of B on every background."""
    left, leak, rendering_noise, ratios = {}, {}, {}, []
    psnr: dict[str, dict[str, float]] = {kind: {} for kind in trial.measured}
    for Q, names in choice.bases:
        periscope = trial.periscope(Q)
        gain = periscope.preconditioner.noise_gain
        ratios.append(trial.bound / gain.sum())
        for name in names:
            b, again = trial.backgrounds[name], trial.again[name]
            left[name] = outside(Q, b, again)
            # The composite, of mean 1, holds this much of the background.
            pair = np.hstack([b.reshape(-1, 3), again.reshape(-1, 3)]) / (b.mean() * (1 + SBR))
            f1, f2 = np.hsplit(periscope.preconditioner.apply(pair), 2)
            y = trial.photographs["synthetic", name]
            sensor = 10 ** (-SNR / 10) * np.mean(y**2) * gain.mean()
            leak[name] = float(np.sqrt(max(np.mean(f1 * f2) / sensor, 0)))
            rendering_noise[name] = trial.share[name] * float(
                np.sqrt(np.mean((f1 - f2) ** 2) / sensor)
            )
            for kind, m in trial.measured.items():
                image = periscope.reconstruct(trial.photographs[kind, name])
                psnr[kind][name] = ps.psnr(shifted(image, *trial.shifts[kind]), m.truth)
    rank = max(Q.shape[1] for Q, _ in choice.bases)
    return Outcome(choice, rank, left, leak, rendering_noise, float(min(ratios)), psnr)


def run(setting: Setting) -> Section:
    """Compare choices of B on rendered backgrounds."""
    trial = Trial(setting)
    outcomes = {
        choice.name: evaluate(trial, choice)
        for choice in choices(trial.scenario, trial.backgrounds, REALISTIC)
    }
    draw_residuals(setting, trial)
    draw_ranks(setting, outcomes)
    return Section(
        name="ambient_model",
        title="Sec. 3.1: rendered ambient light against the span of B",
        text="Each background b is projected out by an orthonormal basis Q of each choice of B; "
        "‖(I − QQᵀ) b‖ / ‖b‖ is the part left outside. Its square is a product of two renderings "
        "of other seeds, so that Monte Carlo noise, the smooth noise of bounced light included, "
        "adds nothing on average; what is smaller than about a fifth of the noise is not resolved, "
        "nor what the renderer smooths away: it fits bounced light by polynomials. "
        f"Composites have an SBR of {SBR:g} and {SNR:g} dB. Leak is the root mean square of P b "
        "over that of the sensor's noise in P y: below 1, the noise hides what B does not hold. "
        "Other rendered backgrounds are the realistic ones but the one tried, with their flips. "
        f"Basis vectors are kept above {RANK_TOLERANCE:.0e} of B's largest singular value.",
        claims=claims(outcomes),
        pictures=[
            Picture(
                setting.out / "ambient_model.png",
                "What the paper's B leaves of each background (mean of the channels), in percent "
                "of the background's mean, on one scale that is linear within ±0.1 %; below each "
                "the norm outside the span and the noise in it, from two renderings.",
            ),
            Picture(
                setting.out / "ambient_model_rank.png",
                "Norm outside the span of the first basis vectors of four choices of B, beyond "
                "noise: the largest of the realistic conditions (solid), and "
                f"{CASES[-1]} (dotted). Dots: all vectors above the tolerance.",
            ),
        ],
        tables=[table_outside(trial, outcomes), *tables_of_images(trial, outcomes)],
    )


def median(values: Mapping[str, float]) -> float:
    """Median over the realistic conditions."""
    return float(np.median([values[name] for name in REALISTIC]))


def largest(values: Mapping[str, float]) -> float:
    """Largest over the realistic conditions."""
    return max(values[name] for name in REALISTIC)


def summary(values: Mapping[str, float], form: str = ".2f") -> list[str]:
    """Cells: median and largest of the realistic conditions, and each adversarial one."""
    cells = [median(values), largest(values), *(values[name] for name in ADVERSARIAL)]
    return [format(cell, form) for cell in cells]


def at_rank(outcome: Outcome, rank: int | None = None) -> dict[str, float]:
    """Percent of each background outside the first vectors; NaN where there are not so many."""
    return {
        name: float(100 * part[-1 if rank is None else rank])
        if rank is None or rank < len(part)
        else np.nan
        for name, part in outcome.outside.items()
    }


def table_outside(trial: Trial, outcomes: Mapping[str, Outcome]) -> Table:
    """Tabulate what lies outside at each choice's own rank, and at equal ranks."""
    return Table(
        "Norm of the background outside the span of B beyond Monte Carlo noise, in percent: median "
        "and largest of the realistic conditions, and the adversarial ones; at the rank kept, and "
        "at equal ranks.",
        (
            *("B", "columns", "rank"),
            *CASES,
            *(f"{case}, rank {rank}" for rank in RANKS for case in ("largest", CASES[-1])),
        ),
        [
            [
                *(name, str(o.choice.columns), str(o.rank)),
                *summary(at_rank(o), ".3f"),
                *(
                    f"{value:.3f}" if np.isfinite(value) else "–"
                    for rank in RANKS
                    for value in (largest(at_rank(o, rank)), at_rank(o, rank)[GLASS])
                ),
            ]
            for name, o in outcomes.items()
        ]
        + [[NOISE, "", "", *summary(trial.noise, ".3f"), *[""] * 2 * len(RANKS)]],
    )


def tables_of_images(trial: Trial, outcomes: Mapping[str, Outcome]) -> Iterator[Table]:
    """Tabulate what each choice does to reconstructions."""
    yield Table(
        "Leak, and the noise's cost: summed Cramér-Rao bounds with A alone over those with [A, B].",
        ("B", *(f"leak, {case}" for case in CASES), "ratio of bounds"),
        [
            [name, *summary(outcome.leak), f"{outcome.bound_ratio:.4f}"]
            for name, outcome in outcomes.items()
        ]
        + [[NOISE, *summary(outcomes[PAPER].rendering_noise), ""]],
    )
    for kind in trial.measured:
        yield Table(
            f"PSNR in dB of the reconstruction, {kind} photograph, one gain for each channel"
            + ("." if kind == "synthetic" else f" and the shift {trial.shifts[kind]} patches."),
            ("B", "median", "best", *CASES[2:]),
            [[name, *summary(outcome.psnr[kind])] for name, outcome in outcomes.items()],
        )


def claims(outcomes: Mapping[str, Outcome]) -> list[Claim]:
    """Return the paper's statements beside what was found."""
    paper, glass = outcomes[PAPER], GLASS
    torn = at_rank(paper)[glass]
    spared, leak = largest(at_rank(paper)), largest(paper.leak)
    how = (
        "PSNR: mean change over the realistic conditions and its standard error; 0.1 dB and two "
        f"such errors count. Outside: the largest of them (paper's grid: {spared:.3f} %)."
    )
    return [
        Claim(
            "any background lies in the span of B or extremely close to it",
            "assumed",
            f"outside: median {median(at_rank(paper)):.3f} %, at most {spared:.3f} %; leak at most "
            f"{leak:.2f} of the noise (a rendering's own noise: "
            f"{largest(paper.rendering_noise):.2f})",
            Verdict.of(leak < 1),
            f"Realistic conditions. Not so stained glass, with {torn:.1f} % outside and a leak of "
            f"{paper.leak[glass]:.0f} times the noise: no far light casts its edges.",
        ),
        _change(
            outcomes, AREA, "small area lights instead of points", "no noticeable effect", how,
            either=True,
        ),
        _change(outcomes, FINER, "finer grid, 37.5 cm", "no significant improvement", how),
        _change(
            outcomes, NEARER, "lights nearer to the wall, from 0.25 m", "may improve results",
            f"{how} The rank kept rises from {paper.rank} to {outcomes[NEARER].rank}; polynomials "
            f"of rank {outcomes[POLYNOMIAL].rank} leave "
            f"{largest(at_rank(outcomes[POLYNOMIAL])):.3f} %.",
            hoped=True,
        ),
    ]  # fmt: skip


def _change(
    outcomes: Mapping[str, Outcome],
    name: str,
    what: str,
    stated: str,
    reason: str,
    *,
    hoped: bool = False,
    either: bool = False,
) -> Claim:
    """Judge whether a choice improves reconstructions: by 0.1 dB and two standard errors.

    The claim is that it does, if so hoped, or not; or that it changes them in neither direction.
    """
    paper, other = outcomes[PAPER], outcomes[name]
    found, better = [], []
    for kind, psnr in other.psnr.items():
        change = np.array([psnr[case] - paper.psnr[kind][case] for case in REALISTIC])
        error = change.std(ddof=1) / np.sqrt(len(change))
        found.append(f"{change.mean():+.2f} ± {error:.2f} dB ({kind})")
        size = abs(change.mean()) if either else change.mean()
        better.append(size > max(0.1, 2 * error))
    return Claim(
        what,
        stated,
        f"{', '.join(found)}; outside {largest(at_rank(other)):.3f} %",
        Verdict.of(any(better) == hoped),
        reason,
    )


def draw_residuals(setting: Setting, trial: Trial) -> None:
    """Draw what the paper's B leaves of each background."""
    from matplotlib.colors import SymLogNorm
    from matplotlib.ticker import FuncFormatter

    with drawn(setting.out, "ambient_model", PAGE, 3.3) as figure:
        axes = figure.subplots(2, (len(trial.backgrounds) + 1) // 2).ravel()
        norm = SymLogNorm(0.1, vmin=-100, vmax=100)
        for ax, (name, b) in zip(axes, trial.backgrounds.items(), strict=False):
            left = trial.rejected(b)
            picture = ax.imshow(
                100 * left.mean(axis=2) / b.mean(),
                norm=norm,
                cmap="RdBu_r",
                interpolation="nearest",
            )
            ax.set_title(name.replace("_", " "))
            ax.set_xlabel(f"{percent(left, b):.2f} %, noise {trial.noise[name]:.2f} %", fontsize=7)
        for ax in axes:
            ax.set(xticks=[], yticks=[])
            ax.spines[:].set_visible(False)
        bar = figure.colorbar(picture, ax=axes, label="residual (% of mean)", aspect=30, pad=0.01)
        bar.set_ticks([-100, -10, -1, -0.1, 0, 0.1, 1, 10, 100])
        bar.minorticks_off()
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def draw_ranks(setting: Setting, outcomes: Mapping[str, Outcome]) -> None:
    """Draw the part outside against the number of basis vectors."""
    with drawn(setting.out, "ambient_model_rank", COLUMN, 2.8) as figure:
        ax: Any = figure.subplots()
        for name, color in CURVES.items():
            parts = outcomes[name].outside
            length = min(map(len, parts.values()))
            worst = np.max([parts[case][:length] for case in REALISTIC], axis=0)
            for part, style in ((worst, "-"), (parts[GLASS][:length], ":")):
                ax.semilogy(100 * part, style, color=color, label=name if style == "-" else None)
                ax.semilogy(length - 1, 100 * part[-1], "o", color=color, markersize=4)
        ax.set(xlabel="basis vectors kept of B", ylabel="outside the span (%)", xlim=(0, None))
        figure.legend(loc="outside upper center", ncols=2)
