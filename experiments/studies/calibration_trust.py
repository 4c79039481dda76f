"""Calibrations of hundreds of spoilt photographs: believed only where they are right, or not.

A plate before a monitor, in closed form: what part of each patch a point of the wall sees through,
so that a calibration takes a second. Where plate, monitor and camera stand is drawn from a ruler's
errors. The photograph is spoilt by what no scene knows: paint uneven over small or large areas, a
seam of the paint, a lamp so near that no far lights make its light. The chain is the package's own,
from prior to doubts. Printed are, for each kind of trouble: how many parameters are told as
determined by the photograph, how many of these lie within 3 of the errors that are told, how many
calibrations are not to be trusted, how many leave all as the ruler has it, and by how much the
image that the evidence finds comes nearer to the one at the true places.

`python -m experiments.studies.calibration_trust [--photographs 20]`
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from periscopy_sim.calibration.calibrate_levels import calibrate_levels
from periscopy_sim.calibration.consider_analysis import UncertainParameters
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel
from periscopy_sim.calibration.explanation.smooth_gain import SmoothGain
from periscopy_sim.calibration.search.image_shift import ImageShift
from scipy.ndimage import gaussian_filter

from periscopy_sim.calibration.prior import Prior
from periscopy_sim.calibration.result import Calibration

Array = NDArray[np.float64]

PIXELS, HIDDEN = 28, (8, 10)
DISTANCE = 1.03
VIEW = (0.543, 0.064, 0.401)  # x and z of its corner, side
MONITOR = (0.027, 0.139, 0.402, 0.306)  # x and z of its corner, width, height
PLATE = (0.475, 0.214, 0.075, 0.57)  # x and z of its corner, side, y
STICK = 0.0055
RULER = {
    "plate_dx": 0.01,
    "plate_dy": 0.01,
    "plate_dz": 0.01,
    "plate_stretch": 0.02,
    "monitor_dx": 0.01,
    "monitor_dz": 0.01,
    "camera_dx": 0.01,
}
"""Parameters and their errors: metres, and a part of the plate's size. All are 0 in the scene."""

SHIFTS = {"monitor_dx": (HIDDEN[1] / MONITOR[2], 0.0), "monitor_dz": (0.0, HIDDEN[0] / MONITOR[3])}
"""Parameters that only shift the image: by so many patches a metre, across and up."""

DEGREE, LENS = 3, 2
"""Of the polynomials over the wall that far lights and a lens make."""

SBR, SNR = 0.34, 60.0
NEAR = 1e-4
"""Of a ruler's error, by which A is differenced."""

WITHIN = 3.0


def hidden_part(
    low: Array, high: Array, point: Array, depth: float, edges: tuple[float, float]
) -> Array:
    """Return what part of each interval of the monitor a slat hides from each point, (P, K).

    Intervals from `low` to `high`, (K,), at 0; points, (P,), at 1; the slat, between its two edges,
    at `depth`.
    """
    hidden = [(edge - depth * point[:, None]) / (1 - depth) for edge in edges]
    ends = np.clip(hidden[1], low, high) - np.clip(hidden[0], low, high)
    return np.asarray(ends / (high - low))


def transport(values: Sequence[float]) -> Array:
    """Return A, (PIXELS², N), with the parameters of `RULER` at some values."""
    dx, dy, dz, stretch, monitor_dx, monitor_dz, camera_dx = map(float, values)
    rows, columns = HIDDEN
    centres = (np.arange(PIXELS) + 0.5) / PIXELS * VIEW[2]
    x, z = VIEW[0] + camera_dx + centres, VIEW[1] + centres[::-1]
    u = MONITOR[0] + monitor_dx + MONITOR[2] * np.arange(columns + 1) / columns
    v = MONITOR[1] + monitor_dz + MONITOR[3] * np.arange(rows + 1) / rows
    side, depth = PLATE[2] * (1 + stretch), (PLATE[3] + dy) / DISTANCE
    left, foot = PLATE[0] + dx, PLATE[1] + dz
    plate = (left, left + side), (foot, foot + side)
    middle = left + side / 2
    stick = (middle - STICK / 2, middle + STICK / 2), (-1.0, foot)
    blocked = sum(
        np.einsum(
            "xu,zv->zxvu",
            hidden_part(u[:-1], u[1:], x, depth, across),
            hidden_part(v[:-1], v[1:], z, depth, up),
        )
        for across, up in (plate, stick)
    )
    aside = (x[:, None] - (u[:-1] + u[1:]) / 2)[None, :, None, :]
    above = (z[:, None] - (v[:-1] + v[1:]) / 2)[:, None, :, None]
    falloff = DISTANCE**2 / (aside**2 + above**2 + DISTANCE**2)
    return np.asarray(((1 - blocked) * falloff**2)[:, :, ::-1, ::-1].reshape(PIXELS**2, -1))


