"""What calibration is worth, over all laboratories and rulers.

The calibrated scene's picture, made with a photograph of the monitor off, beside that from the true
scene with an even wall, made without and with one, and beside that from the ruler's own scene, made
with one. How far the parameters are to be believed is told under “confidence”.

`python -m experiments.laboratories --only overall --out DIR`
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
    Way,
    Workplace,
    all_ways,
    won,
)
from experiments.page import described
from experiments.report import Claim, Section, Table, Verdict


def run(place: Workplace) -> Section:
    """Compare over all laboratories and rulers."""
    ways = all_ways(place)
    return Section(
        name="overall",
        title="What calibration is worth",
        text=described(__doc__),
        claims=[loss(ways), *harm(ways)],
        tables=[_table(ways)],
    )


def loss(ways: Sequence[Way]) -> Claim:
    """Return the median loss on the true scene beside what was asked; NaN if a step failed."""
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
    for kind, told in KINDS.items():
        gained = won(ways, CALIBRATED, BACKGROUND, kind)
        worse = int(np.sum(~(gained >= LEAST_WON)))  # NaN, of a failure, is worse
        yield Claim(
            f"calibrations that end more than {-LEAST_WON:g} dB below the ruler's scene, {told}",
            "none",
            f"{worse} of {len(ways)}",
            Verdict.of(worse == 0),
            f"wins {gained.min():.1f} to {gained.max():.1f} dB, {np.median(gained):.1f} dB in the "
            "median",
        )


def _table(ways: Sequence[Way]) -> Table:
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
            *(f"wins, {told}" for told in KINDS.values()),
        ],
        [
            [gone.laboratory, str(gone.ruler), *(f"{number:.1f}" for number in numbers)]
            for gone, *numbers in zip(ways, *lost, *gained, strict=True)
        ],
    )
