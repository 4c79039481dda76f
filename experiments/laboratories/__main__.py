"""What the package's commands make of laboratories that it did not render.

Stand-ins for real laboratories: plain Mitsuba and Dr.Jit, light that bounces up to six times,
uneven paint, posters, a camera's lens and noise, a ruler's errors of 1 cm and 2 degrees. Each is
taken the way that a user goes, with a picture after each command. A person's ruler gives a scene.
Before it stand the photograph as it comes (only averaged to the scene's film), the same rectified
by points of the wall, that with a photograph of the monitor off, and that before the calibrated
scene. For comparison, the true scene has a wall of even paint and a photograph with the monitor
off. The commands see what a user has; the truth is only compared with.

`python -m experiments.laboratories --out DIR [--names lamp,plate,shelf,bottle] [--rulers 4]
[--rendered DIR]` prints a table and draws the pictures.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

import periscopy_sim as ps
from experiments.laboratories.making import ruler
from experiments.laboratories.making.laboratory import LABORATORIES, Laboratory
from experiments.page import one_line_errors
from periscopy_sim.cli import app
from periscopy_sim.figures.panels import displayable, draw_panels
from periscopy_sim.numerics import Array

TRUE = "true scene, even wall"
STAGES = TRUE, "as it comes", "prepare", "--monitor-off", "calibrate"

HEADER = f"""\
Gain-matched PSNR in dB, unshifted (registered), and what stays unexplained; determined numbers, of
these within 3 standard errors, and the farthest from its true value, in standard errors.

| laboratory | ruler | {" | ".join(STAGES)} | determined | within | farthest | trusted |
|{"---|" * (len(STAGES) + 6)}"""


@dataclass(frozen=True)
class User:
    """A user who goes the way with one ruler: the laboratory, its folder, and where results go.

    Attributes
    ----------
    summaries, images
        What `reconstruct` wrote after each stage.
    """

    laboratory: Laboratory
    folder: Path
    out: Path
    summaries: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    images: dict[str, Array] = field(default_factory=dict)

    def prepare(self, photograph: str, scene: Path, *, points: bool = True) -> Path:
        """Bring a photograph to a scene's film; return the EXR file, its mask lies beside."""
        out = self.out / f"{photograph} in {scene.stem}" / "wall.exr"
        out.parent.mkdir(parents=True, exist_ok=True)
        file, black = self.folder / f"{photograph}.tiff", self.laboratory.camera.black
        rectify = ["--points", self.folder / "points.csv"] if points else []
        rectify += ["--mask", self.folder / "poster.png"]
        periscopy("prepare", file, "--scene", scene, "--black", black, *rectify, "--out", out)
        return out

    def calibrate(self, photograph: Path, scene: Path, off: Path) -> Path:
        """Calibrate what a scene declares as uncertain; return the new scene, beside the old."""
        out = scene.with_name(f"{scene.stem}_calibrated.xml")
        periscopy("calibrate", *self._given(photograph, scene, off), "--out", out)
        return out

    def reconstruct(self, stage: str, photograph: Path, scene: Path, off: Path | None) -> None:
        """Reconstruct after a stage."""
        out = self.out / stage
        truth = ["--truth", self.folder / "truth" / "hidden.png"]
        periscopy("reconstruct", *self._given(photograph, scene, off), *truth, "--out", out)
        self.summaries[stage] = json.loads((out / "summary.json").read_text("utf-8"))
        self.images[stage] = np.load(out / "reconstruction.npy").astype(np.float64)

    def _given(self, photograph: Path, scene: Path, off: Path | None) -> list[object]:
        mask = photograph.with_name("wall_mask.png")
        dark = [] if off is None else ["--monitor-off", off]
        patches = "x".join(map(str, self.laboratory.hidden))
        return [photograph, "--scene", scene, "--hidden", patches, "--mask", mask, *dark]


def periscopy(*words: object) -> None:
    """Run a command of the package."""
    app([*map(str, words)], standalone_mode=False)


