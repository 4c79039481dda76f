"""A f with all bounces beside the path-traced photograph, in absolute scale.

The path tracer is Mitsuba's own, its bounces unbounded, in several independent renderings; A, its
pixels averaged over their area, is rendered twice, too, so that both sides' errors are known. What
differs is told over what these errors predict, and the whole photographs' totals beside it.

`python -m experiments.interreflection --out DIR --only agreement`
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, label_row, show_light
from experiments.interreflection.rooms import (
    BRIGHT,
    ROOMS,
    Array,
    Room,
    Workplace,
    both_matrices,
    photograph,
)
from experiments.page import described
from experiments.report import Claim, Picture, Section, Table, Verdict

HIDDEN = (15, 18)
SAMPLES, TRACED = 32768, 4
"""Of a pixel in a path-traced photograph, and such photographs."""

MOST_RMS, MOST_TOTAL = 1.3, 3e-4
"""Asked: over what errors predict, and relative."""

FULL = (29, 36)
MOST_SECONDS = 60.0
"""Asked of A with all bounces, of the bright room at full size."""


@dataclass(frozen=True)
class Agreement:
    """How A f stands to the path-traced photograph of one room."""

    name: str
    share: Array  # (3,) of a white image's photograph that has bounced
    rms: float  # over what both sides' errors predict
    total: float  # relative
    direct_rms: float
    direct_total: float
    noise: float  # of the path-traced mean, over its root mean square
    total_error: float  # standard error of the total
    told: float  # relative error of bounced light
    terms: int  # of the polynomial


def run(place: Workplace) -> Section:
    """Compare three rooms."""
    found = [agreement(room, place.seed) for room in ROOMS]
    seconds = full_size(BRIGHT, place.seed)
    draw_columns(place, BRIGHT)
    claims = [
        Claim(
            f"{one.name}: what A f with all bounces is off, over what both errors predict; total",
            f"at most {MOST_RMS} and {MOST_TOTAL:.0e}",
            f"{one.rms:.2f}; {one.total:+.1e} (standard error {one.total_error:.0e})",
            Verdict.of(one.rms <= MOST_RMS and abs(one.total) <= MOST_TOTAL),
            f"the direct A: {one.direct_rms:.0f}; {one.direct_total:+.1%}",
        )
        for one in found
    ]
    claims.append(
        Claim(
            "A with all bounces of the bright room, 29 x 36 patches, 126 x 126 pixels",
            f"at most {MOST_SECONDS:.0f} s on two idle cores",
            f"{seconds[0] + seconds[1]:.0f} s, of which direct light {seconds[0]:.0f} s",
            Verdict.MEASURED,
        )
    )
    rows = [
        (
            one.name,
            ", ".join(f"{share:.1%}" for share in one.share),
            f"{one.rms:.2f}",
            f"{one.total:+.1e}",
            f"{one.direct_rms:.0f}",
            f"{one.direct_total:+.1%}",
            f"{one.noise:.1e}",
            f"{one.told:.1e}",
            str(one.terms),
        )
        for one in found
    ]
    header = ("room", "has bounced (by channel)", "rms", "total", "direct A: rms", "its total",
              "noise of the photograph", "told error of bounced light", "terms")  # fmt: skip
    return Section(
        name="agreement",
        title="A f beside path-traced photographs",
        text=described(__doc__),
        claims=claims,
        tables=[Table("Rms is over what both sides' errors predict.", header, rows)],
        pictures=[
            Picture(
                place.out / "columns.png",
                "The bright room: two patches alone, direct light, what has bounced (brighter by "
                "the factor told), and both.",
            )
        ],
    )


def agreement(room: Room, seed: int) -> Agreement:
    """Compare one room's photographs."""
    scenario, image = room.at(HIDDEN, small=True), room.shown(HIDDEN)
    pairs = [both_matrices(scenario, seed + k, samples=16, pixel_samples=16) for k in range(2)]
    direct, bounced = (
        np.array([photograph(scenario, pair[k], image) for pair in pairs]) for k in range(2)
    )
    traced = np.array(
        [
            ps.render_photograph(scenario, image, samples=SAMPLES, only_monitor=True, seed=100 + k)
            for k in range(TRACED)
        ]
    )
    y, variance = traced.mean(axis=0), np.mean(traced.var(axis=0, ddof=1)) / TRACED
    predicted = np.sqrt(variance + np.mean(bounced.var(axis=0, ddof=1)) / 2)
    light = pairs[0][1].bounced
    white = light.over_wall @ light.of_patches.sum(axis=2).T
    share = white.mean(axis=0) / (pairs[0][0].sum(axis=1).mean() + white.mean(axis=0))

    def off(side: Array) -> tuple[float, float]:
        difference = side.mean(axis=0) - y
        rms = np.sqrt(np.mean(difference**2)) / predicted
        return float(rms), float(side.mean() / y.mean() - 1)

    totals = traced.mean(axis=(1, 2, 3))
    return Agreement(
        room.name,
        share,
        *off(bounced),
        *off(direct),
        noise=float(np.sqrt(variance / np.mean(y**2))),
        total_error=float(totals.std(ddof=1) / np.sqrt(TRACED) / totals.mean()),
        told=light.relative_error,
        terms=light.over_wall.shape[1],
    )


def full_size(room: Room, seed: int) -> tuple[float, float]:
    """Return the seconds that direct light and light that bounces take at full size."""
    scenario = room.at(FULL)
    ps.render_transport(room.at((2, 2), small=True))  # compiles what is compiled once
    begun = time.perf_counter()
    ps.render_transport(scenario, seed=seed)
    done = time.perf_counter()
    ps.render_bounced_light(scenario, seed=seed)
    return done - begun, time.perf_counter() - done


def draw_columns(place: Workplace, room: Room) -> None:
    """Draw `columns`: of two patches, what each sends straight, and by way of the room."""
    scenario = room.at((6, 8))
    direct, A = both_matrices(scenario, place.seed, pixel_samples=4)
    shape = (*scenario.photograph_shape, 3)
    patches = {"upper left": 0, "lower right": 47}
    with drawn(place.out, "columns", PAGE, 2 * 1.95) as figure:
        grid = figure.subplots(len(patches), 3)
        for row, (where, j) in zip(grid, patches.items(), strict=True):
            straight = np.repeat(direct[:, j, np.newaxis], 3, axis=1)
            beyond = A.bounced.over_wall @ A.bounced.of_patches[:, :, j].T
            white = float(np.percentile(straight + beyond, 99.5))
            factor = white / float(beyond.max())
            show_light(row[0], straight.reshape(shape), white)
            show_light(row[1], (factor * beyond).reshape(shape), white)
            show_light(row[2], (straight + beyond).reshape(shape), white)
            label_row(row[0], f"{where} patch")
            row[1].set_title(f"has bounced, times {factor:.0f}")
        grid[0, 0].set_title("direct light")
        grid[0, 2].set_title("both")
