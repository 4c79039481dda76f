"""Sparse preconditioners: what each density of P costs in noise and saves in bytes and time.

`python -m experiments.studies.sparse_preconditioner --out DIR` reconstructs a rendered photograph
of the chair scene under ambient light with the full P and with sparser and sparser ones, writes a
table and draws the error over the density. Entries of P merely set to zero, and rows of least ‖p‖₁,
stand beside them. It takes some twenty minutes on one core, four with `--hidden 20x25`.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from scipy import sparse

import periscopy_sim as ps
from experiments.drawing import COLORS, COLUMN, drawn
from experiments.studies.l1_rows import l1_minimal_rows
from experiments.studies.thinning import (
    sparse_preconditioner,
)
from experiments.timing import median_seconds
from periscopy_sim.reconstruction.preconditioned.preconditioner import Preconditioner
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]

DENSITIES = (0.3, 0.2, 0.15, 0.1, 0.08, 0.07)
"""None below (N + r) / M, which is 0.069 for 29 x 36 patches."""

SBR, SNR = 0.5, 60.0
RUNS = 25
L1_ROWS = 16
"""Rows of least ‖p‖₁, spread over the hidden image: each takes seconds."""


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes
    ----------
    method
        How P was made sparse.
    density
        Part of the entries that are not zero.
    noise_gain
        ‖P‖_F² over that of the full P.
    identity_error
        Largest entry of |P A − I|.
    residual_background
        Largest ‖P B_i‖ / (‖P‖_F ‖B_i‖).
    raw, denoised
        PSNR in dB of P y and of its proximal operator of total variation.
    bytes
        Size in single precision over that of the full P.
    milliseconds
        Of the product with a photograph.
    """

    method: str
    density: float
    noise_gain: float
    identity_error: float
    residual_background: float
    raw: float
    denoised: float
    bytes: float
    milliseconds: float


@dataclass(frozen=True, eq=False)
class Trial:
    """What every P is tried on: the full one, B, a photograph of a known image and its noise."""

    P: Preconditioner
    B: Array
    photograph: Array
    truth: Array
    noise: float

    def row(self, method: str, P: Any) -> Row:
        """Measure one P, (N, M), an array or sparse."""
        y = self.photograph.reshape(-1, 3)
        noise_gain = float(np.sum(np.square(P.data if sparse.issparse(P) else P)))
        estimate = np.asarray(P @ y).reshape(self.truth.shape)
        weight = self.noise * np.sqrt(noise_gain / P.shape[0])
        residual = np.linalg.norm(P @ self.B, axis=0) / np.linalg.norm(self.B, axis=0)
        single, y_single = P.astype(np.float32), y.astype(np.float32)
        full_size = 4 * P.shape[0] * P.shape[1]
        size = full_size
        if sparse.issparse(single):
            size = sum(part.nbytes for part in (single.data, single.indices, single.indptr))
        return Row(
            method=method,
            density=float(P.nnz if sparse.issparse(P) else np.count_nonzero(P)) / np.prod(P.shape),
            noise_gain=noise_gain / float(self.P.noise_gain.sum()),
            identity_error=float(np.abs(P @ self.P.A - np.eye(P.shape[0])).max()),
            residual_background=float(residual.max()) / np.sqrt(noise_gain),
            raw=ps.psnr(estimate, self.truth),
            denoised=ps.psnr(ps.prox_total_variation(estimate, weight), self.truth),
            bytes=size / full_size,
            milliseconds=1e3 * median_seconds(lambda: single @ y_single, RUNS),
        )


def rows(trial: Trial) -> Iterator[Row]:
    """Measure the full P and sparser and sparser ones."""
    full = trial.P.matrix()
    yield trial.row("full", full)
    thinned: sparse.csr_array | None = None
    for density in DENSITIES:
        # Where the first is made from P, each other goes on from the one before.
        thinned = sparse_preconditioner(trial.P, density, start=thinned)
        yield trial.row("sparse", thinned)
        smallest = np.quantile(np.abs(full), 1 - density, axis=1, keepdims=True)
        yield trial.row("cut off", sparse.csr_array(np.where(np.abs(full) >= smallest, full, 0)))


