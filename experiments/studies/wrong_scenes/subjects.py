"""The scenes, each photographed once: path traced where all stands as its file says.

The chair and the plate are the shipped ones, before an orthographic camera. The shelf is a
laboratory that this package did not lay out: a board with openings before a panel that leans back,
other axes, a camera that looks down at 30 degrees, and a room about it that the scene does not
know, whose floor and walls send 8 % more of the monitor's light to the panel. The sign is of
another stranger's making: two boxes that make few shadows, and a camera turned by 28 degrees.
`plain_scenes` has six more, which plain Mitsuba renders without bounces.
"""

from __future__ import annotations

import shutil
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.laboratories.making.laboratory import SCENES, SHELF
from experiments.setting import SNR, kept
from periscopy_sim.calibration.prior import free_parameters, read_by_ruler, start_values
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.ambient_library import ambient_photographs
from periscopy_sim.storage.outputs.provenance import array_sha256, as_text, provenance
from periscopy_sim.storage.outputs.staging import staged_folder

Array = NDArray[np.float64]

NAMES = "chair", "plate", "shelf", "sign"

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
    signal_file: Path
    ambient_file: Path

    def photograph(self, sbr: float, draw: int) -> tuple[Array, float]:
        """Return a photograph at an SBR and 60 dB, of mean 1, and the truth's light in its unit."""
        seed = zlib.crc32(f"{self.subject.name} {sbr:g} {draw}".encode())
        clean = ps.composite(self.signal, self.ambient, sbr)
        return ps.add_noise(clean, SNR, seed), sbr / (1 + sbr) / float(self.signal.mean())


def subjects(folder: Path) -> dict[str, Subject]:
    """Return the scenes by name; the shelf's files are written to a folder."""
    chair, plate, shelf = ps.find_scene("chair"), ps.find_scene("plate"), folder / "shelf"
    sign = SCENES / "sign.xml"
    with staged_folder(shelf) as staged:
        (staged / "meshes").mkdir()
        for name, build in SHELF.meshes.items():
            build().export(staged / "meshes" / f"{name}.ply")
        parts = f"{SHELF.name}.xml", f"{SHELF.name}_room.xml"
        for part in parts:
            shutil.copyfile(SCENES / part, staged / part)
        includes = "".join(f'\n    <include filename="{part}"/>' for part in parts)
        (staged / "furnished.xml").write_text(
            f'<scene version="3.0.0">{includes}\n</scene>\n', "utf-8"
        )
    known = (
        Subject("chair", chair, chair, (29, 36), "mushroom", "overcast"),
        Subject("plate", plate, plate, (29, 36), "still_life", "window_left"),
        Subject(
            "shelf",
            shelf / parts[0],
            shelf / "furnished.xml",
            SHELF.hidden,
            SHELF.hidden_image,
            "ceiling_panels",
        ),
        Subject("sign", sign, sign, (15, 20), "letters", "overcast"),
    )
    return {subject.name: subject for subject in known}


def photographed(subject: Subject, folder: Path) -> Photographed:
    """Path trace a subject, all bounces, or read what a folder holds of it."""
    truth = ps.read_hidden_image(ps.find_image(subject.image), subject.hidden)
    scene = ps.load_scenario(subject.lit, subject.hidden, subject.parameters)
    made = as_text(provenance(scene.document, SEED))
    depends = {
        "scene_sha256": made["scene_sha256"],
        "parameters": str(dict(subject.parameters)),
        # How its last bits are rounded, other threads or processors do not say alike.
        "truth_sha256": array_sha256(np.round(truth, 6)),
        "samples": str(subject.samples),
        "seed": str(SEED),
    }

    def render() -> Array:
        halves = [
            ps.render_photograph(
                scene, truth, samples=subject.samples, only_monitor=True, seed=SEED + half
            )
            for half in range(2)
        ]
        grain = np.std(halves[1] - halves[0]) / 2 / np.sqrt(np.mean(halves[0] ** 2))
        print(f"{subject.name}: path traced to a grain of {100 * grain:.3f} %", flush=True)
        return np.asarray(np.mean(halves, axis=0))

    file, places = folder / f"{subject.name}.exr", folder / subject.name
    signal = kept(file, depends, render, made)
    light = ambient_photographs([subject.place], subject.at(), places, SEED)[subject.place]
    return Photographed(subject, truth, signal, light, file, places / f"{subject.place}.exr")
