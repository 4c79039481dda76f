"""A scene whose parameters move: its transport matrix by areas, and that matrix's derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.area_transport import area_derivatives, area_transport
from periscopy_sim.analytic.point_light import point_light_backgrounds
from periscopy_sim.errors import ClosedFormError, SceneError
from periscopy_sim.scenario import Array, Scenario

Matrix = NDArray[np.float32]

STEP = 0.02
"""Fraction of a parameter's standard error by which the scene moves for a derivative: far enough
for single precision, and so short that vertices move in proportion."""


@dataclass(frozen=True, eq=False)
class MovingScene:
    """A scene, P of whose parameters vary, seen by M of its camera's pixels.

    Attributes
    ----------
    scenario
        The scene as it was loaded, with `finer` times the rows and columns of the photograph.
    names, errors
        (P) parameters that vary, and their scales: a derivative moves each by a fraction of it.
    pixels
        (rows, columns) which pixels of the photograph are used.
    finer
        Wall points along each side of a pixel, over which A is averaged.
    """

    scenario: Scenario
    names: tuple[str, ...]
    errors: Array
    pixels: NDArray[np.bool_]
    finer: int

    def at(self, values: Array) -> Scenario:
        """Return the scene at some values, (P,), with the wall points of the pixels used alone.

        A SceneError says that the values make no scene.
        """
        moved = self.scenario.at(**dict(zip(self.names, values.tolist(), strict=True)))
        return replace(
            moved,
            wall_points=self._of_pixels(moved.wall_points),
            wall_normals=self._of_pixels(moved.wall_normals),
            photograph_shape=(self.finer * int(self.pixels.sum()), self.finer),
        )

    def _of_pixels(self, values: Array) -> Array:
        """Return the wall points' values in the pixels used, (M finer², 3), pixel after pixel."""
        (rows, columns), n = self.pixels.shape, self.finer
        blocks = values.reshape(rows, n, columns, n, 3).transpose(0, 2, 1, 3, 4)
        return np.ascontiguousarray(blocks[self.pixels]).reshape(-1, 3)

    def is_physical(self, values: Array) -> bool:
        """Return whether some values make a scene."""
        try:
            self.at(values)
        except SceneError:
            return False
        return True

    def transport(self, values: Array) -> Matrix:
        """Return A, (M, N); a SceneError says that the values make no scene with a closed form."""
        try:
            return area_transport(self.at(values), self.finer)
        except ClosedFormError as error:
            raise SceneError(str(error)) from None

    def linearized(self, values: Array) -> tuple[Matrix, Matrix]:
        """Return A, (M, N), and its derivatives by the parameters, (P, M, N)."""
        scenario = self.at(values)
        sides = [(scenario, *self._beside(values, k)) for k in range(len(values))]
        try:
            A = area_transport(scenario, self.finer)
            return A, area_derivatives(scenario, sides, self.finer, A)
        except ClosedFormError as error:
            raise SceneError(str(error)) from None

    def _beside(self, values: Array, k: int) -> tuple[Scenario, float]:
        """Return the scene with a parameter moved a little to either side, and how far."""
        for step in (STEP * self.errors[k], -STEP * self.errors[k]):
            moved = values.copy()
            moved[k] += step
            try:
                return self.at(moved), step
            except SceneError as error:
                unphysical = error
        raise unphysical

    def point_lights(self, values: Array) -> Array:
        """Return B of the point lights, (M, L), whose grid all of the photograph places."""
        moved = self.scenario.at(**dict(zip(self.names, values.tolist(), strict=True)))
        (rows, columns), n = self.pixels.shape, self.finer
        B = np.asarray(point_light_backgrounds(moved), np.float64)
        return np.asarray(B.reshape(rows, n, columns, n, -1).mean(axis=(1, 3))[self.pixels])


def fitted(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Return (rows, columns) shrunk in proportion, the longer to at most `longest`."""
    factor = min(1.0, longest / max(size))
    rows, columns = (max(1, round(factor * n)) for n in size)
    return rows, columns