def l1_point(P: Preconditioner) -> tuple[float, float]:
    """Return the mean density and noise gain of rows of least ‖p‖₁."""
    chosen = np.linspace(0, P.A.shape[1] - 1, L1_ROWS).astype(int)
    found = l1_minimal_rows(P, chosen.tolist(), tolerance=1e-4)
    entries = np.abs(found) > 1e-3 * np.abs(found).max(axis=1, keepdims=True)
    gain = np.sum(found**2) / np.sum(P.noise_gain[chosen])
    return float(entries.mean()), float(gain)


def make_trial(scene: Scenario) -> Trial:
    """Photograph an image under ambient light."""
    A, B = ps.render_transport(scene), ps.point_light_backgrounds(scene)
    truth = ps.read_hidden_image(ps.find_image("mushroom"), scene.hidden_shape)
    signal = ps.render_photograph(scene, truth, seed=0)
    ambient = ps.render_background("ambient/ceiling_panels", scene).photograph
    exposed = ps.composite(signal, ambient, SBR)
    photograph = ps.add_noise(exposed, SNR, 0)
    noise = 10 ** (-SNR / 20) * float(np.sqrt(np.mean(exposed**2)))
    return Trial(ps.form_preconditioner(A, B), B, photograph, truth, noise)


def draw(measured: list[Row], l1: tuple[float, float], out: Path) -> None:
    """Draw noise and error over the density."""
    with drawn(out, "sparse_preconditioner", COLUMN, 3.6) as figure:
        above, below = figure.subplots(2, 1, sharex=True)
        full = measured[0]
        for method, color, label in (
            ("sparse", COLORS["preconditioned"], "eliminated, refitted"),
            ("cut off", COLORS["differencing"], "small entries set to 0"),
        ):
            own = [full] + [row for row in measured if row.method == method]
            density = [row.density for row in own]
            if method == "sparse":
                above.plot(density, [row.noise_gain for row in own], "o-", ms=3, color=color)
            below.plot(density, [row.denoised for row in own], "o-", ms=3, color=color, label=label)
        above.plot(*l1, "s", ms=4, color=COLORS["truncated-svd"], label="least ‖p‖₁")
        above.set(xscale="log", yscale="log", ylabel="‖P‖² over the full P's")
        below.set(xlabel="density of P", ylabel="PSNR after TV (dB)")
        for ax in (above, below):
            ax.legend()


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    hidden: Annotated[str, typer.Option(help="Patches, ROWSxCOLUMNS.")] = "29x36",
) -> None:
    """Print and write one line for each density, and draw the figure."""
    height, width = map(int, hidden.split("x"))
    out.mkdir(parents=True, exist_ok=True)
    trial = make_trial(ps.load_scenario(ps.find_scene("chair"), (height, width)))
    measured = []
    with (out / "sparse_preconditioner.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, [field.name for field in fields(Row)])
        table.writeheader()
        for row in rows(trial):
            measured.append(row)
            table.writerow(asdict(row))
            file.flush()
            print(
                f"{row.method:8s} density {row.density:.4f}  noise x {row.noise_gain:6.3f}  "
                f"|PA - I| {row.identity_error:.1e}  background {row.residual_background:.1e}  "
                f"P y {row.raw:6.2f} dB  after TV {row.denoised:6.2f} dB  "
                f"bytes x {row.bytes:.3f}  {row.milliseconds:.2f} ms",
                flush=True,
            )
    l1 = l1_point(trial.P)
    print(f"rows of least |p|_1: density {l1[0]:.4f}  noise x {l1[1]:.3f}")
    draw(measured, l1, out)
    print(f"wrote {out / 'sparse_preconditioner.csv'} and {out / 'sparse_preconditioner.png'}")


if __name__ == "__main__":
    typer.run(main)
