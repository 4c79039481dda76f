"""Reconstruct hidden worlds other than a monitor by the command line.

Plain Mitsuba photographs each world (64 x 64 pixels, SBR 1, 60 dB); the command knows the scene
file, not the pictures. Images are gain-matched.

`python -m experiments.worlds --out DIR` prints a table and draws the pictures. What is rendered
stays in DIR: the next run goes on from there.
"""

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import periscopy_sim as ps
from experiments.worlds.making import SCENES, WORLDS, World
from periscopy_sim.cli import app
from periscopy_sim.figures.panels import displayable, draw_panels
from periscopy_sim.numerics import Array

SEED = 0

HEADER = """\
| world | PSNR, dB | unexplained, % | noise, % | rendering's error over the noise | s |
|---|---|---|---|---|---|"""


def main(out: Annotated[Path, typer.Option(help="Folder to write.")]) -> None:
    """Photograph and reconstruct every world."""
    print(HEADER)
    for number, (name, world) in enumerate(WORLDS.items()):
        folder = out / str(number)
        truth, error = photographed(world, folder)
        images = reconstructed(world, folder)
        photograph = displayable(np.load(folder / "photograph.npy"))
        rows = {
            each: [
                ("hidden image", displayable(f, 1)),
                ("photograph", photograph),
                ("reconstruction", ps.gain_matched(images[each], f)),
            ]
            for each, f in truth.items()
        }
        draw_panels(folder / "world.png", rows)
        summary = json.loads((folder / "out" / "summary.json").read_text("utf-8"))
        quality = (
            f"{ps.psnr_gain_matched(f, truth[each]):.1f} {each}" for each, f in images.items()
        )
        rest = (f"{100 * summary[each]:.3f}" for each in ("unexplained", "noise_alone"))
        seconds = sum(summary["seconds"].values())
        cells = [name, ", ".join(quality), *rest, f"{error:.2f}", f"{seconds:.1f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


def photographed(world: World, folder: Path) -> tuple[dict[str, Array], float]:
    """Return the truth and the rendering's error; the photograph is rendered once."""
    known = folder / "truth.npz"
    if not known.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        truth = world.truth(folder)
        photograph, error = world.photograph(folder, truth, SEED)
        np.save(folder / "photograph.npy", photograph)
        np.savez(known, error=error, **truth)
    truth = dict(np.load(known))
    error = float(truth.pop("error"))
    return truth, error


def reconstructed(world: World, folder: Path) -> dict[str, Array]:
    """Run `periscopy reconstruct`; return the images by parameter."""
    sizes = {name: "{}x{}".format(*shape) for name, (_, shape) in world.shown.items()}
    options = [word for n, size in sizes.items() for word in ("--hidden", f"hidden_{n}={size}")]
    words = ["reconstruct", folder / "photograph.npy", "--scene", SCENES / world.assumed]
    app([*map(str, words), *options, "--out", str(folder / "out")], standalone_mode=False)
    ends = {name: f"_hidden_{name}" if len(sizes) > 1 else "" for name in sizes}
    return {n: np.load(folder / "out" / f"reconstruction{end}.npy") for n, end in ends.items()}


if __name__ == "__main__":
    typer.run(main)
