"""Fig. 10: the matrix P, and whether its rows resemble finite differences as the paper remarks.

Each row of P is a picture on the wall, whose product with the photograph is one patch of the hidden
image. A difference of neighbouring pixels sums to zero, gives neighbours opposite signs (its
autocorrelation at one pixel is -1/2) and passes the highest frequencies best: three things that the
rows of P can be asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import COLORS, PAGE, drawn, wall_extent
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import Setting
from periscopy_sim.figures.style import mpl, plain_ticks
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]

PLACES = ((0.2, 0.2), (0.2, 0.7), (0.5, 0.45), (0.8, 0.8))
"""Of the rows drawn: fractions of the hidden image down and across."""

SAMPLES = 64
"""Shadow rays for each entry of A, at the midpoints of their strata: no Monte Carlo noise."""


@dataclass(frozen=True, eq=False)
class RowStatistics:
    """What the rows of an inverse have of a difference filter; each (N,).

    Attributes
    ----------
    sum
        |Σ| / Σ|.|: 0 for a filter that ignores uniform light, 1 for one sign only.
    down, across
        Autocorrelation at a lag of one pixel: -1/2 for a difference, near 1 for a smooth field.
    opposite
        Part of all neighbouring pairs that have opposite signs: 1/2 for white noise.
    """

    sum: Array
    down: Array
    across: Array
    opposite: Array


def row_statistics(rows: Array) -> RowStatistics:
    """Describe rows given as pictures on the wall, (N, rows, columns)."""
    energy = np.sum(rows**2, axis=(1, 2))
    vertical = rows[:, 1:] * rows[:, :-1]
    horizontal = rows[:, :, 1:] * rows[:, :, :-1]
    pairs = vertical[0].size + horizontal[0].size
    return RowStatistics(
        np.abs(rows.sum(axis=(1, 2))) / np.abs(rows).sum(axis=(1, 2)),
        vertical.sum(axis=(1, 2)) / energy,
        horizontal.sum(axis=(1, 2)) / energy,
        ((vertical < 0).sum(axis=(1, 2)) + (horizontal < 0).sum(axis=(1, 2))) / pairs,
    )


def radial_spectrum(rows: Array, pitch: float) -> tuple[Array, Array]:
    """Average the rows' power spectra, each row of energy 1, over rings of spatial frequency.

    Parameters
    ----------
    rows
        (N, n, n) pictures.
    pitch
        Pixel pitch in metres.

    Returns
    -------
    frequency, power
        Centres of the rings in 1/m up to the Nyquist frequency, and the mean power in each; white
        noise has power 1.
    """
    n = rows.shape[1]
    total = np.zeros((n, n))
    for row in rows:
        total += np.abs(np.fft.fft2(row)) ** 2 / np.sum(row**2)
    frequency = np.fft.fftfreq(n, pitch)
    ring = np.rint(np.hypot(*np.meshgrid(frequency, frequency)) * n * pitch).astype(int)
    rings = np.arange(n // 2)
    power = np.array([total[ring == k].mean() for k in rings]) / len(rows)
    return rings / (n * pitch), power


def run(setting: Setting) -> Section:
    """Draw P, some of its rows, and their spectrum beside that of the pseudoinverse of A."""
    scenario = setting.scenario
    shape = scenario.photograph_shape
    left, right, _, _ = wall_extent(scenario)
    pitch = (right - left) / 1e3 / shape[1]
    # Monte Carlo noise in A would speckle the rows of P.
    smooth = ps.render_transport(scenario, samples=SAMPLES, strata="midpoint", seed=setting.seed)
    inverses = {
        "P": form_preconditioner(smooth, setting.B),
        "A⁺": form_preconditioner(smooth),
        "P, A of 16 random samples": setting.preconditioned.preconditioner,
    }
    statistics, spectra = {}, {}
    for name, inverse in inverses.items():
        rows = inverse.matrix().reshape(-1, *shape)
        statistics[name] = row_statistics(rows)
        spectra[name] = radial_spectrum(rows, pitch)
        if name == "P":
            shown = rows
    difference = np.zeros((1, *shape))
    difference[0, :2, 0] = -1, 1
    spectra["D"] = radial_spectrum(difference, pitch)
    with drawn(setting.out, "fig10", PAGE, 4.4) as figure:
        _draw(figure, shown, spectra, scenario)
    frequency, power = spectra["P"]
    peak = float(frequency[np.argmax(power)])
    total = float(np.median(statistics["P"].sum))
    lag = float(np.median([statistics["P"].down, statistics["P"].across]))
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
                f"{total:.0e}; A⁺ alone {np.median(statistics['A⁺'].sum):.0e}",
                Verdict.of(total < 1e-6),
                "P B = 0 to rounding; the pseudoinverse without B comes near by itself.",
            ),
            Claim(
                "structure of P like finite differences: neighbouring pixels of opposite sign "
                "(median autocorrelation at one pixel; D: -0.5)",
                "reminiscent of D",
                f"{lag:.2f}",
                Verdict.of(lag < 0),
                f"The rows take differences across the edges of shadows, not between neighbours: "
                f"their spectrum peaks at {peak:.0f}/m, a change of sign every "
                f"{500 / peak:.1f} mm or {0.5 / peak / pitch:.1f} pixels.",
            ),
        ],
        pictures=[
            Picture(
                setting.out / "fig10.png",
                "Above left: magnitude of P, root mean square over each of the photograph's rows. "
                "Above right: mean power spectrum of the rows, averaged over directions, each row "
                "of energy 1; that of D is a difference of two pixels. Below: P of four patches as "
                "pictures on the wall (no unit), colours limited to the 99.5th percentile.",
            )
        ],
        tables=[_table(statistics)],
    )


def _table(statistics: dict[str, RowStatistics]) -> Table:
    def cell(values: Array) -> str:
        return " / ".join(f"{value:.2g}" for value in np.percentile(values, (5, 50, 95)))

    return Table(
        "Rows of the inverses as pictures on the wall: 5th percentile / median / 95th.",
        ("", "|Σ| / Σ|.|", "autocorrelation down", "across", "neighbours of opposite sign"),
        [
            (name, cell(found.sum), cell(found.down), cell(found.across), cell(found.opposite))
            for name, found in statistics.items()
        ],
    )


def _draw(
    figure: Any,
    rows: Array,
    spectra: dict[str, tuple[Array, Array]],
    scenario: Scenario,
) -> None:
    top, bottom = figure.subfigures(2, 1, height_ratios=(1, 1.05))
    overview, spectrum = top.subplots(1, 2, width_ratios=(1.1, 1))
    _draw_overview(overview, rows)
    _draw_spectrum(spectrum, spectra)
    for ax, place in zip(bottom.subplots(1, len(PLACES), sharey=True), PLACES, strict=True):
        R, C = scenario.hidden_shape
        r, c = int(place[0] * R), int(place[1] * C)
        row = rows[r * C + c]
        limit = float(np.percentile(np.abs(row), 99.5))
        picture = ax.imshow(
            row, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=wall_extent(scenario)
        )
        ax.set_title(f"row {r}, column {c}")
        ax.set(xticks=(-200, 0, 200), yticks=(-200, 0, 200), xlabel="across (mm)")
        bottom.colorbar(
            picture, ax=ax, orientation="horizontal", extend="both", label="entry of P", aspect=14,
            ticks=mpl.ticker.MaxNLocator(3),
        )  # fmt: skip
        if place == PLACES[0]:
            ax.set_ylabel("up (mm)")


def _draw_overview(ax: Any, rows: Array) -> None:
    magnitude = np.sqrt(np.mean(rows**2, axis=2))
    low, high = np.percentile(magnitude, (1, 99))
    picture = ax.imshow(
        magnitude,
        cmap="cividis",
        norm=mpl.colors.LogNorm(low, high),
        aspect="auto",
        interpolation="nearest",
    )
    ax.set(xlabel="photograph's row", ylabel="patch (row of P)", title="magnitude of P")
    bar = ax.figure.colorbar(picture, ax=ax, label="rms entry", extend="both")
    plain_ticks(bar.ax.yaxis)


def _draw_spectrum(ax: Any, spectra: dict[str, tuple[Array, Array]]) -> None:
    lines = {
        "P": (COLORS["preconditioned"], "-", "rows of P"),
        "A⁺": (COLORS["pseudoinverse"], "--", "rows of A⁺"),
        "D": (COLORS["differencing"], ":", "D"),
    }
    for name, (color, style, label) in lines.items():
        frequency, power = spectra[name]
        ax.semilogy(frequency, power, style, color=color, label=label)
    ax.set(xlabel="spatial frequency (1/m)", ylabel="power (white noise: 1)", ylim=(1e-4, 10))
    plain_ticks(ax.yaxis)
    ax.set_title("spectrum of the rows")
    ax.legend(loc="lower right")
