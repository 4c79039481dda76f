"""The transport matrices of a scene at any values of its free parameters, by areas or by rays.

The hidden image is a sum of bilinear hat functions, one for each patch. An image of square patches
cannot follow a shift by half a patch, so that the evidence has a minimum at each whole one; hats
can. A hat's column of the matrix is a sum of columns of patches half as large.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from periscopy_sim.analytic.area_transport import area_derivatives, area_transport, has_areas
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.calibration.prior import InFront
from periscopy_sim.errors import ClosedFormError, SceneError
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.penumbrae import render_penumbrae
from periscopy_sim.rendering.transport.shadow_rays import require_light
from periscopy_sim.scenario import Array, Scenario

Values = NDArray[np.float64]
Matrix = NDArray[np.floating[Any]]

FINER = 2
"""Wall points along each side of a pixel, and patches along each side of a hat's spacing."""

STEP = 0.02
"""Fraction of a parameter's step by which points move for derivatives by areas: far enough for
single precision, and so short that they move in proportion."""

SAMPLES = 9
"""Rays between a wall point and a small patch, where a scene loses its closed form on the way."""

MOST_ENTRIES = 80_000_000
"""Of derivatives computed together: 320 MB."""

RAY_SETS = 2
"""Sets of rays for derivatives: their noise, squared, would pass for information."""


@dataclass(frozen=True, eq=False)
class SceneMatrices:
    """A scene file, some of whose parameters vary, at one resolution.

    Attributes
    ----------
    path, fixed
        The scene file, and the parameters that stay.
    names
        Those that vary.
    steps
        (P,) how far each is moved for derivatives by rays, and more than enough for those by areas.
    photograph_shape, hidden_shape
        (rows, columns) of the photograph and (R, C) of hats.
    in_front
        What checks a scenario.
    samples
        Rays between a wall point and a small patch; None where the scene has a closed form.
    seed
        Of the rays.
    hats
        Whether the hidden image consists of hats; else of square patches.
    """

    path: Path
    fixed: Mapping[str, str]
    names: tuple[str, ...]
    steps: Values
    photograph_shape: tuple[int, int]
    hidden_shape: tuple[int, int]
    in_front: InFront | None = None
    samples: int | None = None
    seed: int = 0
    hats: bool = True

    def scenario(self, values: Values) -> Scenario:
        """Load the scene at some values, (P,), with `FINER` times the rows and columns of pixels.

        A SceneError says that the values are not physical.
        """
        given = {name: f"{value:.17g}" for name, value in zip(self.names, values, strict=True)}
        rows, columns = self.photograph_shape
        patches = FINER if self.hats else 1
        hidden = (patches * self.hidden_shape[0], patches * self.hidden_shape[1])
        finer = (FINER * rows, FINER * columns)
        scenario = load_scenario(self.path, hidden, {**self.fixed, **given}, photograph=finer)
        if scenario.wall_texture is not None:  # it moves in the photograph as the camera does
            raise SceneError(
                f"scene '{self.path}': the wall is textured, which calibrate does not support; "
                "mask what is drawn there, and give the wall one reflectance"
            )
        if self.in_front is not None:
            self.in_front.check(scenario)
        return scenario

    def is_physical(self, values: Values) -> bool:
        """Return whether the scene loads at some values."""
        try:
            self.scenario(values)
        except SceneError:
            return False
        return True

    def has_areas(self, values: Values) -> bool:
        """Return whether the scene has a closed form at some values."""
        return has_areas(self.scenario(values), FINER)

    def matrix(self, values: Values, seed: int | None = None) -> NDArray[np.float32]:
        """Return the transport matrix, (M, N); a SceneError says that the values are unphysical."""
        scenario = self.scenario(values)
        if self.samples is None:
            with suppress(ClosedFormError):  # an occluder that went behind the monitor, say
                A = area_transport(scenario, FINER)
                require_light(A, scenario)
                return self._summed(A)
        seed = self.seed if seed is None else seed
        A = render_penumbrae(scenario, samples=self.samples or SAMPLES, pixel_samples=1, seed=seed)
        return self._summed(self._averaged(A).astype(np.float32))

    def linearized(self, values: Values) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the matrix, (M, N), and its derivatives by each parameter, (S, P, M, N).

        S is the number of sets of rays, 1 by areas. A SceneError says that a parameter can be moved
        to neither side.
        """
        if self.samples is None:
            with suppress(ClosedFormError):
                return self._by_area(values)
        sets = range(self.seed, self.seed + RAY_SETS)
        return self.matrix(values), np.array(
            [[self._by_rays(values, k, seed) for k in range(len(values))] for seed in sets]
        )

    def _by_area(self, values: Values) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        here = self.scenario(values)
        A = area_transport(here, FINER)
        require_light(A, here)
        sides = [(here, *self._beside(values, k)) for k in range(len(values))]
        whole = self._summed(A)
        changes = np.empty((1, len(sides), *whole.shape), np.float32)
        together = max(1, MOST_ENTRIES // A.size)
        for first in range(0, len(sides), together):
            some = slice(first, first + together)
            changes[0, some] = [
                self._summed(dA) for dA in area_derivatives(here, sides[some], FINER, A)
            ]
        return whole, changes

    def _beside(self, values: Values, k: int) -> tuple[Scenario, float]:
        """Return the scene with a parameter moved a little, and how far."""
        for step in (STEP * self.steps[k], -STEP * self.steps[k]):
            try:
                return self.scenario(_moved(values, k, step)), step
            except SceneError as error:
                unphysical = error
        raise unphysical

    def _by_rays(self, values: Values, k: int, seed: int) -> NDArray[np.float32]:
        sides: list[tuple[float, NDArray[np.float32]]] = []
        for step in (self.steps[k], -self.steps[k]):
            try:
                sides.append((step, self.matrix(_moved(values, k, step), seed)))
            except SceneError as error:
                unphysical = error
        if not sides:
            raise unphysical
        if len(sides) == 1:
            sides.append((0.0, self.matrix(values, seed)))
        (ahead, A), (behind, B) = sides
        return np.asarray((A - B) / np.float32(ahead - behind))

    def point_lights(self, values: Values) -> Array:
        """Return the point lights' B, (M, L), of all pixels."""
        return np.asarray(self._averaged(point_light_backgrounds(self.scenario(values))), float)

    def _averaged(self, rows: Matrix) -> Matrix:
        """Return means, (M, K), over each pixel of what its wall points have."""
        height, width = self.photograph_shape
        laid = rows.reshape(height, FINER, width, FINER, -1)
        return np.asarray(laid.mean(axis=(1, 3)).reshape(height * width, -1))

    def _summed(self, A: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the columns of hats, (M, N), from those of small patches."""
        return np.ascontiguousarray((self._hats @ A.T).T) if self.hats else A

    @cached_property
    def _hats(self) -> Any:
        """(N, FINER² N) the height of each hat at each small patch."""
        down, across = (_hats_along(size) for size in self.hidden_shape)
        return sparse.kron(down, across, format="csr")


def _hats_along(size: int) -> Any:
    """Return the heights, (size, FINER size), of a row of hats; half an outer one is cut off."""
    places = (np.arange(FINER * size) + 0.5) / FINER - 0.5
    heights = np.maximum(1 - np.abs(places - np.arange(size)[:, None]), 0)
    return sparse.csr_array(heights.astype(np.float32))


def _moved(values: Values, k: int, step: float) -> Values:
    moved = values.copy()
    moved[k] += step
    return moved
