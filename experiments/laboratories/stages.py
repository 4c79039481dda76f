"""A laboratory taken the way that a user goes, with the picture after each command.

Each person's ruler gives a scene. Before it stand the photograph as it comes (only averaged to the
scene's film), the same rectified by points of the wall, that with a photograph of the monitor off,
and that before the calibrated scene. The first column has the true scene, an even wall and a
photograph with the monitor off.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import periscopy_sim as ps
from experiments.laboratories.making import ruler
from experiments.laboratories.making.laboratory import Laboratory
from experiments.page import described
from experiments.report import Claim, Picture, Section, Table, Verdict
from periscopy_sim.cli import app
from periscopy_sim.figures.panels import displayable, draw_panels
from periscopy_sim.numerics import Array

TRUE = "true scene, even wall"
AS_IT_COMES, PREPARED = "as it comes", "prepare"
BACKGROUND, CALIBRATED = "--monitor-off", "calibrate"
STAGES = (TRUE, AS_IT_COMES, PREPARED, BACKGROUND, CALIBRATED)

KINDS = {"psnr": "unshifted", "psnr_registered": "registered"}
"""Of PSNR, and what each is."""

MOST_LOST, LEAST_WON = 4.0, -0.3
"""dB that are asked of calibration: on the true scene's picture, and on the ruler's."""

ERRORS, ASKED = 3.0, 0.95
"""Reported standard errors within which a determined number should lie, and the fraction that
should."""


@dataclass(frozen=True)
class Workplace:
    """Folders of the run and of the laboratories, how many persons measure each, and a seed."""

    out: Path
    rendered: Path
    rulers: int
    seed: int = 0

    def identity(self) -> bytes:
        """Return what tells these inputs from others."""
        return f"{self.rendered} {self.rulers}".encode()


class Result(NamedTuple):
    """What `reconstruct` wrote: its summary, and the image, (R, C, 3)."""

    summary: dict[str, Any]
    image: Array


@dataclass(frozen=True)
class Way:
    """What one person's ruler led to.

    Attributes
    ----------
    results
        By the stage, as far as the commands did not fail.
    determined
        The distance of each determined number from the true one, in standard errors, by name.
    trusted
        "yes", the calibration's doubts, or why a command failed.
    """

    results: Mapping[str, Result]
    determined: Mapping[str, float]
    trusted: str


@dataclass(frozen=True)
class User:
    """What a user has of a laboratory, a folder, and where results go."""

    laboratory: Laboratory
    folder: Path
    out: Path

    def prepare(self, photograph: str, scene: Path, *, points: bool = True) -> Path:
        """Bring a photograph to a scene's film; return the EXR file, its mask lies beside."""
        out = self.out / f"{photograph}_{scene.stem}" / "wall.exr"
        out.parent.mkdir(parents=True, exist_ok=True)
        file, black = self.folder / f"{photograph}.tiff", self.laboratory.camera.black
        rectify = ["--points", self.folder / "points.csv"] if points else []
        rectify += ["--mask", self.folder / "poster.png"]
        periscopy("prepare", file, "--scene", scene, "--black", black, *rectify, "--out", out)
        return out

    def calibrate(self, photograph: Path, scene: Path, off: Path) -> tuple[Path, dict[str, Any]]:
        """Calibrate what a scene declares as uncertain; return the new scene and the report."""
        # Beside the scene that it comes from, so that its meshes are found.
        out = scene.with_name(f"{scene.stem}_calibrated.xml")
        periscopy("calibrate", *self._given(photograph, scene, off), "--out", out)
        report: dict[str, Any] = json.loads(out.with_suffix(".json").read_text("utf-8"))
        return out, report

    def reconstruct(
        self, stage: str, photograph: Path, scene: Path, off: Path | None = None
    ) -> Result:
        """Reconstruct, for a stage."""
        out = self.out / f"{scene.stem} {stage}"
        truth = ["--truth", self.folder / "truth" / "hidden.png"]
        periscopy("reconstruct", *self._given(photograph, scene, off), *truth, "--out", out)
        summary = json.loads((out / "summary.json").read_text("utf-8"))
        return Result(summary, np.load(out / "reconstruction.npy").astype(np.float64))

    def _given(self, photograph: Path, scene: Path, off: Path | None) -> list[object]:
        mask = photograph.with_name("wall_mask.png")
        dark = [] if off is None else ["--monitor-off", off]
        patches = "x".join(map(str, self.laboratory.hidden))
        return [photograph, "--scene", scene, "--hidden", patches, "--mask", mask, *dark]


def periscopy(*words: object) -> None:
    """Run a command of the package."""
    app([*map(str, words)], standalone_mode=False)


def run(laboratory: Laboratory, place: Workplace) -> Section:
    """Photograph a laboratory, go the way with each ruler, and compare."""
    from experiments.laboratories.making.render import make

    user = User(laboratory, make(laboratory, place.rendered), place.out / laboratory.name)
    true = _with_the_truth(user)
    ways = [_way(user, number, true) for number in range(place.rulers)]
    return Section(
        name=laboratory.name,
        title=f"The laboratory “{laboratory.name}”",
        text=described(__doc__),
        claims=list(_claims(ways)),
        pictures=[_draw(user, ways)],
        tables=[_table(laboratory, ways)],
    )


