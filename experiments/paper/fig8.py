"""Fig. 8: what P keeps of a photograph: y, b, y - b, A P y, and the twin by differencing.

A P y is what the recovered hidden image, neither denoised nor repaired, would cast on the wall. It
should look like the photograph without its background, and A (D A)^+ D y like a poor copy of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.drawing import PAGE, drawn, show_light
from experiments.report import Claim, Picture, Section, Table, Verdict
from experiments.setting import SNR, Setting
from periscopy_sim.reconstruction.baselines.differencing import neighbour_differences
from periscopy_sim.reconstruction.preconditioned.preconditioner import (
    Preconditioner,
    form_preconditioner,
)

Array = NDArray[np.float64]

SBR = 0.25
BACKGROUND = "desk_lamps"
"""The realistic condition that is drawn: of them all, its light varies most over the wall."""


@dataclass(frozen=True, eq=False)
class Inverses:
    """Linear estimates of f: P y and two pseudoinverses with differencing, (D A)^+ D y.

    Attributes
    ----------
    P
        The optimized preconditioner.
    wrapped
        The pseudoinverse of D A, with D as published by [15].
    within
        The same where D takes differences within the photograph's columns only.
    photograph_shape
        (rows, columns).
    """

    P: Preconditioner
    wrapped: Preconditioner
    within: Preconditioner
    photograph_shape: tuple[int, int]

    def signals(self, y: Array) -> dict[str, Array]:
        """Cast the three estimates on the wall: A P y and A (D A)^+ D y, (M, 3) each."""
        return {
            "A P y": self.P.A @ self.P.apply(y),
            "A (DA)⁺ Dy": self.P.A @ self.wrapped.apply(self._differences(y, wrap=True)),
            "D not wrapped": self.P.A @ self.within.apply(self._differences(y, wrap=False)),
        }

    def _differences(self, y: Array, *, wrap: bool) -> Array:
        differences = neighbour_differences(y, self.photograph_shape, wrap=wrap)
        return np.asarray(differences, np.float64)


@dataclass(frozen=True, eq=False)
class Photograph:
    """y = signal + background + noise, each (M, 3), scaled so that y has mean 1."""

    signal: Array
    background: Array
    noise: Array

    @property
    def y(self) -> Array:
        """What the camera measures."""
        return self.signal + self.background + self.noise


def photographed(signal: Array, background: Array, seed: int) -> Photograph:
    """Compose a photograph and keep its parts.

    Parameters
    ----------
    signal, background
        (rows, columns, 3), in any unit.
    seed
        Of the noise.
    """
    clean = ps.composite(signal, background, SBR)
    share = SBR / (1 + SBR) * signal / signal.mean()
    noise = ps.add_noise(clean, SNR, seed) - clean
    return Photograph(*(part.reshape(-1, 3) for part in (share, clean - share, noise)))


def correlation(first: Array, second: Array) -> float:
    """Pearson's correlation over all pixels, each channel about its own mean."""
    a, b = (x - x.mean(axis=0) for x in (first, second))
    return float(np.sum(a * b) / np.sqrt(np.sum(a**2) * np.sum(b**2)))


