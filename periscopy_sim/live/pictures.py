"""A laboratory at one size: from a choice to its pictures."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.calibration.moving_scene import limit_size, limit_sizes
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.metrics import psnr_gain_matched
from periscopy_sim.hidden import Hidden
from periscopy_sim.judgement import check_error
from periscopy_sim.measurement import add_noise, composite, noise_to_signal
from periscopy_sim.methods import own_errors
from periscopy_sim.model.noise import relative_noise
from periscopy_sim.model.residual import quick_residual
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.machine import one_thread
from periscopy_sim.photograph import Photograph, blackened
from periscopy_sim.reconstruction.method import Note, Report, Solution, StillMethod
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.rendering.transport.plan import NOISE
from periscopy_sim.scenario import Scenario
from periscopy_sim.shipped import find_image
from periscopy_sim.storage.pictures import area_average, averaged_photograph, read_hidden_image
from periscopy_sim.view import View

COARSE = 32, 12
"""Pixels along a photograph's longer side, patches along a hidden image's: some 100 ms on one core
from a scene that has moved to its pictures."""


@dataclass(frozen=True)
class Choice:
    """A laboratory's present settings.

    `values` are those of the scene's movable ``<default>``s, by name, which the method believes.
    `image` is the hidden image, a file or a shipped image, empty where it is unknown; `place` the
    place of ambient light, empty for none. For `sbr` and `snr` (dB) see `composite` and
    `add_noise`, for `method`, a name, `find_method`.
    """

    values: Mapping[str, float]
    image: str
    place: str = ""
    sbr: float = 0.5  # a bright room, in which a method must know ambient light
    snr: float = 60.0  # the paper's
    method: str = "noise-aware"


class Overtaken(Exception):  # noqa: N818  nothing is wrong
    """A newer wish came."""


@dataclass(frozen=True, eq=False)
class LivePictures:
    """A laboratory's photograph and its reconstruction, (R, C, 3), of several surfaces by id.

    `scenario` has the values of the choice, which the method believes. `truth` and `psnr` (dB,
    gain-matched) are None where the hidden image is unknown; `report` is the method's, of a given
    photograph with its residual.
    """

    choice: Choice
    scenario: Scenario
    is_coarse: bool
    truth: Any
    photograph: Photograph
    image: Any
    psnr: float | None
    report: Report
    seconds: float = 0.0
    frame: int | None = None  # the number of a frame of a stream


@dataclass(frozen=True, eq=False)
class FrameMethod:
    """A method that is formed for a choice and for photographs under the conditions of `wall`."""

    choice: Choice
    scenario: Scenario
    is_coarse: bool
    truth: Any  # the hidden image; None where it is unknown
    method: StillMethod[Any]
    wall: Photograph  # of the scenario's size
    notes: Sequence[Note]  # on A, and on the errors that the scene states

    @cached_property
    def _follow(self) -> Callable[[Array], Solution[Any]]:
        """What recovers the next frame: quickly, where the method knows videos."""
        entry = METHODS.get(self.choice.method)
        if entry is None or entry.video is None:
            return self.method.solve
        return entry.frames_by(self.method, "none").solve_next

    @property
    def may_judge(self) -> bool:
        """Whether `judge` says more than `see`, from another thread."""
        return self._follow != self.method.solve and self.method.judges_scene

    def see(self, frame: Photograph, noise: float, number: int) -> LivePictures:
        """Return the pictures of a frame, (rows, columns, C), of this size or a larger one.

        `noise` is what is left of the camera's, over the light. Of a method for videos, nothing is
        corrected and the residual has no verdict.
        """
        start, values = time.perf_counter(), self._values(frame)
        with own_errors(self.choice.method, "failed"):
            solution = self._follow(values)
            if self._follow == self.method.solve:
                residual = self.method.residual(values, solution)
            else:
                y = self.method.corrected(values, solution)
                residual = quick_residual(y, solution.image, noise, self.method.fit)
        return LivePictures(
            self.choice, self.scenario, self.is_coarse, None,
            Photograph(values, self.wall.mask), solution.image, None,
            Report(solution.numbers(), residual=residual),
            time.perf_counter() - start, number,
        )  # fmt: skip

    def judge(self, frame: Photograph) -> Report:
        """Return the report of the method for single photographs, with its verdict, on one core."""
        values = self._values(frame)
        with own_errors(self.choice.method, "failed"), one_thread():
            return StillMethod.report(self.method, values, self.method.solve(values))

    def _values(self, frame: Photograph) -> Array:
        """Return a frame's light at this size, black where it is not used."""
        frame = averaged_photograph(frame, self.scenario.photograph_shape)
        return blackened(frame.values, self.wall.mask)


