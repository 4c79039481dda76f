"""Fig. 10: the matrix P, and whether its rows resemble finite differences as the paper remarks.

Each row of P is a picture on the wall, whose product with the photograph is one patch of the hidden
image. A difference of neighbouring pixels sums to zero and gives neighbours opposite signs: two
things that the rows of P can be asked for.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, wall_extent
from experiments.report import Claim, Picture, Section, Verdict
from experiments.setting import FREE_OF_NOISE, Setting
from periscopy_sim.figures.style import mpl, plain_ticks
from periscopy_sim.reconstruction.preconditioned import form_preconditioner

Array = NDArray[np.float64]

PLACES = ((0.2, 0.2), (0.2, 0.7), (0.5, 0.45), (0.8, 0.8))
"""Of the rows drawn: fractions of the hidden image down and across."""


def imbalance(rows: Array) -> float:
    """Median |Σ| / Σ|.| of (N, rows, columns): 0 where uniform light is ignored, 1 of one sign."""
    return float(np.median(np.abs(rows.sum(axis=(1, 2))) / np.abs(rows).sum(axis=(1, 2))))


def autocorrelation(rows: Array) -> float:
    """Median at a lag of one pixel of (N, rows, columns): -1/2 of a difference, 1 if smooth."""
    down, across = rows[:, 1:] * rows[:, :-1], rows[:, :, 1:] * rows[:, :, :-1]
    lags = np.stack([down.sum(axis=(1, 2)), across.sum(axis=(1, 2))])
    return float(np.median(lags / np.sum(rows**2, axis=(1, 2))))


def run(setting: Setting) -> Section:
    """Draw P and some of its rows, and describe them."""
    shape = setting.scenario.photograph_shape
    A = ps.render_transport(setting.scenario, seed=setting.seed, **FREE_OF_NOISE)
    alone = imbalance(form_preconditioner(A).matrix().reshape(-1, *shape))
    rows = form_preconditioner(A, setting.B).matrix().reshape(-1, *shape)
    total, lag = imbalance(rows), autocorrelation(rows)
    with drawn(setting.out, "fig10", PAGE, 4.4) as figure:
        _draw(figure, rows, setting)
    return Section(
        name="fig10",
        title="Fig. 10: the matrix P",
        text="Each row of P lives on the edges of the shadow that the chair casts in the light of "
        "its patch, above all at their corners, with signs that alternate across an edge.",
        claims=[
            Claim(
                "structure of P like finite differences: rows that reject uniform light "
                "(median |Σ| / Σ|.|)",
                "reminiscent of D",
                f"{total:.0e}; A⁺ alone {alone:.0e}",
                Verdict.of(total < 1e-6),
                "P B = 0 to rounding; the pseudoinverse without B comes near by itself.",
            ),
            Claim(
                "structure of P like finite differences: neighbouring pixels of opposite sign "
                "(median autocorrelation at one pixel; D: -0.5)",
                "reminiscent of D",
                f"{lag:.2f}",
                Verdict.of(lag < 0),
                "The rows take differences across the edges of shadows, not between neighbours.",
            ),
        ],
        pictures=[
            Picture(
                setting.out / "fig10.png",
                "Above: magnitude of P, root mean square over each of the photograph's rows. "
                "Below: P of four patches as pictures on the wall (no unit), colours limited to "
                "the 99.5th percentile.",
            )
        ],
    )


def _draw(figure: Any, rows: Array, setting: Setting) -> None:
    top, bottom = figure.subfigures(2, 1, height_ratios=(1, 1.05))
    magnitude, ax = np.sqrt(np.mean(rows**2, axis=2)), top.subplots()
    norm = mpl.colors.LogNorm(*np.percentile(magnitude, (1, 99)))
    picture = ax.imshow(magnitude, cmap="cividis", norm=norm, aspect="auto")
    ax.set(xlabel="photograph's row", ylabel="patch (row of P)", title="magnitude of P")
    bar = top.colorbar(picture, ax=ax, label="rms entry", extend="both")
    plain_ticks(bar.ax.yaxis)
    (R, C), extent = setting.hidden, wall_extent(setting.scenario)
    for ax, (down, across) in zip(
        bottom.subplots(1, len(PLACES), sharey=True), PLACES, strict=True
    ):
        r, c = int(down * R), int(across * C)
        row = rows[r * C + c]
        limit = float(np.percentile(np.abs(row), 99.5))
        picture = ax.imshow(row, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=extent)
        ax.set_title(f"row {r}, column {c}")
        ax.set(xticks=(-200, 0, 200), yticks=(-200, 0, 200), xlabel="across (mm)")
        ax.set_ylabel("up (mm)")
        ax.label_outer()
        bottom.colorbar(
            picture, ax=ax, orientation="horizontal", extend="both", label="entry of P", aspect=14,
            ticks=mpl.ticker.MaxNLocator(3),
        )  # fmt: skip
