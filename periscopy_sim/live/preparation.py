"""From a camera's frames to photographs in the pixels of a scene's camera, and their average."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.live.frames import CameraFrame
from periscopy_sim.numerics import Array, Mask
from periscopy_sim.photograph import ColourMatrix, Photograph, blackened
from periscopy_sim.photographs.defects import gaussian_spread
from periscopy_sim.photographs.develop import (
    SensorImage,
    change_beyond_noise,
    check_same_size,
    differing,
)
from periscopy_sim.photographs.marks import WallPoints, WallTags
from periscopy_sim.photographs.prepare import FilmPixels
from periscopy_sim.scenario import Scenario

EXPOSURE, EVEN = 0.05, 1 / 3
"""Change of the light's logarithm that counts as another exposure, and its spread over the pixels,
over its size, up to which they change alike."""

LINES = 40
"""Rows and columns of pixels, at least, that show such a change."""

STEADY = 10.0
"""Seconds between two changes of the mask: a method needs some of them to be formed anew."""

TAKEN = "the average with the monitor off"
"""Name of the monitor-off photograph that is taken from the frames."""

NOISE_FRAMES = 30
"""Frames over which the noise of a frame is averaged."""


@dataclass(frozen=True, eq=False)
class Companions:
    """What belongs to all frames of a camera at rest, as `prepare` and `Photograph` have it.

    `mask` is of the frames' size or of the film's. `dark` and the values of `monitor_off` are of
    the frames' size, in linear light; the latter may be of the film's.
    """

    marks: WallPoints | WallTags | None = None
    mask: Mask | None = None
    black: float = 0.0
    dark: SensorImage | None = None
    monitor_off: Mapping[str, SensorImage] = field(default_factory=dict)
    colour_matrix: ColourMatrix | None = None


class RunningAverage:
    """The running average of frames of one camera and size, with the noise that it leaves.

    It forgets exponentially; the first frames are averaged evenly. It starts anew when the exposure
    changes. `wall` is a `Photograph` with the mask and the photographs with the monitor off: a new
    object whenever these change. `warnings` are one line each, `record` the numbers of the view by
    marks. Errors are those of `prepare`, or say that a companion is not of the frames' size.
    """

    def __init__(
        self,
        first: CameraFrame,
        scenario: Scenario,
        companions: Companions,
        page_off: Array | None = None,
    ) -> None:
        self.shape, self._colours = first.values.shape, companions.colour_matrix
        self._pixels = FilmPixels(first.light, scenario, companions.marks, companions.mask)
        film, self.warnings = self._pixels.film, self._pixels.warnings
        self.record = film.view.record(film.placement) if film else {}
        self._offset: Array | float = companions.black
        if companions.dark is not None:
            self._offset = self._averaged(companions.dark, "the dark frame")
        self._monitor_off = {
            name: each.values.astype(np.float64)
            if each.size == scenario.photograph_shape != self.shape[:2]
            else self._averaged(each, name) - self._offset
            for name, each in companions.monitor_off.items()
        }
        self.page_off = page_off
        self.wall: Photograph | None = None
        self._variance, self._differences = 0.0, 0  # of a frame's noise over the mean light
        self._first = self._latest = np.empty(0)  # frames of the average
        self._restart()

    def _averaged(self, picture: SensorImage, name: str) -> Array:
        check_same_size(picture.values.shape, self.shape, name)
        return self._pixels.average(picture.values)

    def prepare(self, frame: CameraFrame) -> Array:
        """Return a frame in the film's pixels, (rows, columns, C); saturated light is infinite."""
        return np.asarray(self._pixels.average(frame.values, frame.table) - self._offset, float)

    def _restart(self) -> None:
        self.average: Array | None = None
        self._share, self._frames = 1.0, 0  # of a frame's variance in the average; frames in it
        self._mask = self._pixels.mask  # without pixels that were saturated
        self._due = 0.0  # when the mask of `wall` may change

    def add(self, camera_frame: CameraFrame, count: int = 1) -> list[str]:
        """Average one frame more; return what a person should know, one line each.

        The average leaves as little noise as the mean of `count` frames.
        """
        frame, lines, times = self.prepare(camera_frame), list[str](), 0.0
        full: Mask = np.asarray(np.isinf(frame).any(axis=2))
        # The hidden picture may have moved since the average began; an exposure may drift slowly.
        if self.average is not None:
            times = self._change(self._latest, frame) or self._change(self._first, frame)
        if times:
            self._restart()
            lines.append(
                f"the light is {times:.3g} times what it was, and the average starts anew: fix "
                "exposure and gain, and expose for whole periods of lamps that flicker"
            )
        elif count > 1 and self.average is not None:
            change = change_beyond_noise(self.average, frame, self._mask & ~full)
            if change:
                lines.append(f"the frames are averaged, though {differing(change)}")
        if (full & self._mask).any():
            self._mask = self._mask & ~full
            fewer, every = self._mask.sum(), self._pixels.mask.sum()
            of = f"{every - fewer} of {every} pixels"
            lines.append(f"saturated: {of} are left out; shorten the exposure")
        if self.average is None:
            self.average, self._first = np.nan_to_num(frame, posinf=0), frame
        elif self._mask.any():
            self._measure_noise(frame)
        self._frames += 1
        weight = 1 / min(self._frames, (count + 1) / 2)
        # Where it is saturated, a method that still uses the pixel sees what was before.
        seen = np.where(full[..., np.newaxis], self.average, frame)
        self.average = self.average + weight * (seen - self.average)
        self._share = (1 - weight) ** 2 * self._share + weight**2
        self._latest = frame
        if not self._mask.any():
            self._restart()
            self.wall = None
            raise PhotographError("all pixels are saturated or masked; shorten the exposure")
        is_other = self.wall is None or not np.array_equal(self._mask, self.wall.pixels)
        if is_other and time.monotonic() >= self._due:
            self._make_wall(self.average)
        return lines

    def _change(self, before: Array, frame: Array) -> float:
        """Return the factor of the exposure since a frame before; 0 if it is the same."""
        step = max(1, min(self._mask.shape) // LINES)
        few = np.s_[::step, ::step]
        old, new = (each[few][self._mask[few]].mean(axis=-1) for each in (before, frame))
        lit = (old > 0) & (new > 0) & np.isfinite(new)
        if not lit.any():
            return 0.0
        ratios = np.log(new[lit] / old[lit])
        change = float(np.median(ratios))
        spread = gaussian_spread(ratios - change)
        is_other = abs(change) > EXPOSURE and spread < EVEN * abs(change)
        return float(np.exp(change)) if is_other else 0.0

    def _measure_noise(self, frame: Array) -> None:
        difference = frame[self._mask] - self._latest[self._mask]
        level = float(np.mean(frame[self._mask])) or 1.0
        # A median, since the hidden picture may move; two frames' noise differ.
        variance = (gaussian_spread(difference) / level) ** 2 / 2
        self._differences += 1
        self._variance += (variance - self._variance) / min(self._differences, NOISE_FRAMES)

    @property
    def numbers(self) -> tuple[float, float, float]:
        """What `Progress` says of the average: `averaged`, `noise` and `noise_left`."""
        noise = float(np.sqrt(self._variance))
        return 1 / self._share, noise, noise * float(np.sqrt(self._share))

    def photograph(self) -> Photograph | None:
        """Return the average under the conditions of `wall`; None where there is none yet."""
        if self.wall is None or self.average is None:
            return None
        return replace(self.wall, values=self.average)  # a method fitted before may use more pixels

    def toggle_monitor_off(self) -> Photograph | None:
        """Make the average a photograph with the monitor off, or drop a former one; return it."""
        if self.average is not None:
            self.page_off = self.average if self.page_off is None else None
            self._make_wall(self.average)
        return self.photograph()

    def _make_wall(self, average: Array) -> None:
        off = dict(self._monitor_off)
        if self.page_off is not None:
            off[TAKEN] = self.page_off
        self.wall = Photograph.of(
            blackened(average, self._mask), name="the frames", mask=self._mask,
            monitor_off={name: blackened(each, self._mask) for name, each in off.items()},
            colour_matrix=self._colours,
        )  # fmt: skip
        self._due = time.monotonic() + STEADY
