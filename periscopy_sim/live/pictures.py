"""A laboratory at one size: from a choice to its pictures."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from periscopy_sim.calibration.moving_scene import limit_size, limit_sizes
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.metrics import psnr_gain_matched
from periscopy_sim.hidden import Hidden
from periscopy_sim.judgement import check_error, remedies_of
from periscopy_sim.measurement import add_noise, composite, noise_to_signal
from periscopy_sim.numerics import Array, machine
from periscopy_sim.photograph import Photograph, blackened
from periscopy_sim.reconstruction.method import Note, Report, Solution, StillMethod
from periscopy_sim.reconstruction.registry import METHODS
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.pictures import area_average, averaged_photograph
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
    """A newer choice came."""


Check = Callable[..., None]
"""Raises `Overtaken` if a newer choice came, whatever its arguments."""


@dataclass(frozen=True, eq=False)
class LivePictures:
    """A laboratory's photograph and its reconstruction, (R, C, 3), of several surfaces by id.

    `scenario` has the values of the choice, which the method believes. `truth` is None where the
    hidden image is unknown; `report` is the method's, of a given photograph with its residual.
    """

    choice: Choice
    scenario: Scenario
    is_coarse: bool
    truth: Any
    photograph: Photograph
    image: Any
    report: Report
    seconds: float = 0.0
    frame: int | None = None  # the number of a frame of a stream

    @cached_property
    def psnr(self) -> float | None:
        """Gain-matched, the mean over the surfaces, in dB; None where the image is unknown."""
        if self.truth is None:
            return None
        images, truths = map(self.scenario.hidden.images, (self.image, self.truth))
        return float(np.mean([psnr_gain_matched(images[name], truths[name]) for name in truths]))


@dataclass(frozen=True, eq=False)
class FittedChoice:
    """A choice with the method that is fitted for it, and for photographs like `photograph`."""

    choice: Choice
    scenario: Scenario
    is_coarse: bool
    truth: Any  # the hidden image; None where it is unknown
    method: StillMethod[Any]
    photograph: Photograph  # of the scenario's size
    notes: Sequence[Note]  # on A, and on the errors that the scene states
    begun: float  # by `time.perf_counter`

    def pictures(self) -> LivePictures:
        """Return the pictures of the photograph, with all that the method reports."""
        hidden, photograph = self.scenario.hidden, self.photograph
        solution = self.method.solve(photograph)
        found = hidden.images(solution.image).items()
        image = hidden.unwrapped({name: f.astype(np.float32) for name, f in found})
        report = self.method.report(photograph, solution)
        residual = None if self.choice.image else report.residual
        report = replace(report, warnings=[*report.warnings, *self.notes], residual=residual)
        return self._pictures(photograph, image, report, time.perf_counter() - self.begun)

    @cached_property
    def _follow(self) -> Callable[[Array], Solution[Any]] | None:
        """What recovers the next frame quickly; None for a method that knows no videos."""
        entry = METHODS.get(self.choice.method)
        if entry is None or entry.video is None:
            return None
        return entry.frames_by(self.method, "none").solve_next

    def see(self, frame: Photograph, noise: float, number: int) -> LivePictures:
        """Return the pictures of a frame, of this size or a larger one, by the noise left in it.

        A method for videos gives no verdict.
        """
        begun, values = time.perf_counter(), self._values(frame)
        if self._follow is None:
            solution = self.method.solve(values)
            residual = self.method.residual(values, solution)
        else:
            solution = self._follow(values)
            residual = self.method.quick_residual(values, solution, noise)
        report = Report(solution.numbers(), residual=residual)
        light, seconds = Photograph(values, self.photograph.mask), time.perf_counter() - begun
        return self._pictures(light, solution.image, report, seconds, number)

    def judge(self, frame: Photograph) -> Report | None:
        """Return the report on a single photograph, on one core; None where `see` says as much."""
        if self._follow is None or not self.method.judges_scene:
            return None
        values = self._values(frame)
        with machine.one_thread():
            report = StillMethod.report(self.method, values, self.method.solve(values))
        remedies = remedies_of(self.scenario, report, self.method, frame)
        return replace(report, remedies=remedies)

    def _values(self, frame: Photograph) -> Array:
        """Return a frame's light at this size, black where it is not used."""
        frame = averaged_photograph(frame, self.scenario.photograph_shape)
        return blackened(frame.values, self.photograph.mask)

    def _pictures(self, light: Photograph, image: Any, report: Report, *of: Any) -> LivePictures:
        of_all = self.choice, self.scenario, self.is_coarse, self.truth
        return LivePictures(*of_all, light, image, report, *of)


class SizedLaboratory:
    """A laboratory whose photograph and hidden image have the sizes of a scenario.

    `photograph` is the given one, of this size or a larger one, or returns the latest of those to
    come; None for synthetic ones. `light` is the ambient light of the choice's place, (rows,
    columns, 3), `seed` of A's rays. At its full size the laboratory fits a method as `reconstruct`
    does; the scenario's memo keeps what no choice changed.
    """

    def __init__(
        self,
        scenario: Scenario,
        photograph: Photograph | Callable[[], Photograph] | None = None,
        light: Array | None = None,
        *,
        is_coarse: bool,
        seed: int = 0,
    ) -> None:
        self.scenario, self.is_coarse = replace(scenario, seed=seed), is_coarse
        self._light = None if light is None else area_average(light, scenario.photograph_shape)
        self._photograph = photograph
        self._moved: tuple[dict[str, str], Scenario] | None = None

    def fit(self, choice: Choice, check: Check = lambda *_: None) -> FittedChoice:
        """Fit the method of a choice; a PeriscopyError says what of it does not exist."""
        begun = time.perf_counter()
        moved = {name: f"{value:.9g}" for name, value in choice.values.items()}
        if self._moved is None or self._moved[0] != moved:  # the page draws a new scene's bodies
            self._moved = moved, self.scenario.at(**moved)
        scenario = self._moved[1]
        truth = scenario.image(choice.image) if choice.image else None
        given, known = self._photograph, None
        check()
        if given is None:
            known = noise_to_signal(choice.snr, choice.sbr if choice.place else np.inf)
        else:
            whole = given() if callable(given) else given
            photograph = averaged_photograph(whole, scenario.photograph_shape)
            known = None if callable(given) else scenario.noise(photograph)
        # Averages to come have less noise than the present one.
        noise = noise_to_signal(Choice.snr, np.inf) if known is None else known
        fineness = np.inf if self.is_coarse else noise  # the quickest A
        if given is None:
            photograph = self._expose(choice, truth, scenario, fineness)
        scenario.transport(fineness, choice.method, progress=check)
        # The effect of a scene's errors takes as long as all else, too long for a hand that moves.
        errors: dict[str, float] | None = {} if self.is_coarse else None
        check()
        method = scenario.method(choice.method, photograph, noise=fineness, errors=errors)
        check()
        notes = scenario.uncertainty(choice.method, errors)[1]
        notes += check_error(scenario, method.plan.origin, noise)
        of = choice, scenario, self.is_coarse, truth
        return FittedChoice(*of, method, photograph, notes, begun)

    def _expose(self, choice: Choice, truth: Any, scenario: Scenario, noise: Any) -> Photograph:
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
    view = View.of(scene, shape, camera=scenario.view.camera)
    return Scenario(view, Hidden.of_scene(scene, sizes), memo=scenario.memo)