class PlateLevel(ResolutionLevel):
    """The plate's photograph, explained in closed form."""

    def __init__(self, photograph: Array, off: Sequence[Array], prior: Prior, seed: int) -> None:
        self.path, self.names, self.prior, self.seed = Path("plate"), tuple(RULER), prior, seed
        self.photograph_shape, self.hidden_shape = (PIXELS, PIXELS), HIDDEN
        self.used = np.ones(self.photograph_shape, bool)
        self._y = self._seen = photograph.reshape(-1, 3)
        self._off = {str(k): image.reshape(-1, 3) for k, image in enumerate(off)}
        self.scale = float(np.sqrt(np.mean(self._y**2)))
        # A lens makes nothing new of point lights' light; of these polynomials it would.
        smooth = np.stack([field.ravel() for field in smooth_fields(DEGREE + LENS)], axis=1)
        self._smooth = np.linalg.qr(smooth)[0]
        self._background = np.linalg.qr(np.hstack([smooth, *self._off.values()]))[0]
        self._gain, self.by_area = SmoothGain.none(self.used), True

    def differing(self) -> PlateLevel:
        """Return the level itself: there are no rays of which differences need fewer."""
        return self

    def unphysical(self, values: Array) -> None:
        """Return that there is a plate at any values."""

    def matrix(self, values: Array, seed: int | None = None) -> Array:
        """Return the transport matrix; no ray is random, whatever the seed."""
        del seed
        return transport(values.tolist())

    def derivatives(self, values: Array, offsets: Array) -> NDArray[np.float32]:
        """Return derivatives by parameters, (K, M, N), in double precision by short differences."""
        short = NEAR * offsets
        changes = [
            (self.matrix(values + h) - self.matrix(values - h)) / (2 * h.sum()) for h in short
        ]
        return np.asarray(changes, np.float32)


def smooth_fields(degree: int) -> list[Array]:
    """Return polynomials up to a degree over the wall: what far lights make of it."""
    x, z = np.meshgrid(np.linspace(-1, 1, PIXELS), np.linspace(-1, 1, PIXELS))
    return [x**i * z**j for i in range(degree + 1) for j in range(degree + 1 - i)]


@dataclass(frozen=True)
class Trouble:
    """What no scene knows of a photograph."""

    name: str
    paint: float = 0.0  # rms unevenness
    width: float = 0.0  # of the paint's blotches, in pixels
    seam: float = 0.0
    lamp: float = 0.0  # part of the ambient light that a near lamp adds
    monitor_off: bool = False
    vignetting: float = 0.0  # of the corners


TROUBLES = (
    Trouble("none"),
    Trouble("lens", vignetting=0.27),
    Trouble("lens, monitor off", monitor_off=True, vignetting=0.27),
    Trouble("fine paint 0.4 %", 0.004, 0.7),
    Trouble("blotches 0.4 %", 0.004, 2.0),
    Trouble("broad blotches 0.8 %", 0.008, 4.0),
    Trouble("seam 0.8 %", 0.003, 1.0, seam=0.008),
    Trouble("near lamp 20 %", 0.002, 1.0, lamp=0.2),
    Trouble("all of it", 0.004, 1.5, seam=0.006, lamp=0.2),
    Trouble("all of it, monitor off", 0.004, 1.5, seam=0.006, lamp=0.2, monitor_off=True),
)


