"""Fig. 5: adversarial ambient light, where it comes from, and what it does to the image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import draw_rows
from experiments.report import Claim, Picture, Section, Verdict
from experiments.setting import GLASS, NO_BEAM, SNR, Setting
from experiments.sweeps import recovered, swept
from periscopy_sim.figures.panels import displayable

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

SBR = 0.25
PLACES = {
    GLASS: "stained glass, sunbeam",
    NO_BEAM: "stained glass, no beam",
    "snow": "sun and snow",
}


def run(setting: Setting) -> Section:
    """Reconstruct under adversarial light."""
    adversarial, realistic = setting.adversarial, setting.backgrounds()
    results = swept(setting, __file__, {**adversarial, **realistic})
    methods = ("preconditioned", "differencing")
    paper, published = (results["mean_squared_error"].sel(algorithm=name) for name in methods)
    usual = float(paper.sel(background=[*realistic]).median())
    holds = {name: bool(paper.sel(background=name) < 1.5 * usual) for name in PLACES}
    outside = {name: _outside(setting, adversarial[name]) for name in PLACES}
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
        "with the window's own coloured light alone. Of the light, Monte Carlo noise included, "
        + ", ".join(f"{100 * outside[name]:.3f} % ({place})" for name, place in PLACES.items())
        + " lie outside range(B).",
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
    )


def _outside(setting: Setting, light: Array) -> float:
    """Return the part of ambient light, (rows, columns, 3), outside range(B)."""
    b = light.reshape(-1, 3)
    outside = setting.preconditioned.preconditioner.project_out(b)
    return float(np.linalg.norm(outside) / np.linalg.norm(b))


def _draw(setting: Setting, light: dict[str, Array], results: xr.Dataset) -> Picture:
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
        "gain-matched, with mean squared errors.",
    )  # fmt: skip
