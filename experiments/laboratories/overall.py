"""What calibration is worth, over all laboratories and rulers.

The tables compare the calibrated scene's picture, made with a photograph of the monitor off, with
that from the true scene with an even wall, made without and with one, and with that from the
ruler's own scene, made with one; and the parameters that calibration reports as determined with the
true ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from experiments.laboratories.stages import (
    BACKGROUND,
    CALIBRATED,
    KINDS,
    LEAST_WON,
    MOST_LOST,
    TRUE,
    TRUE_OFF,
    Parameter,
    Way,
    Workplace,
    all_ways,
    won,
)
from experiments.page import described
from experiments.report import Claim, Section, Table, Verdict

ERRORS = 3.0
"""Reported standard errors within which a determined parameter should lie."""

ASKED = 0.95
"""Fraction of the determined parameters that should."""


def run(place: Workplace) -> Section:
    """Compare over all laboratories and rulers."""
    ways = all_ways(place)
    return Section(
        name="overall",
        title="What calibration is worth",
        text=described(__doc__),
        claims=[loss(ways), *harm(ways), confidence(ways)],
        tables=[_pictures_table(ways), _parameters_table(ways)],
    )


def loss(ways: Sequence[Way]) -> Claim:
    """Return the median loss on the true scene beside the limit; NaN if a step failed."""
    true, off = (-won(ways, CALIBRATED, best, "registered") for best in (TRUE, TRUE_OFF))
    median = float(np.median(true))
    return Claim(
        "what the calibrated scene's picture loses on the true scene's with an even wall, "
        f"{KINDS['registered']}: median over {len(ways)} ways",
        f"at most {MOST_LOST:g} dB",
        f"{median:.1f} dB",
        Verdict.of(median <= MOST_LOST),
        f"from {true.min():.1f} to {true.max():.1f} dB; where the true scene has the photograph of "
        f"the monitor off too, {float(np.median(off)):.1f} dB",
    )


def harm(ways: Sequence[Way]) -> Iterator[Claim]:
    """Return how often calibration ends worse than the ruler's scene, or fails."""
    for kind, words in KINDS.items():
        gained = won(ways, CALIBRATED, BACKGROUND, kind)
        worse = int(np.sum(~(gained >= LEAST_WON)))  # NaN, of a failure, is worse
        yield Claim(
            f"calibrations that end more than {-LEAST_WON:g} dB below the ruler's scene, {words}",
            "none",
            f"{worse} of {len(ways)}",
            Verdict.of(worse == 0),
            f"wins {gained.min():.1f} to {gained.max():.1f} dB, {np.median(gained):.1f} dB in the "
            "median",
        )


def confidence(ways: Sequence[Way]) -> Claim:
    """Return how many of the determined parameters lie within `ERRORS` of the true values."""
    determined = [each for way in ways for each in _determined(way)]
    within = sum(each.strays <= ERRORS for each in determined)
    share = within / len(determined) if determined else 1.0
    return Claim(
        f"determined parameters within {ERRORS:.0f} standard errors",
        f"at least {100 * ASKED:.0f} %",
        f"{within} of {len(determined)}",
        Verdict.of(share >= ASKED),
    )


def _determined(way: Way) -> list[Parameter]:
    return [each for each in way.parameters if each.determined]


def _pictures_table(ways: Sequence[Way]) -> Table:
    lost = [-won(ways, CALIBRATED, best, "registered") for best in (TRUE, TRUE_OFF)]
    gained = [won(ways, CALIBRATED, BACKGROUND, kind) for kind in KINDS]
    return Table(
        "dB that the calibrated scene's picture loses on the true scene's with an even wall, "
        f"{KINDS['registered']}, and that it wins on the ruler's scene's",
        [
            "laboratory",
            "ruler",
            f"loses on {TRUE}",
            f"on {TRUE_OFF}",
            *(f"wins, {words}" for words in KINDS.values()),
        ],
        [
            [way.laboratory, str(way.ruler), *(f"{number:.1f}" for number in numbers)]
            for way, *numbers in zip(ways, *lost, *gained, strict=True)
        ],
    )


def _parameters_table(ways: Sequence[Way]) -> Table:
    rows = []
    for way in ways:
        determined = _determined(way)
        furthest = max(determined, key=lambda each: each.strays, default=None)
        rows.append(
            [
                way.laboratory,
                str(way.ruler),
                f"{len(determined)} of {len(way.parameters)}",
                f"{furthest.strays:.1f} ({furthest.name})" if furthest else "none",
                "yes" if way.trusted else "; ".join(way.doubts) or "failed",
            ]
        )
    return Table(
        "Determined parameters, and the furthest from its true value, in standard errors",
        ["laboratory", "ruler", "determined", "furthest", "trusted"],
        rows,
    )
