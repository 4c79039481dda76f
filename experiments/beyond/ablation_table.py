"""The ablation's errors as tables, on the page and in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from experiments.beyond.ablation_cases import REAL, Case, noise_level, root_mean_square
from experiments.beyond.normal_equations import Measured, median_deviation
from experiments.report import Section, Table

MARKDOWN = "ablation.md"


@dataclass(frozen=True)
class Row:
    """One method's errors.

    Attributes
    ----------
    name, weight
        Of the method; the weight in words, "" for none.
    scores
        By case: what `Case.scores` gives.
    solves
        For one photograph.
    """

    name: str
    weight: str
    scores: Mapping[str, list[list[float]]]
    solves: str = "1"


def table(rows: Sequence[Row], tried: Sequence[Case]) -> Table:
    """Tabulate the methods' errors side by side."""
    paper = {name: np.mean(scores) for name, scores in rows[0].scores.items()}

    def cell(case: Case, row: Row) -> str:
        values = np.array(row.scores[case.name])
        if case.real:
            return " / ".join(f"{value:.2f}" for value in values.mean(axis=1))
        ratio = f"{np.mean(values) / paper[case.name]:.3f}"
        if values.size == 1:
            return f"{1e3 * np.mean(values):.2f}; {ratio}"
        told = f"{1e3 * np.mean(values):.2f} ± {1e3 * np.std(values, ddof=1):.2f}"
        return f"{told} ({1e3 * np.max(values):.2f}); {ratio}"

    return Table(
        "Rendered photographs: mean squared error in thousandths, mean ± standard deviation over "
        "the realistic backgrounds, each with its own noise (largest); mean over that of the "
        "paper's method. Last the geometric mean of those ratios over the nine realistic cases. "
        f"Columns {REAL}: gain-matched PSNR / after the best shift of at most 2 patches, dB, the "
        "first without ambient light. Columns are image or adversarial light, and SBR. * Weight "
        "chosen by the truth. Weights are relative to ‖A⊥‖_F/σ̄; for rules, which choose from a "
        "grid by factors of √2, the 10 and 90 % quantiles, and the solves that each weight takes.",
        ("method", "weight", "solves", *(case.name.replace("_", " ") for case in tried), "overall"),
        [
            [
                *(row.name, row.weight, row.solves),
                *(cell(case, row) for case in tried),
                f"{_overall(row, rows[0], tried):.3f}",
            ]
            for row in rows
        ],
    )


def summary(rows: Sequence[Row], tried: Sequence[Case]) -> Table:
    """Tabulate each method's errors, one short line each.

    Rendered cases under realistic light are taken together by their SBR, others by their name.
    """
    real = [case for case in tried if case.real]
    groups: dict[str, list[Case]] = {}
    for case in tried:
        name, _, sbr = case.name.rpartition(" ")
        if not case.real:
            groups.setdefault(f"SBR {sbr}" if case.common else name, []).append(case)

    def cells(row: Row) -> list[str]:
        ratios = [_ratio(row, rows[0], cases) for cases in groups.values()]
        quality = [np.mean(row.scores[case.name], axis=1) for case in real]
        return [
            f"{_overall(row, rows[0], tried):.3f}",
            *(f"{ratio:.3f}" for ratio in ratios),
            *(" / ".join(f"{value:.2f}" for value in pair) for pair in quality),
        ]

    caption = (
        "Rendered photographs: mean squared error over that of the paper's method, the geometric "
        "mean over images or ratios; overall, and by SBR, over the three images under realistic "
        "ambient light; then the mushroom under adversarial light over three SBRs, and with other "
        "noise. Weights are relative to ‖A⊥‖_F/σ̄; * chosen by the truth. Each case alone, with its "
        f"spread: {MARKDOWN}."
    )
    if real:
        caption += (
            f" Columns {REAL}: gain-matched PSNR / after the best shift of at most 2 patches, dB, "
            "the first without ambient light, the others at an SBR."
        )
    return Table(
        caption,
        (
            *("method", "weight", "overall"),
            *(name.replace("_", " ") for name in groups),
            *(case.name for case in real),
        ),
        [[row.name, row.weight, *cells(row)] for row in rows],
    )


def noise_table(tried: Sequence[Case], measured: Mapping[str, Measured]) -> Table:
    """Tabulate the estimates of σ beside each other."""

    def cells(case: Case) -> list[str]:
        size = root_mean_square if case.name == REAL else noise_level
        sizes = np.array([size(photograph) for photograph in case.photographs])[:, None]
        estimates = (measured[case.name].noise, median_deviation(case.photographs))
        return [
            f"{np.mean(ratio):.4f} ({np.min(ratio):.4f} to {np.max(ratio):.4f})"
            for ratio in (estimate / sizes for estimate in estimates)
        ]

    return Table(
        "Estimates of σ over the σ of the noise added; over the photograph's root mean square for "
        f"the {REAL} one without ambient light. Mean, and range over photographs and channels.",
        ("case", "what least squares leaves", "neighbouring pixels"),
        [[case.name.replace("_", " "), *cells(case)] for case in tried],
    )


def _overall(row: Row, paper: Row, tried: Sequence[Case]) -> float:
    return _ratio(row, paper, [case for case in tried if case.common])


def _ratio(row: Row, paper: Row, cases: Sequence[Case]) -> float:
    """Return the geometric mean over cases of mean errors over those of the paper's method."""
    logs = [
        np.log(np.mean(row.scores[case.name]) / np.mean(paper.scores[case.name])) for case in cases
    ]
    return float(np.exp(np.mean(logs)))


def markdown(section: Section, *more: Table) -> str:
    """Write a section's text and tables, and more tables."""
    lines = [f"# {section.title}", "", section.text]
    for claim in section.claims:
        lines += ["", f"{claim.what}: {claim.measured}"]
    for table in (*section.tables, *more):
        lines += ["", table.caption, "", "| " + " | ".join(table.header) + " |"]
        lines += ["|" + "---|" * len(table.header)]
        lines += ["| " + " | ".join(row) + " |" for row in table.rows]
    return "\n".join(lines) + "\n"
