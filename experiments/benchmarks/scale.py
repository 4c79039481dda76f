"""How the cost of A and of P grows with the number of patches, and beside what it stands."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.benchmarks import peers
from experiments.benchmarks.machine_limits import Limits, machine_limits
from experiments.benchmarks.scene import SIZES, SMALL, compare
from experiments.drawing import COLUMN, drawn
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import Chair, Setting
from experiments.timing import median_seconds
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner

Array = NDArray[np.float64]
Costs = dict[str, dict[int, float]]
"""Seconds by task and number of patches."""

REPEATED = 43 * 54
"""Up to so many patches what takes seconds is repeated; pinv of 90 x 72 patches takes minutes."""

STYLES = {
    "A, 16 samples": ("#009E73", "^-"),
    "P factored": ("#0072B2", "o-"),
    "P explicit": ("#56B4E9", "s-"),
    "pinv([A, B])": ("#D55E00", "x-"),
}


def scale(setting: Setting) -> Section:
    """Render A and form P at four sizes, against pinv([A, B])."""
    limits = machine_limits()
    costs: Costs = {name: {} for name in STYLES}
    errors = {}
    for hidden in SIZES:
        scene, N = Chair(hidden), hidden[0] * hidden[1]
        runs = 5 if N <= REPEATED else 1
        render = partial(ps.render_transport, scene.scenario)
        costs["A, 16 samples"][N] = median_seconds(render, 3)
        A, B = scene.A, scene.B
        factored = median_seconds(partial(form_preconditioner, A, B), runs)
        P = form_preconditioner(A, B)
        costs["P factored"][N] = factored
        costs["P explicit"][N] = factored + median_seconds(P.matrix, runs)
        errors[N] = _identity_error(P.matrix(), P.A)
        del P
        inverse = partial(peers.pinv_preconditioner, A.astype(np.float64), B)
        costs["pinv([A, B])"][N] = median_seconds(inverse, 1, warm=N <= REPEATED)
    _draw(setting.out, costs)
    slopes = {name: slope(values) for name, values in costs.items()}
    return Section(
        "scale",
        "A and P at 36 x 29 to 90 x 72 patches, 126 x 126 pixels",
        claims=[
            *_claims(costs, limits),
            Claim(
                "explicit P: largest entry of (P A - I) z, z normal, at any size",
                "1e-8",
                f"{max(errors.values()):.1e}",
                Verdict.of(max(errors.values()) < 1e-8),
            ),
        ],
        pictures=[
            Picture(
                setting.out / "cost.png",
                "Seconds over the number of patches; in brackets the slope of a straight line "
                "through the logarithms.",
            )
        ],
        tables=[_table(limits, costs, slopes)],
    )


def operations(N: int) -> float:
    """Count the operations of half of AᵀA, which is symmetric, and of its Cholesky factor."""
    return 15876 * N**2 + N**3 / 3


def slope(costs: Mapping[int, float]) -> float:
    """Fit a power law: its exponent."""
    return float(np.polyfit(np.log(list(costs)), np.log(list(costs.values())), 1)[0])


def transport(_: Setting) -> Section:
    """Render A at 36 samples a patch, against Mitsuba's shadow rays alone."""
    limits = machine_limits()
    scene = Chair(SMALL)
    took = median_seconds(partial(ps.render_transport, scene.scenario, samples=36), 5)
    rays = 36 * scene.A.size
    return Section(
        "transport",
        "The light transport matrix",
        claims=[
            compare(
                "A at 36 samples a patch, against as many shadow rays of Mitsuba alone",
                "at most 1.5 times as long",
                took,
                rays / limits.rays,
                1 / 1.5,
                f"{rays / took / 1e6:.0f} million rays a second.",
            )
        ],
    )


def _identity_error(P: Array, A: Array) -> float:
    probe = np.random.default_rng(0).standard_normal((len(P), 4))
    return float(np.abs(P @ (A @ probe) - probe).max())


def _claims(costs: Costs, limits: Limits) -> list[Claim]:
    factored, explicit = costs["P factored"], costs["P explicit"]
    pinv = costs["pinv([A, B])"]
    small, large = min(factored), max(factored)
    least = operations(large) / limits.double
    return [
        compare(
            "P factored, 36 x 29, against pinv([A, B])",
            "at least 8 times faster",
            factored[small],
            pinv[small],
            8,
        ),
        compare(
            "P explicit, 36 x 29, against pinv([A, B])",
            "at least 5 times faster",
            explicit[small],
            pinv[small],
            5,
        ),
        compare(
            "P factored, 90 x 72, against pinv([A, B])",
            "at least 25 times faster",
            factored[large],
            pinv[large],
            25,
            "pinv timed once. At the rate of a matrix product in double precision AᵀA and its "
            f"Cholesky factor take {least:.1f} s: at most {pinv[large] / least:.0f} times faster.",
        ),
    ]


def _table(limits: Limits, costs: Costs, slopes: Mapping[str, float]) -> Table:
    def rate(N: int) -> str:
        return f"{operations(N) / costs['P factored'][N] / 1e9:.0f}"

    sizes = list(costs["P factored"])
    rows = [
        (name, *(f"{values[N]:.2f}" for N in sizes), f"{slopes[name]:.2f}")
        for name, values in costs.items()
    ]
    return Table(
        "Seconds; below, the rate of the factored form beside the "
        f"{limits.double / 1e9:.0f} GFLOP/s of a matrix product.",
        ("", *(str(N) for N in sizes), "slope"),
        [*rows, ("GFLOP/s, factored", *(rate(N) for N in sizes), "")],
    )


def _draw(out: Path, costs: Costs) -> None:
    with drawn(out, "cost", COLUMN, 2.8) as figure:
        ax = figure.subplots()
        for name, (color, style) in STYLES.items():
            label = f"{name} ({slope(costs[name]):.1f})"
            ax.loglog(
                list(costs[name]),
                list(costs[name].values()),
                style,
                color=color,
                label=label,
                markersize=4,
            )
        sizes = list(costs["P factored"])
        ax.set_xticks(sizes, [str(N) for N in sizes])
        ax.minorticks_off()
        ax.set(xlabel="patches", ylabel="seconds")
        ax.legend()
