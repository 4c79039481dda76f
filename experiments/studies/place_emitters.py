"""Choose what B is made of: Eq. 4's grid of point lights, a place's own emitters, or both.

`python -m experiments.studies.place_emitters --out DIR [--real FILE.npz]` reconstructs, by the
noise-aware method, a rendered photograph of the chair scene under the ambient light of each shipped
place, and a real one if given (arrays `photograph` and `hidden`). A place's own emitters are those
of the very scene whose light is in the photograph, its panes and lamps exactly where they are:
better than anybody knows a real room. Light that bounced is in none of the prototypes. The real
photograph's metric uses the truth for one gain per channel and a shift of at most 2 patches.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import periscopy_sim as ps
from experiments.setting import Array, Measured, Setting
from periscopy_sim.shipped import ADVERSARIAL, REALISTIC

SBRS = (0.05, 0.5, 10.0)
GRID, OWN, BOTH = "grid", "own", "both"


def main(
    out: Annotated[Path, typer.Option(help="Folder of what is rendered once.")],
    real: Annotated[Path | None, typer.Option(help="A real photograph of the chair scene.")] = None,
) -> None:
    """Print the mean squared errors of each place, kind of photograph and choice of B."""
    out.mkdir(parents=True, exist_ok=True)
    setting = Setting(out, real)
    setting.rendered.mkdir(exist_ok=True)
    measured = {"rendered": setting.synthetic}
    if real is not None:
        measured["real"] = setting.measured
    lights = setting.backgrounds((*REALISTIC, *ADVERSARIAL))
    errors: dict[tuple[str, float, str], list[float]] = {}
    for number, (place, light) in enumerate(lights.items()):
        own = ps.emitter_backgrounds(f"ambient/{place}", setting.scenario)
        prototypes = {GRID: setting.B, OWN: own, BOTH: np.hstack([setting.B, own])}
        for choice, B in prototypes.items():
            method = ps.NoiseAware.for_scene(setting.scenario, setting.A, B)
            for kind, photograph in measured.items():
                for sbr in SBRS:
                    y = ps.add_noise(ps.composite(photograph.signal, light, sbr), 60, number)
                    error = error_of(method.reconstruct(y), photograph)
                    errors.setdefault((kind, sbr, choice), []).append(error)
        for kind in measured:
            cells = (
                f"SBR {sbr:g}: "
                + " ".join(f"{choice} {errors[kind, sbr, choice][-1]:.4f}" for choice in prototypes)
                for sbr in SBRS
            )
            print(f"{place}, {own.shape[1]} of its own, {kind}  {';  '.join(cells)}", flush=True)
    for (kind, sbr, choice), each in errors.items():
        print(f"mean of the places, {kind}, SBR {sbr:g}, {choice}: {np.mean(each):.4f}", flush=True)


def error_of(image: Array, photograph: Measured) -> float:
    """Mean squared error; of a real photograph after the best shift."""
    if photograph.real:
        image = ps.registered(image, photograph.truth).image
    return float(ps.mean_squared_error(image, photograph.truth))


if __name__ == "__main__":
    typer.run(main)