def go(user: User, number: int) -> dict[str, Any]:
    """Take every step with one person's ruler; return what `calibrate` reports."""
    laboratory, folder = user.laboratory, user.folder
    true, seed = folder / "truth" / "scene.xml", 100 * laboratory.seed + number
    points = laboratory.camera.distortion != 0  # a scene's camera has no such lens
    even, off = (
        user.prepare(f"{name}_even", true, points=points) for name in ("photograph", "monitor_off")
    )
    user.reconstruct(TRUE, even, true, off)
    camera, scene = (folder / f"{name}_{number}.xml" for name in ("ruler_camera", "ruler"))
    camera.write_text(ruler.measured_scene(laboratory.scene, seed), "utf-8")
    # Points of the wall bring the picture to this camera: its numbers carry no error.
    scene.write_text(ruler.measured_scene(laboratory.scene, seed, ("camera", "aim")), "utf-8")
    as_it_comes = user.prepare("photograph", camera, points=False)
    user.reconstruct("as it comes", as_it_comes, camera, None)
    wall, off = (user.prepare(name, scene) for name in ("photograph", "monitor_off"))
    user.reconstruct("prepare", wall, scene, None)
    user.reconstruct("--monitor-off", wall, scene, off)
    calibrated = user.calibrate(wall, scene, off)
    user.reconstruct("calibrate", wall, calibrated, off)
    report: dict[str, Any] = json.loads(calibrated.with_suffix(".json").read_text("utf-8"))
    return report


def row(user: User, number: int) -> str:
    """Go the way with one ruler; return the row of `HEADER`'s table, up to where it fails."""
    try:
        cells = list(_calibrated(user.laboratory, go(user, number)))
    except ps.PeriscopyError as error:
        cells = ["", "", "", str(error)]
    psnrs = []
    for stage in STAGES:
        form = "{psnr:.1f} ({psnr_registered:.1f}), {unexplained:.2%}"
        psnrs.append(form.format(**user.summaries[stage]) if stage in user.summaries else "failed")
    return f"| {user.laboratory.name} | {number} | {' | '.join([*psnrs, *cells])} |"


def _calibrated(laboratory: Laboratory, report: Mapping[str, Any]) -> Iterator[str]:
    """Yield how far determined numbers are from the true ones, and whether to trust them."""
    true = ruler.declared(laboratory.scene)
    strays = {
        name: abs(one["value"] - true[name]) / one["standard_error"]
        for name, one in report["parameters"].items()
        if one["determined"]
    }
    farthest = max(strays, key=lambda name: strays[name], default=None)
    yield f"{len(strays)} of {len(report['parameters'])}"
    yield str(sum(stray <= 3 for stray in strays.values()))
    yield f"{strays[farthest]:.1f} ({farthest})" if farthest else "none"
    yield "yes" if report["trusted"] else "; ".join(map(str, report["doubts"]))


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    names: Annotated[str, typer.Option(help="Laboratories, by comma.")] = ",".join(LABORATORIES),
    rulers: Annotated[int, typer.Option(help="Persons who measure each.", min=1)] = 4,
    rendered: Annotated[
        Path | None,
        typer.Option(help="Folder of the laboratories; OUT/rendered unless given."),
    ] = None,
) -> None:
    """Photograph laboratories, unless they are there, and take each the way that a user goes."""
    from experiments.laboratories.making.render import make

    rows = [HEADER]
    with one_line_errors():
        for name in names.split(","):
            if name not in LABORATORIES:
                known = ", ".join(LABORATORIES)
                raise ps.PeriscopyError(f"--names: no laboratory '{name}'; there are {known}")
            laboratory = LABORATORIES[name]
            folder = make(laboratory, rendered or out / "rendered")
            truth = ps.read_hidden_image(folder / "truth" / "hidden.png", laboratory.hidden)
            for number in range(rulers):
                user = User(laboratory, folder, out / f"{name}_{number}")
                rows.append(row(user, number))
                print("\n".join(rows), flush=True)
                panels = [("hidden image", displayable(truth, 1))]
                for stage, image in user.images.items():
                    panels.append((stage, ps.gain_matched(image, truth)))
                draw_panels(out / f"{name}_{number}.png", panels)


if __name__ == "__main__":
    typer.run(main)
