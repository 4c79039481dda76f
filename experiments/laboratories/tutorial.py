"""Photograph the tutorial's laboratory anew, as it is shipped in ``scenes/tutorial``.

What a user would have lies in the folder, the truth in its folder ``truth``: the photograph and one
with the monitor off, points of the wall, a mask that leaves the poster out, the lamp as an STL file
and what a ruler reads, for `periscopy lab`.

`python -m experiments.laboratories.tutorial [--out DIR]`
"""

import shutil
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from experiments.laboratories.making import meshes, ruler
from experiments.laboratories.making.render import SCENE, SEED, make

SHIPPED = Path(__file__).parents[2] / "scenes" / "tutorial"
GIVEN = ("photograph.tiff", "monitor_off.tiff", "points.csv", "poster.png")
TRUTH = ("scene.xml", "hidden.png", "meshes/lamp.ply")
MEASURED = """\
# What a person measured in the laboratory of docs/tutorial.md, with a ruler and a protractor.
# x to the right as one faces the wall, z up from the table, y from the monitor to the wall.

errors: {{length: 1 cm, angle: 2 deg}}   # one standard deviation, of all that states none

wall:
  distance: 105 cm +- 0 mm

camera:                       # the picture is brought to this rectangle of the wall by points.csv
  kind: rectified
  film: 40x56
  bottom_left: [50 cm +- 0 mm, 13 cm +- 0 mm]
  width: 53.2 cm +- 0 mm
  height: 38 cm +- 0 mm

monitor:                      # width and height from its data sheet
  width: 40.8 cm +- 0 mm
  height: 30.6 cm +- 0 mm
  center: [{monitor_x}, {monitor_y}, {monitor_z}]
  turn: {monitor_turn}

occluders:
  - name: lamp
    kind: mesh                # from the printer's file: its size is exact
    file: lamp.stl
    unit: mm
    position: [{lamp_x}, {lamp_y}, 0 cm +- 0 mm]   # it stands on the table
    turn: {lamp_turn}
"""


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")] = SHIPPED,
) -> None:
    """Render the tutorial's laboratory and put its files where they are shipped."""
    with tempfile.TemporaryDirectory() as rendered:
        folder = Path(rendered)
        make(folder)
        for name in (*GIVEN, *(f"truth/{name}" for name in TRUTH)):
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / name, out / name)
    meshes.lamp().apply_scale(1000).export(out / "lamp.stl")
    read = ruler.read_by_ruler(SCENE, 100 * SEED)
    words = {
        name: f"{value:g} deg" if name.endswith("turn") else f"{100 * value:g} cm"
        for name, value in read.items()
    }
    (out / "measurements.yaml").write_text(MEASURED.format(**words), "utf-8")
    print(f"wrote {out}")


if __name__ == "__main__":
    typer.run(main)