def taken(trouble: Trouble, seed: int) -> tuple[Array, Array, list[Array]]:
    """Draw where things stand, (P,), the photograph, (rows, columns, 3), and one with it off."""
    random = np.random.default_rng([seed, 14])
    truth = random.standard_normal(len(RULER)) * np.array(list(RULER.values()))
    image = np.abs(gaussian_filter(random.standard_normal((*HIDDEN, 3)), (1, 1, 0)))
    image *= random.random((*HIDDEN, 1)) < 0.8
    signal = (transport(truth.tolist()) @ image.reshape(-1, 3)).reshape(PIXELS, PIXELS, 3)
    fields = smooth_fields(DEGREE)
    x, z = fields[4], fields[1]
    ambient = np.zeros((PIXELS, PIXELS, 3))
    for field in fields:
        ambient += 0.15 * random.standard_normal(3) * field[..., None]
    ambient += 1 - min(0.0, float(ambient.min()))
    if trouble.lamp:
        at = random.uniform(-1.5, 1.5, 2)
        lamp = ((x - at[0]) ** 2 + (z - at[1]) ** 2 + 0.5**2) ** -1.5
        edge = 1 / (1 + np.exp((x * random.uniform(-1, 1) + z - random.uniform(-1, 1)) / 0.05))
        lamp = lamp * edge  # its shade has a rim
        ambient += (trouble.lamp * ambient.mean() * lamp / lamp.mean())[..., None]
    light = signal / signal.mean() * SBR + ambient / ambient.mean()
    uneven = np.zeros((PIXELS, PIXELS))
    if trouble.paint:
        blotches = gaussian_filter(random.standard_normal((PIXELS, PIXELS)), trouble.width)
        uneven += trouble.paint * (blotches - blotches.mean()) / blotches.std()
    if trouble.seam:
        angle, where = random.uniform(0, np.pi), random.uniform(-0.5, 0.5)
        uneven += trouble.seam * (x * np.cos(angle) + z * np.sin(angle) > where)
    σ = 10 ** (-SNR / 20) * np.sqrt(np.mean(light**2))

    lens = 1 - trouble.vignetting * (x**2 + z**2) / 2

    def spoilt(of: Array) -> Array:
        seen = of * (lens * (1 + uneven))[..., None]
        return np.asarray(seen + σ * random.standard_normal(of.shape))

    off = [spoilt(ambient / ambient.mean())] if trouble.monitor_off else []
    return truth, spoilt(light), off


def calibrated(trouble: Trouble, seed: int) -> tuple[Array, Calibration, PlateLevel]:
    """Calibrate one photograph; also return the truth."""
    truth, photograph, off = taken(trouble, seed)
    level = PlateLevel(photograph, off, Prior(0 * truth, np.array(list(RULER.values()))), seed)
    nothing = UncertainParameters((), np.empty(0), np.empty(0))
    shift = ImageShift(np.array([SHIFTS.get(name, (0.0, 0.0)) for name in RULER]).T)
    found = calibrate_levels([copy(level) for _ in range(2)], 0 * truth, nothing, shift=shift)
    return truth, found, level


def image_error(level: PlateLevel, place: Array, truth: Array) -> float:
    """Return the error of the image that the evidence finds, beside that at the truth, in dB."""
    image, known = (
        level.gained(level.explain(values)).explain(values).images for values in (place, truth)
    )
    return float(20 * np.log10(np.linalg.norm(image - known) / np.linalg.norm(known) + 1e-6))


@dataclass(frozen=True)
class Outcome:
    """What one calibration told, and what was true."""

    off: Array  # (P,) distance from the truth, in told errors
    determined: NDArray[np.bool_]  # (P,)
    trusted: bool
    moved: bool
    overdispersion: float
    gain: float  # of the image, in dB


def outcome(trouble: Trouble, seed: int) -> Outcome:
    """Calibrate one photograph, and compare with the truth."""
    truth, found, level = calibrated(trouble, seed)
    values, told = np.array([(p.value, p.standard_error) for p in found.parameters]).T
    return Outcome(
        np.abs(values - truth) / told,
        np.array([p.determined for p in found.parameters]),
        found.trusted,
        found.moved,
        found.overdispersion,
        image_error(level, 0 * truth, truth) - image_error(level, values, truth),
    )


def told(outcomes: Iterable[Outcome]) -> str:
    """Return a line of all outcomes of a trouble."""
    outcomes = list(outcomes)
    off = np.array([o.off for o in outcomes])
    determined = np.array([o.determined for o in outcomes])
    within = int((off[determined] < WITHIN).sum())
    gains = np.array([o.gain for o in outcomes])
    overdispersion = np.median([o.overdispersion for o in outcomes])
    return (
        f"determined {determined.sum():4d} of {determined.size}, within {WITHIN:g} errors {within} "
        f"({100 * within / max(determined.sum(), 1):.1f} %), of all parameters "
        f"{100 * np.mean(off < WITHIN):.1f} %; not trusted {sum(not o.trusted for o in outcomes)}, "
        f"left at the ruler's {sum(not o.moved for o in outcomes)}; overdispersion "
        f"{overdispersion:.1f}; image nearer by {np.median(gains):.1f} dB in the median, "
        f"{np.percentile(gains, 10):.1f} in the worst tenth, {gains.min():.1f} at worst"
    )


def main(
    photographs: Annotated[int, typer.Option(help="Of each kind of trouble.")] = 20,
    seed: Annotated[int, typer.Option(help="Of the first.")] = 0,
) -> None:
    """Print one line for each kind of trouble, and one for all."""
    everything: list[Outcome] = []
    for trouble in TROUBLES:
        outcomes = [outcome(trouble, number) for number in range(seed, seed + photographs)]
        print(f"{trouble.name}: {told(outcomes)}", flush=True)
        everything += outcomes
    print(f"all: {told(everything)}")


if __name__ == "__main__":
    typer.run(main)
