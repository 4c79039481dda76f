"""The scenes, each photographed once: path traced where all stands as its file says.

The chair and the plate are the shipped ones, before an orthographic camera. The shelf is a
laboratory that this package did not lay out: a board with openings before a panel that leans back,
other axes, a camera that looks down at 30 degrees, and a room about it that the scene does not
know, whose floor and walls send 8 % more of the monitor's light to the panel. The sign is of
another stranger's making: two boxes that make few shadows, and a camera turned by 28 degrees.
`plain_scenes` has six more, which plain Mitsuba renders without bounces.
"""

import shutil
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import periscopy_sim as ps
from experiments.setting import kept
from periscopy_sim.calibration.prior import free_parameters, read_by_ruler, start_values
from periscopy_sim.numerics import Array
from periscopy_sim.rendering.scene_files import read_document
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.outputs import staged_folder
from periscopy_sim.storage.provenance import array_sha256, scene_sha256

NAMES = "chair", "plate", "shelf", "sign"

SCENES = Path(__file__).with_name("scenes")

SAMPLES = 16384
"""Paths a pixel of each of two renderings. Their mean has a grain of 0.09 % of the chair's signal,
nearly the noise at 60 dB; at an SBR of 0.5 it is less than a third of that noise."""

SEED = 15
"""Of the rendered light."""


@dataclass(frozen=True)
class Subject:
    """A scene, and how it is photographed.

    Attributes
    ----------
    name
        Of the scene.
    scene
        Its file, with true values and the ruler's errors: what is calibrated.
    lit
        The file that is photographed: the same, or with more about it that only reflects.
    hidden
        (R, C) of the hidden image.
    image, place
        Names of the shipped picture that the monitor shows, and of the ambient light.
    parameters
        Values of the scene's ``<default>``s that all know.
    samples
        Paths a pixel.
    """

    name: str
    scene: Path
    lit: Path
    hidden: tuple[int, int]
    image: str
    place: str
    parameters: Mapping[str, str] = field(default_factory=dict)
    samples: int = SAMPLES

    @property
    def errors(self) -> dict[str, float]:
        """The ruler's errors, of all numbers that have one, by name."""
        return free_parameters(read_document(self.scene, self.parameters))

    @property
    def true_values(self) -> Array:
        """(P,) where things stand, in the order of `errors`."""
        return start_values(read_document(self.scene, self.parameters), tuple(self.errors))

    def at(self, values: Mapping[str, float] | None = None) -> Scenario:
        """Return the scene with some numbers otherwise."""
        return ps.load_scenario(self.scene, self.hidden, {**self.parameters, **(values or {})})

    def measured(self, draw: int) -> dict[str, float]:
        """Draw what a ruler reads of every number at once: normal errors, as declared."""
        return read_by_ruler(self.at(), [draw, zlib.crc32(self.name.encode())])


@dataclass(frozen=True, eq=False)
class Photographed:
    """A subject's light without noise, (rows, columns, 3), and what the monitor showed."""

    subject: Subject
    truth: Array  # (R, C, 3) in [0, 1]
    signal: Array
    ambient: Array


def subjects(folder: Path) -> dict[str, Subject]:
    """Return the scenes by name; the shelf's files are written to a folder."""
    chair, plate, sign = ps.find_scene("chair"), ps.find_scene("plate"), SCENES / "sign.xml"
    with staged_folder(folder / "shelf") as staged:
        (staged / "meshes").mkdir()
        _shelf().export(staged / "meshes" / "shelf.ply")
        for part in ("shelf.xml", "shelf_room.xml"):
            shutil.copyfile(SCENES / part, staged / part)
        parts = '<include filename="shelf.xml"/><include filename="shelf_room.xml"/>'
        furnished = f'<scene version="3.0.0">{parts}</scene>'
        (staged / "furnished.xml").write_text(furnished, "utf-8")
    known = (
        Subject("chair", chair, chair, (29, 36), "mushroom", "overcast"),
        Subject("plate", plate, plate, (29, 36), "still_life", "window_left"),
        Subject(
            "shelf", folder / "shelf" / "shelf.xml", folder / "shelf" / "furnished.xml",
            (21, 28), "digits", "ceiling_panels",
        ),
        Subject("sign", sign, sign, (15, 20), "letters", "overcast"),
    )  # fmt: skip
    return {subject.name: subject for subject in known}


def _shelf() -> Any:
    """Return a board across y with openings and two legs; the origin is its lower edge's middle."""
    import trimesh

    bars = [
        ((-0.085, 0.085), (0.0, 0.014)),
        ((-0.085, 0.085), (0.128, 0.14)),
        ((-0.085, -0.073), (0.013, 0.129)),
        ((0.071, 0.085), (0.013, 0.129)),
        ((-0.022, -0.010), (0.013, 0.129)),
        ((-0.011, 0.072), (0.058, 0.072)),
        ((-0.074, -0.021), (0.090, 0.098)),
        ((0.028, 0.072), (0.071, 0.129)),
        ((-0.08, -0.065), (-0.38, 0.001)),
        ((0.06, 0.075), (-0.38, 0.001)),
    ]
    bounds = [np.transpose([(-0.006, 0.006), *each]) for each in bars]
    return trimesh.util.concatenate([trimesh.creation.box(bounds=each) for each in bounds])


def photographed(subject: Subject, folder: Path) -> Photographed:
    """Path trace a subject and its ambient light, or read what a folder holds of them."""
    scene = replace(subject.at(), seed=SEED)
    signal = path_traced(subject, subject.image, folder)
    ambient = scene.ambient(subject.place).photograph
    return Photographed(subject, scene.image(subject.image), signal, ambient)


def path_traced(subject: Subject, image: str, folder: Path, seed: int = SEED) -> Array:
    """Path trace the monitor's light of a picture, all bounces, or read what a folder holds."""
    scene = ps.load_scenario(subject.lit, subject.hidden, subject.parameters)
    shown = scene.image(image)
    depends = {
        "scene_sha256": scene_sha256(subject.lit),
        "parameters": str(dict(subject.parameters)),
        # How its last bits are rounded, other threads or processors do not say alike.
        "truth_sha256": array_sha256(np.round(shown, 6)),
        "samples": str(subject.samples),
        "seed": str(seed),
    }

    def render() -> Array:
        halves = [
            ps.render_photograph(
                scene, shown, samples=subject.samples, only_monitor=True, seed=seed + half
            )
            for half in range(2)
        ]
        grain = np.std(halves[1] - halves[0]) / 2 / np.sqrt(np.mean(halves[0] ** 2))
        print(f"{subject.name}: {image} path traced to a grain of {100 * grain:.3f} %", flush=True)
        return np.asarray(np.mean(halves, axis=0))

    return kept(folder / f"{subject.name}_{image}.exr", depends, render)
