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
from periscopy_sim.calibration.explanation.resolution_level import COVERED, MOST_PATCHES, fitted
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.methods import fit_method, image_by, own_errors
from periscopy_sim.evaluation.metrics import psnr
from periscopy_sim.live.choice import Choice
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.photographs.checking import blackened
from periscopy_sim.reconstruction.method import StillMethod
from periscopy_sim.reconstruction.residual.residual import Residual
from periscopy_sim.rendering.scene.load import load_scenario
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
    """A laboratory's photograph, and what a method recovers from it.

    Attributes
    ----------
    choice
        The wish.
    scenario
        The scene at its values, which the method believes.
    is_coarse
        Whether this is the coarse size.
    truth
        (R, C, 3) the hidden image; None where it is unknown.
    photograph
        (rows, columns, 3), synthetic or given.
    used
        (rows, columns) where the mask keeps the wall; None for everywhere.
    is_dark
        Whether the ambient light has not come yet.
    image
        (R, C, 3) the reconstruction.
    psnr
        In dB, gain-matched; None without a truth.
    standard_errors
        (R, C, 3) of the reconstruction; None where the method reports none.
    residual
        What scene and image leave unexplained of a given photograph; None of a synthetic one.
    remark, doubt
        What the method reports and warns of.
    seconds
        How long the computation took.
    """

    choice: Choice
    scenario: Scenario
    is_coarse: bool
    truth: Array | None
    photograph: Array
    used: Mask | None
    is_dark: bool
    image: NDArray[np.float32]
    psnr: float | None
    standard_errors: Array | None = None
    residual: Residual | None = None
    remark: str = ""
    doubt: str = ""
    seconds: float = 0.0


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
        self._kept: dict[str, tuple[object, Any]] = {}

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
        scenario, A = self._transport(choice.values)
        unless_overtaken()
        truth = self._truth(choice.image) if choice.image else None
        shot, is_dark = self._shot, False
        if shot is None:
            shot, is_dark = self._expose(choice, truth)
            unless_overtaken()
        used = shot.used
        B = self._keep(
            "B", scenario.wall_points.tobytes(), lambda: point_light_backgrounds(scenario)
        )
        method = self._keep(
            "method", (choice.method, tuple(choice.values.values())),
            lambda: fit_method(choice.method, scenario, A, B, used),
        )  # fmt: skip
        unless_overtaken()
        more: dict[str, Any] = {}
        with own_errors(choice.method, "failed"):
            if isinstance(method, StillMethod):
                solution = method.solve(shot.values)
                image = np.asarray(solution.image, np.float32)
                unless_overtaken()
                errors = method.standard_errors(solution)
                more = {
                    "standard_errors": None if errors is None else errors.reshape(image.shape),
                    "remark": str(method.remark(solution)),
                    "doubt": str(method.doubt(solution)),
                    "residual": self._shot and method.residual(shot.values, solution),
                }
            else:
                image = image_by(method, shot.values, self.hidden_shape)
        unless_overtaken()
        return LivePictures(
            choice, scenario, self.is_coarse, truth, shot.values, used, is_dark, image,
            None if truth is None else psnr(image, truth),
            **more, seconds=time.perf_counter() - begun,
        )  # fmt: skip

    def _keep(self, name: str, key: object, make: Callable[[], Any]) -> Any:
        """Return what `make` makes; that of before while its key is the same."""
        if name not in self._kept or self._kept[name][0] != key:
            self._kept.pop(name, None)  # before another takes as much memory
            self._kept[name] = key, make()
        return self._kept[name][1]

    def _transport(self, values: Values, name: str = "transport") -> tuple[Scenario, Any]:
        """Return the scene at some values, and its A."""

        def make() -> tuple[Scenario, Any]:
            given = {key: f"{value:.9g}" for key, value in values.items()}
            scenario = self.scenario(self._given | given)
            if has_areas(scenario):
                A = area_transport(scenario)
            else:
                with RENDERING:
                    A = render_transport(scenario, samples=RAYS[self.is_coarse], seed=SEED)
            require_light(A, scenario)
            return scenario, A

        scenario, A = self._keep(name, tuple(values.values()), make)
        return scenario, A

    def _truth(self, name: str) -> Array:
        """Return a hidden image, (R, C, 3)."""
        image: Array = self._keep(
            "truth", name, lambda: read_hidden_image(find_image(name), self.hidden_shape)
        )
        return image

    def _expose(self, choice: Choice, truth: Array | None) -> tuple[Shot, bool]:
        """Return a photograph, y = A f + b + noise, and whether its b is still missing."""
        if truth is None:
            raise PeriscopyError("the monitor is off: choose a hidden image, or give a photograph")
        if choice.taken is None:
            scenario, A = self._transport(choice.values)
        else:
            scenario, A = self._transport(choice.taken, "taken")
        signal = scenario.channel_gain * (A @ truth.reshape(-1, 3))
        y = signal.reshape(*self.photograph_shape, 3)
        if y.mean() <= 0:
            raise PeriscopyError("no light reaches the wall: the hidden image is black")
        y /= y.mean()
        ambient = self._light(choice.place) if choice.place else None
        if ambient is not None:
            y = composite(y, area_average(ambient, self.photograph_shape), choice.sbr)
        return Shot(add_noise(y, choice.snr, SEED)), bool(choice.place) and ambient is None


def coarse_sizes(
    photograph: tuple[int, int], hidden: tuple[int, int], used: float = 1.0
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the coarse sizes of a photograph, of which a part is used, and of a hidden image."""
    pixels, patches = COARSE
    shape, size = fitted(photograph, pixels), fitted(hidden, patches)
    fewer = min(1.0, float(np.sqrt(MOST_PATCHES * used * np.prod(shape) / np.prod(size))))
    return shape, fitted(size, max(1, int(fewer * max(size))))
