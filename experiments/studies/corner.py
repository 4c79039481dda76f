"""What the floor beside a wall's end shows of the hidden side, with room light and without.

PHOTOGRAPHS is an NPZ file of a corner camera (Seidel et al., ICCP 2019), of one channel:
`penumbra`, (rows, columns), is the floor under hidden lights alone, `ambient` under room light
alone; their sum is the photograph. The first rows and the last columns show the wall, not the
floor: the mask leaves them out.

`python -m experiments.studies.corner PHOTOGRAPHS.npz --out DIR` writes the photographs, the
mask and a picture of the angles to DIR, and prints how those recovered from both photographs
correlate. One command does the same with one of them:

    periscopy reconstruct DIR/sum.npy --mask DIR/mask.npy --scene corner --hidden 1x60
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import periscopy_sim as ps
from periscopy_sim.figures.panels import displayable, draw_panels
from periscopy_sim.numerics import Array

ANGLES = 1, 60
NOISE = 0.01
"""Noise of a pixel over the photograph's mean, or a little less."""

FLOOR = slice(4, None), slice(None, 81)
"""Rows and columns of the published 93 x 93 pixels that show floor."""


def write_photographs(file: Path, out: Path) -> tuple[dict[str, Array], np.ndarray]:
    """Write the photographs and the mask of the floor; return both."""
    with np.load(file) as light:
        penumbra, ambient = light["penumbra"], light["ambient"]
    photographs = {"penumbra": penumbra, "sum": penumbra + ambient}
    mask = np.zeros(penumbra.shape, bool)
    mask[FLOOR] = True
    out.mkdir(parents=True, exist_ok=True)
    for name, values in {**photographs, "mask": mask}.items():
        np.save(out / f"{name}.npy", values)
    return photographs, mask


def recovered_angles(
    photographs: dict[str, Array], mask: np.ndarray | None, **values: float
) -> dict[str, Array]:
    """Return the angles, (60,), that each photograph shows, at values of the scene's numbers."""
    rows, columns = next(iter(photographs.values())).shape
    film = {"height": rows, "width": columns}
    scene = ps.load_scenario("corner", ANGLES, {**film, **values})
    given = {name: ps.Photograph.of(light, mask=mask) for name, light in photographs.items()}
    fitted = {name: scene.method("noise-aware", y, noise=NOISE) for name, y in given.items()}
    return {name: fitted[name].reconstruct(y).ravel() for name, y in given.items()}


def main(
    photographs: Annotated[Path, typer.Argument(help="NPZ file of the corner camera.")],
    out: Annotated[Path, typer.Option(help="Folder of the photographs and the mask.")],
) -> None:
    """Recover the angles from the penumbra alone and under room light; print their correlation."""
    taken, mask = write_photographs(photographs, out)
    print("| pixels | correlation of the angles |\n|---|---|")
    for pixels, used in (("all", None), ("floor", mask)):
        angles = recovered_angles(taken, used)
        print(f"| {pixels} | {np.corrcoef(*angles.values())[0, 1]:.3f} |")
    draw(taken["sum"], angles, out / "corner.png")


def draw(photograph: Array, angles: dict[str, Array], file: Path) -> None:
    """Draw the photograph, and the angles as stripes."""
    shown = {"under hidden light alone": "penumbra", "under hidden and room light": "sum"}
    stripes = [
        (f"angles, {title}", displayable(angles[name][None, :, None]))
        for title, name in shown.items()
    ]
    draw_panels(file, [("photograph", displayable(photograph[..., None])), *stripes])


if __name__ == "__main__":
    typer.run(main)
