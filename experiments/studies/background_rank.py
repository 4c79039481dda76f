"""Choose the rank kept of range(B): what each tolerance does to reconstructions.

`python -m experiments.studies.background_rank [--real FILE.npz]` reconstructs rendered photographs
under ambient light, and a real one if given (arrays `photograph` and `hidden`), at several
tolerances. The real photograph's metric uses the truth for one gain per channel and a shift of at
most 2 patches.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.reconstruction.preconditioned.still import Periscope

HIDDEN = (29, 36)
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14)


def main(
    real: Annotated[Path | None, typer.Option(help="A real photograph of the chair scene.")] = None,
) -> None:
    """Print one line for each tolerance."""
    scene = ps.load_scenario(ps.find_scene("chair"), HIDDEN)
    A, B = ps.render_transport(scene), ps.point_light_backgrounds(scene)
    ambient = ps.render_background("ambient/ceiling_panels", scene).photograph
    composites = []
    for number, name in enumerate(("mushroom", "letters", "sunset")):
        truth = ps.read_hidden_image(ps.find_image(name), HIDDEN)
        signal = ps.render_photograph(scene, truth, seed=number)
        for sbr in (0.2, 1.0):
            y = ps.add_noise(ps.composite(signal, ambient, sbr), 60, number)
            composites.append((y, truth))
    photograph = None if real is None else ps.read_photograph(real, scene.photograph_shape).values
    truth = None if real is None else ps.read_hidden_image(real, HIDDEN)
    previous = None
    for tolerance in TOLERANCES:
        periscope = Periscope(A, B, hidden_shape=HIDDEN, rank_tolerance=tolerance, explicit=False)
        rank = periscope.preconditioner.Q.shape[1]
        rendered = np.mean([ps.psnr(periscope.reconstruct(y), f) for y, f in composites])
        line = f"{tolerance:.0e}  rank {rank:3d}  rendered {rendered:5.2f} dB"
        if photograph is not None and truth is not None:
            solution = periscope.solve(photograph)
            estimate = solution.preconditioned
            moved = 0.0 if previous is None else np.linalg.norm(estimate - previous)
            line += (
                f"  real {ps.registered(solution.image, truth).psnr:5.2f} dB  unexplained "
                f"{100 * np.mean(solution.noise / photograph.mean(axis=(0, 1))):.2f} %  "
                f"P y moved by {100 * moved / np.linalg.norm(estimate):.0f} %"
            )
            previous = estimate
        print(line, flush=True)


if __name__ == "__main__":
    typer.run(main)