def run(setting: Setting) -> Section:
    """Take one photograph apart in pictures, and one for each background in numbers."""
    shape = setting.scenario.photograph_shape
    P = setting.preconditioned.preconditioner
    inverses = Inverses(
        P,
        form_preconditioner(neighbour_differences(P.A, shape)),
        form_preconditioner(neighbour_differences(P.A, shape, wrap=False)),
        shape,
    )
    realistic = setting.backgrounds()
    measured = setting.measured
    photographs = {
        name: photographed(measured.signal, background, setting.seed + number)
        for number, (name, background) in enumerate({**realistic, **setting.adversarial}.items())
    }
    signals = {name: inverses.signals(photograph.y) for name, photograph in photographs.items()}
    _draw(setting, photographs[BACKGROUND], signals[BACKGROUND], P)
    found = [correlation(signals[name]["A P y"], photographs[name].signal) for name in realistic]
    glass = correlation(signals["stained_glass"]["A P y"], photographs["stained_glass"].signal)
    return Section(
        name="fig8",
        title="Fig. 8: A P y against the photograph without background",
        text=f"The {'real' if measured.real else 'path-traced'} photograph with ambient light at "
        f"SBR {SBR}, SNR {SNR:.0f} dB. The estimates are neither denoised nor repaired, so that "
        "the pictures show the inverses alone. Beside the published D, whose differences across "
        "the ends of columns and whose last row let background through, stands one that takes "
        "differences within columns only.",
        claims=[
            Claim(
                "A P y against the background-free photograph (correlation, SBR 0.25)",
                "markedly similar",
                f"{min(found):.4f} to {max(found):.4f} under {len(found)} realistic backgrounds",
                Verdict.of(min(found) > 0.95),
                f"Under stained glass it is {glass:.2f}: the part of that light that no light of B "
                "casts is far stronger than the penumbrae, see the table.",
            )
        ],
        pictures=[
            Picture(
                setting.out / "fig8.png",
                f"a. Photograph y under {BACKGROUND.replace('_', ' ')}; b. its background; c. "
                "without it; d. A P y; e. the same with the pseudoinverse of D A, D as published "
                "by [15]; f. with D within columns only. Above: linear light, sRGB-encoded, "
                "black is 0, white as given, where y has mean 1. Below: what is left when "
                "range(B) is projected out, mean of the channels, all on one scale.",
            )
        ],
        tables=[_table(photographs, signals, P)],
    )


def _table(
    photographs: Mapping[str, Photograph],
    signals: Mapping[str, dict[str, Array]],
    P: Preconditioner,
) -> Table:
    def row(name: str) -> list[str]:
        photograph = photographs[name]
        penumbrae = np.linalg.norm(P.project_out(photograph.signal))
        outside = np.linalg.norm(P.project_out(photograph.background)) / penumbrae
        noise = np.linalg.norm(photograph.noise) / penumbrae
        cells = [name.replace("_", " "), f"{100 * outside:.1f} %", f"{100 * noise:.1f} %"]
        for estimate in signals[name].values():
            error = np.linalg.norm(P.project_out(estimate - photograph.signal)) / penumbrae
            cells += [f"{correlation(estimate, photograph.signal):.4f}", f"{100 * error:.1f} %"]
        return cells

    measures = ("correlation", "error of penumbrae")
    estimates = [
        f"{name}: {measure}" for name in next(iter(signals.values())) for measure in measures
    ]
    return Table(
        f"Estimates of the signal against the signal itself at SBR {SBR}, {SNR:.0f} dB. Penumbrae: "
        "with range(B) projected out, which is all that an estimate can know of the signal. The "
        "background outside range(B), its Monte Carlo noise included, the sensor's noise and the "
        "errors are norms over that of the penumbrae.",
        ("background", "background outside range(B)", "noise", *estimates),
        [row(name) for name in photographs],
    )


def _draw(
    setting: Setting, photograph: Photograph, signals: Mapping[str, Array], P: Preconditioner
) -> None:
    rows, columns = setting.scenario.photograph_shape
    pictures = {
        "y": photograph.y,
        "b": photograph.background,
        "y − b": photograph.y - photograph.background,
        **signals,
    }
    penumbrae = P.project_out(photograph.signal).mean(axis=1)
    limit = float(np.percentile(np.abs(penumbrae), 99.5))
    with drawn(setting.out, "fig8", PAGE, 2.7) as figure:
        axes = figure.subplots(2, len(pictures))
        for letter, (top, bottom), (title, image) in zip(
            "abcdef", axes.T, pictures.items(), strict=True
        ):
            light = image.reshape(rows, columns, 3)
            white = float(np.percentile(light, 99.5))
            show_light(top, light, white)
            top.set_title(f"{letter}. {title}\nwhite = {white:.2f}")
            left = P.project_out(image).mean(axis=1).reshape(rows, columns)
            drawing = bottom.imshow(left, cmap="RdBu_r", vmin=-limit, vmax=limit)
            bottom.set_axis_off()
        figure.colorbar(
            drawing, ax=axes[1, :], extend="both", aspect=12, pad=0.01,
            label="background-free\npart (mean y = 1)",
        )  # fmt: skip
