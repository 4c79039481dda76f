"""One draw of wrong numbers: what its calibration found, and what the pictures are worth."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.page import processor_seconds
from experiments.studies.wrong_scenes.subjects import Photographed
from periscopy_sim.calibration.moving_scene import uncertain_transport
from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.errors import SceneError
from periscopy_sim.model.uncertainty import UncertainTransport
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]

SCENES = ("ruler", "calibrated", "true")
"""With which the hidden image is recovered."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """A draw.

    Attributes
    ----------
    subject, sbr, draw
        Which one.
    names
        (P) of the numbers that a ruler may have wrong.
    true_values, start, ruler_errors, values, standard_errors
        (P,) where they are; as the ruler has them, and its errors; as calibrated, and their
        standard errors.
    determined
        (P,) whether the photograph determines each.
    correlation
        (P, P) of the standard errors.
    truth, images
        (R, C, 3) in [0, 1], and (3, R, C, 3) as recovered with each of `SCENES`, in the
        photograph's unit, in which the truth is `light` times as much.
    light
        See there.
    image_errors
        (R, C, 3) standard errors of the image with the calibrated scene.
    geometry
        Whether these count the scene's.
    moved
        Whether the calibration left the ruler's values.
    doubts
        Why the calibration is not to be trusted.
    overdispersion
        See `periscopy_sim.Calibration`.
    seconds
        Of processors' time: of the calibration, and of its picture with its errors.
    """

    subject: str
    sbr: float
    draw: int
    names: list[str]
    true_values: Array
    start: Array
    ruler_errors: Array
    values: Array
    standard_errors: Array
    determined: NDArray[np.bool_]
    correlation: Array
    truth: Array
    images: Array
    light: float
    image_errors: Array
    geometry: bool
    moved: bool
    doubts: list[str]
    overdispersion: float
    seconds: list[float]

    @property
    def trusted(self) -> bool:
        """Whether the calibration is."""
        return not self.doubts

    @property
    def z(self) -> Array:
        """(P,) how far the values are from the true ones, in standard errors."""
        return np.asarray((self.values - self.true_values) / self.standard_errors)

    @property
    def patch_z(self) -> Array:
        """(R C 3,) how far the unshifted patches are from the truth's, in standard errors."""
        off = self.images[SCENES.index("calibrated")] - self.light * self.truth
        return np.asarray(off / self.image_errors).ravel()

    @property
    def matched_patch_z(self) -> Array:
        """(R C 3,) the same, after the factor of each channel that fits the truth best."""
        image, truth = self.images[SCENES.index("calibrated")], self.light * self.truth
        gain = np.sum(image * truth, axis=(0, 1)) / np.sum(image**2, axis=(0, 1))
        return np.asarray((image - truth / gain) / self.image_errors).ravel()

    @cached_property
    def psnr(self) -> dict[str, float]:
        """Of each picture, unshifted, in dB."""
        return {
            n: ps.psnr_gain_matched(f, self.truth) for n, f in zip(SCENES, self.images, strict=True)
        }

    @cached_property
    def registered(self) -> dict[str, float]:
        """Of each picture after the shift that fits the truth best."""
        return {
            n: ps.registered(f, self.truth).psnr for n, f in zip(SCENES, self.images, strict=True)
        }


class Trial:
    """Draws of one photographed scene; the method of the true scene is fitted once."""

    def __init__(self, photographed: Photographed) -> None:
        self.photographed = photographed
        self.subject = photographed.subject

    @cached_property
    def knowing(self) -> ps.NoiseAware:
        """The method that has the true scene."""
        return fitted(self.subject.at())

    def outcome(
        self, sbr: float, draw: int, progress: Callable[[float], None] | None = None
    ) -> Outcome:
        """Measure wrongly, calibrate from there, and recover the image with all three scenes."""
        subject, start = self.subject, self.subject.measured(draw)
        photograph, light = self.photographed.photograph(sbr, draw)
        begun = processor_seconds()
        found = ps.calibrate(
            photograph,
            subject.scene,
            subject.hidden,
            parameters={**subject.parameters, **start},
            progress=progress,
        )
        calibrated = processor_seconds()
        image, errors, geometry = reconstructed(
            subject.at(found.values), found.scene_covariance, photograph
        )
        recovered = processor_seconds()
        others = [
            method.reconstruct(photograph) for method in (fitted(subject.at(start)), self.knowing)
        ]
        numbers = [
            (p.start, p.ruler_error, p.value, p.standard_error, p.determined)
            for p in found.parameters
        ]
        starts, ruler_errors, values, standard_errors, determined = np.array(numbers).T
        return Outcome(
            subject=subject.name,
            sbr=sbr,
            draw=draw,
            names=list(found.values),
            true_values=subject.true_values,
            start=starts,
            ruler_errors=ruler_errors,
            values=values,
            standard_errors=standard_errors,
            determined=determined.astype(bool),
            correlation=found.correlation,
            truth=self.photographed.truth,
            images=np.stack([others[0], image, others[1]]),
            light=light,
            image_errors=errors,
            geometry=geometry,
            moved=found.moved,
            doubts=list(found.doubts),
            overdispersion=found.overdispersion,
            seconds=[calibrated - begun, recovered - calibrated],
        )


def fitted(scene: Scenario, uncertain: UncertainTransport | None = None) -> ps.NoiseAware:
    """Return the noise-aware method of a scene, as `periscopy reconstruct` fits it."""
    A, B = ps.transport(scene, by="areas"), ps.point_light_backgrounds(scene)
    return ps.NoiseAware.for_scene(scene, A, B, uncertain=uncertain)


def reconstructed(
    scene: Scenario, known: SceneCovariance, photograph: Array
) -> tuple[Array, Array, bool]:
    """Return image and standard errors, (R, C, 3), as of a calibrated scene that is written.

    Also returned is whether the errors count the scene's, which they do wherever it can be moved by
    them.
    """
    try:
        uncertain = uncertain_transport(scene, known)
    except SceneError as error:
        print(f"{scene.path.stem}: errors leave out the scene's ({error})", file=sys.stderr)
        uncertain = None
    method = fitted(scene, uncertain)
    found = method.solve(photograph)
    shape = (*scene.hidden_shape, 3)
    errors = np.reshape(method.standard_errors(found), shape)
    return np.asarray(found.image, np.float64), errors, uncertain is not None


def write_outcome(outcome: Outcome, file: Path, made_from: str) -> None:
    """Keep an outcome as an NPZ file, with the digest of what it was made from."""
    held = {field.name: getattr(outcome, field.name) for field in fields(outcome)}
    arrays = {name: value for name, value in held.items() if isinstance(value, np.ndarray)}
    record = {name: value for name, value in held.items() if name not in arrays}
    with staged_file(file) as staged:
        np.savez_compressed(staged, record=json.dumps([made_from, record]), **arrays)


def read_outcome(file: Path, made_from: str) -> Outcome | None:
    """Return the outcome that was kept, if it was made from the same."""
    if not file.is_file():
        return None
    with np.load(file) as kept:
        source, record = json.loads(str(kept["record"]))
        if source != made_from:
            return None
        return Outcome(**record, **{name: kept[name] for name in kept.files if name != "record"})