def _with_the_truth(user: User) -> Result:
    """Reconstruct before the true scene, a wall of even paint."""
    scene = user.folder / "truth" / "scene.xml"
    points = user.laboratory.camera.distortion != 0  # a scene's camera has no such lens
    names = "photograph_even", "monitor_off_even"
    wall, off = (user.prepare(name, scene, points=points) for name in names)
    return user.reconstruct(TRUE, wall, scene, off)


def _way(user: User, number: int, true: Result) -> Way:
    """Take every step with one ruler, or those before a command fails."""
    results, determined = {TRUE: true}, dict[str, float]()
    try:
        trusted = _go(user, number, results, determined)
    except ps.PeriscopyError as error:
        trusted = str(error)
    return Way(results, determined, trusted)


def _go(user: User, number: int, results: dict[str, Result], determined: dict[str, float]) -> str:
    """Take every step; return "yes" if the calibration is trusted, else its doubts."""
    laboratory, seed = user.laboratory, 100 * user.laboratory.seed + number
    camera, scene = (user.folder / f"{name}_{number}.xml" for name in ("ruler_camera", "ruler"))
    camera.write_text(ruler.measured_scene(laboratory.scene, seed), "utf-8")
    # Points of the wall bring the picture to this camera: its numbers carry no error.
    scene.write_text(ruler.measured_scene(laboratory.scene, seed, ("camera", "aim")), "utf-8")
    as_it_comes = user.prepare("photograph", camera, points=False)
    results[AS_IT_COMES] = user.reconstruct(AS_IT_COMES, as_it_comes, camera)
    wall, off = (user.prepare(name, scene) for name in ("photograph", "monitor_off"))
    results[PREPARED] = user.reconstruct(PREPARED, wall, scene)
    results[BACKGROUND] = user.reconstruct(BACKGROUND, wall, scene, off)
    calibrated, report = user.calibrate(wall, scene, off)
    results[CALIBRATED] = user.reconstruct(CALIBRATED, wall, calibrated, off)
    values = ruler.declared(laboratory.scene)
    for name, one in report["parameters"].items():
        if one["determined"]:
            determined[name] = abs(one["value"] - values[name]) / one["standard_error"]
    return "yes" if report["trusted"] else "; ".join(map(str, report["doubts"]))


def _gains(ways: Sequence[Way], over: str, kind: str) -> Array:
    """Return dB that calibration wins on a stage, for each way; NaN where a command failed."""
    whole = [way.results for way in ways if CALIBRATED in way.results]
    gains = [each[CALIBRATED].summary[kind] - each[over].summary[kind] for each in whole]
    return np.array([*gains, *[np.nan] * (len(ways) - len(whole))])


def _claims(ways: Sequence[Way]) -> Iterator[Claim]:
    """Return what is asked of the pictures and of the numbers beside what came out."""
    for kind, words in KINDS.items():
        lost = -_gains(ways, TRUE, kind)
        yield Claim(
            f"what the calibrated scene's picture loses on the true scene's, {words}, median",
            f"at most {MOST_LOST:g} dB",
            f"{np.median(lost):.1f} dB",
            Verdict.of(bool(np.median(lost) <= MOST_LOST)),
            f"from {lost.min():.1f} to {lost.max():.1f} dB",
        )
        gained = _gains(ways, BACKGROUND, kind)
        yield Claim(
            f"what calibration wins on the ruler's scene, {words}, worst of the rulers",
            f"at least {LEAST_WON:g} dB",
            f"{gained.min():.1f} dB",
            Verdict.of(bool(gained.min() >= LEAST_WON)),
            f"best {gained.max():.1f} dB",
        )
    strays = [each for way in ways for each in way.determined.values()]
    within = sum(each <= ERRORS for each in strays)
    yield Claim(
        f"determined numbers within {ERRORS:.0f} standard errors",
        f"at least {100 * ASKED:.0f} %",
        f"{within} of {len(strays)}",
        Verdict.of(within >= ASKED * len(strays)),
    )


def _table(laboratory: Laboratory, ways: Sequence[Way]) -> Table:
    def cell(way: Way, stage: str) -> str:
        if stage not in way.results:
            return "failed"
        summary = way.results[stage].summary
        psnrs = "{psnr:.1f} ({psnr_registered:.1f})".format(**summary)
        return f"{psnrs}, {100 * summary['unexplained']:.2f} %"

    def determined(way: Way) -> str:
        strays = way.determined
        furthest = max(strays, key=lambda name: strays[name], default=None)
        return f"{len(strays)}, {strays[furthest]:.1f} ({furthest})" if furthest else "none"

    return Table(
        "Gain-matched PSNR in dB, unshifted (registered), and what stays unexplained; determined "
        "numbers, and the furthest from its true value, in standard errors. SBR "
        f"{laboratory.sbr:g}.",
        ["ruler", *STAGES, "determined", "trusted"],
        [
            [str(number), *(cell(way, stage) for stage in STAGES), determined(way), way.trusted]
            for number, way in enumerate(ways)
        ],
    )


def _draw(user: User, ways: Sequence[Way]) -> Picture:
    """Draw the pictures, a row for each ruler."""
    truth = ps.read_hidden_image(user.folder / "truth" / "hidden.png", user.laboratory.hidden)
    rows = {
        f"ruler {number}": [
            ("hidden image", displayable(truth, 1)),
            *((stage, ps.gain_matched(one.image, truth)) for stage, one in way.results.items()),
        ]
        for number, way in enumerate(ways)
    }
    file = user.out / "pictures.png"
    draw_panels(file, rows)
    return Picture(file, "The picture after each step, gain-matched.")
