"""Fig. 5: adversarial ambient light, where it comes from, and what it does to the image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import draw_rows
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import GLASS, NO_BEAM, SNR, Setting
from experiments.sweeps import recovered, swept
from periscopy_sim.figures.panels import displayable

if TYPE_CHECKING:
    import xarray as xr

SBR = 0.25
PAPER, PUBLISHED = METHODS = ("preconditioned", "differencing")
PLACES = {
    GLASS: "stained glass, sunbeam",
    NO_BEAM: "stained glass, no beam",
    "snow": "sun and snow",
}


def run(setting: Setting) -> Section:
    """Reconstruct under adversarial light."""
    adversarial, realistic = setting.adversarial, setting.backgrounds()
    results = swept(setting, __file__, {**adversarial, **realistic})
    errors = results["mean_squared_error"]
    usual = float(errors.sel(algorithm=PAPER, background=[*realistic]).median())
    paper, published = (errors.sel(algorithm=method) for method in METHODS)
    holds = {name: bool(paper.sel(background=name) < 1.5 * usual) for name in PLACES}
    reason = (
        "Edges of sunlight on the wall itself are like penumbrae, and no far light of B makes "
        "them. The window alone, below, does no harm: the paper's board stood in such light, not "
        "in the beam."
    )
    return Section(
        name="fig5",
        title="Fig. 5: adversarial ambient light",
        text=f"Composites of the {setting.measured.kind} photograph at SBR {SBR}, {SNR:.0f} dB. "
        "The church is rendered twice: with the sun shining through the glass on to the wall, and "
        "with the window's own coloured light alone.",
        claims=[
            Claim(
                f"recovered under {place} (SBR {SBR}, mean squared error)",
                "recognizable, Fig. 5d",
                f"{paper.sel(background=name):.3f}; realistic light, median: {usual:.3f}; "
                f"differencing {published.sel(background=name):.3f}",
                Verdict.of(holds[name]),
                reason if name == GLASS and holds[NO_BEAM] and not holds[GLASS] else "",
            )
            for name, place in PLACES.items()
        ],
        pictures=[_draw(setting, adversarial, results)],
        tables=[_table(setting, adversarial, errors)],
    )


def _table(setting: Setting, light: dict[str, NDArray[np.float64]], errors: xr.DataArray) -> Table:
    P = setting.preconditioned.preconditioner
    rows = []
    for name, place in PLACES.items():
        b = light[name].reshape(-1, 3)
        outside = np.linalg.norm(P.project_out(b)) / np.linalg.norm(b)
        rows.append(
            (place, f"{100 * outside:.3f} %", *(f"{e:.4f}" for e in errors.sel(background=name)))
        )
    return Table(
        "Part of the light outside range(B), Monte Carlo noise included, and mean squared errors "
        f"at SBR {SBR}.",
        ("place", "outside range(B)", "proposed", "differencing"),
        rows,
    )


def _draw(setting: Setting, light: dict[str, NDArray[np.float64]], results: xr.Dataset) -> Picture:
    measured, rows = setting.measured, {}
    for name, place in PLACES.items():
        picture, dim = setting.place(name), light[name] - light[name].min(axis=(0, 1))
        rows[place] = [
            # Of the sunlit paper and the bright glass some is left white, so the rest is seen.
            ("place", displayable(picture, float(np.percentile(picture, 98)))),
            ("light", dim / dim.max(axis=(0, 1))),
            ("composite", displayable(ps.composite(measured.signal, light[name], SBR))),
            *recovered(results, measured.truth, background=name),
        ]
    return draw_rows(
        setting.out, "fig5", rows,
        "The place, with the board; its light on the wall, each channel from its least to its "
        "greatest value; the composite (white: the 99.5th percentile); the images of both methods, "
        "gain-matched.",
    )  # fmt: skip
