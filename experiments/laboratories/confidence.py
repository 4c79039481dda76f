"""Whether parameters that are told as determined are what they are told to be.

Over all laboratories and rulers: how many of the parameters that calibration tells as determined
lie within three of its standard errors of the truth.

`python -m experiments.laboratories --only confidence --out DIR`
"""

from __future__ import annotations

from collections.abc import Sequence

from experiments.laboratories.stages import Parameter, Way, Workplace, all_ways
from experiments.page import described
from experiments.report import Claim, Section, Table, Verdict

ERRORS = 3.0
ASKED = 0.95


def run(place: Workplace) -> Section:
    """Count over all laboratories and rulers."""
    ways = all_ways(place)
    determined = told_as_determined(ways)
    return Section(
        name="confidence",
        title="Nothing confidently wrong",
        text=described(__doc__),
        claims=[claim(determined)],
        tables=[_table(ways)],
    )


def told_as_determined(ways: Sequence[Way]) -> list[Parameter]:
    """Return the parameters that are told as determined."""
    return [each for way in ways for each in way.parameters if each.determined]


def claim(determined: Sequence[Parameter]) -> Claim:
    """Return the share of parameters within three told errors beside what was asked."""
    within = sum(each.strays <= ERRORS for each in determined)
    share = within / len(determined) if determined else 1.0
    return Claim(
        f"parameters told as determined that lie within {ERRORS:.0f} told errors",
        f"at least {100 * ASKED:.0f} %",
        f"{within} of {len(determined)}",
        Verdict.of(share >= ASKED),
    )


def _table(ways: Sequence[Way]) -> Table:
    rows = []
    for gone in ways:
        determined = told_as_determined([gone])
        furthest = max(determined, key=lambda each: each.strays, default=None)
        rows.append(
            [
                gone.laboratory,
                str(gone.ruler),
                f"{len(determined)} of {len(gone.parameters)}",
                f"{furthest.strays:.1f} ({furthest.name})" if furthest else "none",
                "yes" if gone.trusted else "; ".join(gone.doubts) or "failed",
            ]
        )
    return Table(
        "Parameters told as determined, and the furthest of them, in told errors",
        ["laboratory", "ruler", "determined", "furthest", "trusted"],
        rows,
    )