class SizedLaboratory:
    """A laboratory whose photograph and hidden image have the sizes of a scenario.

    `light` is the ambient light of the choice's place, (rows, columns, 3), `photograph` a given
    one, None for synthetic ones, of this size or a larger one; `seed` is of A's rays. At its full
    size it fits a method as `reconstruct` does. A level keeps its last results, and computes only
    those anew whose choices changed.
    """

    def __init__(
        self,
        scenario: Scenario,
        light: Array | None = None,
        photograph: Photograph | None = None,
        *,
        is_coarse: bool,
        seed: int = 0,
    ) -> None:
        self.scenario, self.is_coarse = replace(scenario, seed=seed), is_coarse
        shape = scenario.photograph_shape
        self._light = None if light is None else area_average(light, shape)
        self._given_photograph = photograph and averaged_photograph(photograph, shape)
        self._kept: dict[str, tuple[object, Any]] = {}

    def pictures(
        self, choice: Choice, unless_overtaken: Callable[..., None], wall: Photograph | None = None
    ) -> LivePictures:
        """Compute the pictures of a choice; a PeriscopyError says what of it does not exist.

        It often calls `unless_overtaken`, with any arguments, which may raise `Overtaken`. A
        photograph `wall` becomes the given one.
        """
        start = time.perf_counter()
        if wall is not None:
            self._given_photograph = averaged_photograph(wall, self.scenario.photograph_shape)
        formed = self.form(choice, unless_overtaken)
        scenario, method, photograph = formed.scenario, formed.method, formed.wall
        with own_errors(choice.method, "failed"):
            solution = method.solve(photograph)
            found = scenario.hidden.images(solution.image).items()
            image = scenario.hidden.unwrapped({n: f.astype(np.float32) for n, f in found})
            report = method.report(photograph, solution)
            if self._given_photograph is None:
                report = replace(report, residual=None)
        report = replace(report, warnings=[*report.warnings, *formed.notes])
        unless_overtaken()
        return LivePictures(
            choice, scenario, self.is_coarse, formed.truth, photograph, image,
            None if formed.truth is None else self._psnr(image, formed.truth),
            report, seconds=time.perf_counter() - start,
        )  # fmt: skip

    def form(
        self, choice: Choice, unless_overtaken: Callable[..., None], wall: Photograph | None = None
    ) -> FrameMethod:
        """Form the method of a choice; an average of frames, `wall`, becomes the photograph."""
        if wall is not None:
            self._given_photograph = averaged_photograph(wall, self.scenario.photograph_shape)

        def kept(name: str, key: object, make: Callable[[], Any]) -> Any:
            """Return what `make` makes; that of before while its key is the same."""
            unless_overtaken()
            if name not in self._kept or self._kept[name][0] != key:
                self._kept.pop(name, None)  # before another takes as much memory
                self._kept[name] = key, make()
            return self._kept[name][1]

        values = tuple(choice.values.values())
        given = {name: f"{value:.9g}" for name, value in choice.values.items()}
        scenario = kept("scenario", values, lambda: self.scenario.at(**given))
        truth, photograph = None, self._given_photograph
        if photograph is None:
            noise = noise_to_signal(choice.snr, choice.sbr if choice.place else np.inf)
        else:  # averages of frames to come have less than the present one
            known = None if wall is not None else relative_noise(photograph)
            noise = NOISE if known is None else known
        fineness = np.inf if self.is_coarse else noise  # the quickest A
        if choice.image:
            path = find_image(choice.image)
            truth = kept("f", path, lambda: self._shown(path))
        if photograph is None:
            photograph = self._expose(choice, truth, scenario, fineness)
        unless_overtaken()
        scenario.transport(fineness, choice.method, progress=unless_overtaken)
        # The effect of a scene's errors takes as long as all else, too long for a hand that moves.
        errors: dict[str, float] | None = {} if self.is_coarse else None
        method = scenario.method(choice.method, photograph, noise=fineness, errors=errors)
        unless_overtaken()
        notes = scenario.uncertainty(choice.method, errors)[1]
        notes += check_error(scenario, method.plan.origin, noise)
        return FrameMethod(choice, scenario, self.is_coarse, truth, method, photograph, notes)

    def _shown(self, path: Path) -> Any:
        """Return an image that every hidden surface shows."""
        hidden = self.scenario.hidden
        shapes = hidden.shapes.items()
        return hidden.unwrapped({name: read_hidden_image(path, shape) for name, shape in shapes})

    def _psnr(self, image: Any, truth: Any) -> float:
        """Return the mean over the surfaces, in dB."""
        hidden = self.scenario.hidden
        images, truths = hidden.images(image), hidden.images(truth)
        return float(np.mean([psnr_gain_matched(images[name], truths[name]) for name in hidden]))

    def _expose(self, choice: Choice, truth: Any, scenario: Scenario, noise: float) -> Photograph:
        """Return a photograph, y = A f + b + noise."""
        if truth is None:
            raise PeriscopyError("the monitor is off: choose a hidden image, or give a photograph")
        y = scenario.channel_gain * (scenario.transport(noise) @ scenario.hidden.vector(truth))
        if y.mean() <= 0:
            raise PeriscopyError("no light reaches the wall: the hidden image is black")
        y = (y / y.mean()).reshape(*scenario.photograph_shape, -1)
        if choice.place and self._light is not None:
            y = composite(y, self._light, choice.sbr)
        # One seed: the noise is the same while a scene moves, and pictures do not flicker.
        return Photograph(add_noise(y, choice.snr, seed=0))


def coarse(scenario: Scenario, used: float = 1.0) -> Scenario:
    """Return a scenario at its coarse size; a fraction of its photograph is used.

    At least twice as many pixels as patches are used.
    """
    pixels, longest = COARSE
    hidden, shape = scenario.hidden, limit_size(scenario.photograph_shape, pixels)
    largest = max(map(max, hidden.shapes.values()))
    most = largest * np.sqrt(used * np.prod(shape) / hidden.patches / 2)
    sizes, scene = limit_sizes(hidden, max(1, int(min(longest, most)))), scenario.scene
    return Scenario(
        View.of(scene, shape, camera=scenario.view.camera), Hidden.of_scene(scene, sizes)
    )
