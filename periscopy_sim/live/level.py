"""A laboratory at one size: from what is set to its pictures."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.area_transport import area_transport, has_areas
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.level import COVERED, MOST_PATCHES, fitted
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.methods import fit_method, image_by, own_errors
from periscopy_sim.evaluation.metrics import psnr
from periscopy_sim.live.choice import Choice
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.photographs.checking import blackened
from periscopy_sim.reconstruction.method import StillMethod
from periscopy_sim.reconstruction.residual.residual import Residual
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.survey import Survey
from periscopy_sim.rendering.transport.shadow_rays import render_transport, require_light
from periscopy_sim.scenario import Array, Scenario
from periscopy_sim.shipped import find_image
from periscopy_sim.storage.pictures import area_average, read_hidden_image

COARSE = 32, 12
"""Pixels along a photograph's longer side, patches along a hidden image's: some 100 ms on one core
from a scene that has moved to its pictures."""

RAYS = {True: 4, False: 16}
"""Of a patch for each wall point, where a scene has no closed form; fewer at the coarse size."""

SEED = 0
"""Of all noise: the same while a scene moves, so that pictures do not flicker."""

RENDERING = Lock()
"""Held while Mitsuba is used: one thread at a time."""

Mask = NDArray[np.bool_]
Values = Mapping[str, float]
Light = Callable[[str], Array | None]
"""The light of a place, (rows, columns, 3) of the full size; None while it is not known yet."""


class Overtaken(Exception):  # noqa: N818  nothing is wrong
    """Something else is wanted by now."""


@dataclass(frozen=True, eq=False)
class Shot:
    """A photograph that was given, (rows, columns, 3), and where of it the wall is used."""

    values: Array
    used: Mask | None = None

    def averaged(self, shape: tuple[int, int]) -> Shot:
        """Return it with fewer pixels; those of which little is used are left out."""
        if shape == self.values.shape[:2]:
            return self
        used = np.ones(self.values.shape[:2], bool) if self.used is None else self.used
        coverage = area_average(used[..., None], shape)
        light = area_average(blackened(self.values, used), shape)
        kept = coverage > COVERED
        means = np.where(kept, light / np.where(kept, coverage, 1), 0)
        return Shot(means, None if kept.all() else kept[..., 0])


@dataclass(frozen=True, eq=False)
class LivePictures:
    """What a laboratory shows: its photograph, and what a method makes of that.

    Attributes
    ----------
    choice
        What was set.
    scenario
        The scene at these values, which the method believes.
    rays
        (4, 2, 3) the camera's rays through the picture's corners, clockwise from the top left:
        where they come from, and where they meet the wall.
    is_coarse
        Whether this is the coarse size.
    truth
        (R, C, 3) the hidden image; None where nobody knows it.
    photograph
        (rows, columns, 3), synthetic or given.
    used
        (rows, columns) where the wall is used; None for everywhere.
    image
        (R, C, 3) the reconstruction.
    standard_errors
        (R, C, 3) how far its patches may be off; None where the method does not tell.
    residual
        What scene and image leave of a given photograph; None of a synthetic one.
    psnr
        In dB, gain-matched; None without a truth.
    is_dark
        Whether ambient light that was asked for is still missing.
    remark, doubt
        What the method says of its result.
    seconds
        How long all this took.
    """

    choice: Choice
    scenario: Scenario
    rays: Array
    is_coarse: bool
    truth: Array | None
    photograph: Array
    used: Mask | None
    image: NDArray[np.float32]
    standard_errors: Array | None
    residual: Residual | None
    psnr: float | None
    is_dark: bool
    remark: str
    doubt: str
    seconds: float


@dataclass(frozen=True, eq=False)
class _Transport:
    """A scene and its light transport."""

    scenario: Scenario
    rays: Array
    A: NDArray[np.float32]


class Level:
    """A laboratory whose photograph and hidden image have certain sizes.

    What was computed last is kept: of what is set, only what has changed is computed anew. For one
    thread at a time.

    Parameters
    ----------
    path, given
        The scene, and values of those ``<default>``s that stay.
    photograph, hidden
        (rows, columns) of the photograph and of the hidden image.
    light
        The light of ambient places.
    shot
        A photograph that was given, of any size; None for synthetic ones.
    is_coarse
        Whether these are the coarse sizes.
    """

    def __init__(
        self,
        path: Path,
        given: Mapping[str, str],
        photograph: tuple[int, int],
        hidden: tuple[int, int],
        light: Light,
        shot: Shot | None = None,
        *,
        is_coarse: bool,
    ) -> None:
        self._path, self._given = path, dict(given)
        self.photograph_shape, self.hidden_shape = photograph, hidden
        self._light, self.is_coarse = light, is_coarse
        self._shot = None if shot is None else shot.averaged(photograph)
        self._transports: dict[tuple[float, ...], _Transport] = {}
        self._images: dict[str, Array] = {}
        self._fitted: tuple[tuple[object, ...], Any] | None = None
        self._rays: tuple[Array, Array] | None = None
        self._backgrounds: tuple[Array, Array] | None = None

    def scenario(self, given: Mapping[str, str]) -> Scenario:
        """Load the scene at values given as text; a SceneError says that there is none."""
        with RENDERING:
            return load_scenario(
                self._path, self.hidden_shape, given, photograph=self.photograph_shape
            )

    def pictures(self, choice: Choice, is_overtaken: Callable[[], bool]) -> LivePictures:
        """Compute the pictures of what is set.

        Raises
        ------
        Overtaken
            As soon as it is known that something else is wanted.
        PeriscopyError
            If there is no such scene, light, image or method.
        """

        def unless_overtaken() -> None:
            if is_overtaken():
                raise Overtaken

        begun = time.perf_counter()
        seen = self._transport(choice.values)
        unless_overtaken()
        truth = self._truth(choice.image) if choice.image else None
        shot, is_dark = self._shot, False
        if shot is None:
            shot, is_dark = self._taken(choice, truth, seen)
            unless_overtaken()
        method = self._method(choice, seen, shot.used)
        unless_overtaken()
        with own_errors(choice.method, "failed"):
            if isinstance(method, StillMethod):
                found = method.solve(shot.values)
                image = np.asarray(found.image, np.float32)
            else:
                found, image = None, image_by(method, shot.values, self.hidden_shape)
        unless_overtaken()
        errors, residual, remark, doubt = None, None, "", ""
        if found is not None:
            errors = method.standard_errors(found)
            remark, doubt = str(method.remark(found)), str(method.doubt(found))
            unless_overtaken()
            residual = None if self._shot is None else method.residual(shot.values, found)
        return LivePictures(
            choice=choice,
            scenario=seen.scenario,
            rays=seen.rays,
            is_coarse=self.is_coarse,
            truth=truth,
            photograph=shot.values,
            used=shot.used,
            image=image,
            standard_errors=None if errors is None else errors.reshape(*self.hidden_shape, 3),
            residual=residual,
            psnr=None if truth is None else psnr(image, truth),
            is_dark=is_dark,
            remark=remark,
            doubt=doubt,
            seconds=time.perf_counter() - begun,
        )

    def _transport(self, values: Values) -> _Transport:
        """Return the scene at some values, and its A; of the last two that were asked for."""
        key = tuple(values.values())
        if key not in self._transports:
            given = self._given | {name: f"{value:.9g}" for name, value in values.items()}
            scenario = self.scenario(given)
            if has_areas(scenario):
                A = area_transport(scenario)
            else:
                with RENDERING:
                    A = render_transport(scenario, samples=RAYS[self.is_coarse], seed=SEED)
            require_light(A, scenario)
            while len(self._transports) > 1:
                del self._transports[next(iter(self._transports))]
            self._transports[key] = _Transport(scenario, self._rays_to(scenario), A)
        found = self._transports.pop(key)
        self._transports[key] = found  # the last to be forgotten
        return found

    def _rays_to(self, scenario: Scenario) -> Array:
        """Return the camera's rays; those of before while it sees the same of the wall."""
        points = scenario.wall_points
        if self._rays is None or not np.array_equal(self._rays[0], points):
            with RENDERING:
                survey = Survey(scenario)
            rays = np.stack([survey.view_origins[:4], survey.view_points[:4]], axis=1)
            self._rays = points, rays
        return self._rays[1]

    def _truth(self, name: str) -> Array:
        """Return a hidden image, (R, C, 3)."""
        if name not in self._images:
            self._images[name] = read_hidden_image(find_image(name), self.hidden_shape)
        return self._images[name]

    def _taken(self, choice: Choice, truth: Array | None, seen: _Transport) -> tuple[Shot, bool]:
        """Take a photograph, y = A f + b + noise; return it, and whether its b is still missing."""
        if truth is None:
            raise PeriscopyError("the monitor is off: choose a hidden image, or give a photograph")
        there = seen if choice.taken is None else self._transport(choice.taken)
        signal = there.scenario.channel_gain * (there.A @ truth.reshape(-1, 3))
        y = signal.reshape(*self.photograph_shape, 3)
        if y.mean() <= 0:
            raise PeriscopyError("no light reaches the wall: the hidden image is black")
        y /= y.mean()
        ambient = self._light(choice.place) if choice.place else None
        if ambient is not None:
            y = composite(y, area_average(ambient, self.photograph_shape), choice.sbr)
        return Shot(add_noise(y, choice.snr, SEED)), bool(choice.place) and ambient is None

    def _method(self, choice: Choice, seen: _Transport, used: Mask | None) -> Any:
        """Return a method, fitted to the scene."""
        key = choice.method, *choice.values.values()
        if self._fitted is None or self._fitted[0] != key:
            self._fitted = None  # before another takes as much memory
            B = self._prototypes(seen.scenario)
            method = fit_method(choice.method, seen.scenario, seen.A, B, used)
            self._fitted = key, method
        return self._fitted[1]

    def _prototypes(self, scenario: Scenario) -> Array:
        """Return B; that of before while the camera sees the same of the wall."""
        points = scenario.wall_points
        if self._backgrounds is None or not np.array_equal(self._backgrounds[0], points):
            self._backgrounds = points, point_light_backgrounds(scenario)
        return self._backgrounds[1]


def coarse_sizes(
    photograph: tuple[int, int], hidden: tuple[int, int], used: float = 1.0
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the coarse sizes of a photograph, of which a part is used, and of a hidden image."""
    pixels, patches = COARSE
    shape, size = fitted(photograph, pixels), fitted(hidden, patches)
    fewer = min(1.0, float(np.sqrt(MOST_PATCHES * used * np.prod(shape) / np.prod(size))))
    return shape, fitted(size, max(1, int(fewer * max(size))))
