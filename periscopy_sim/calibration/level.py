"""The photograph at one resolution, and how well a scene's parameters explain it there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import SceneError
from periscopy_sim.reconstruction.preconditioner import background_basis
from periscopy_sim.reconstruction.variable_projection import Explanation, explain
from periscopy_sim.scenario import Array, Scenario

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Sampling:
    """How finely a level looks.

    Attributes
    ----------
    photograph, hidden
        (rows, columns) at most; see `fitted`.
    samples, pixel_samples
        Of the transport matrix, see `render_transport`.
    """

    photograph: int
    hidden: int
    samples: int
    pixel_samples: int


class Level:
    """A photograph at one resolution, explained by a scene of some parameters.

    Attributes
    ----------
    photograph_shape, hidden_shape
        Of this resolution.
    used
        (rows, columns) pixels that are used.
    scale
        (3,) root mean square of the photograph there.

    Parameters
    ----------
    path
        The scene file.
    fixed
        Values of parameters that stay.
    names
        Parameters that vary.
    photograph
        (rows, columns, 3) at full resolution.
    mask
        (rows, columns) pixels to use; None for all.
    hidden
        (R, C) that was asked for.
    sampling
        How finely to look.
    seed
        Of the rays: the same for all parameters, so that noise does not hide differences.
    check
        Raises SceneError for a scenario that is not physical.
    """

    def __init__(
        self,
        path: Path,
        fixed: Mapping[str, str],
        names: tuple[str, ...],
        photograph: Array,
        mask: NDArray[np.bool_] | None,
        hidden: tuple[int, int],
        sampling: Sampling,
        seed: int,
        check: Callable[[Scenario], None],
    ) -> None:
        from periscopy_sim.storage.pictures import area_average

        self.path, self.names, self.sampling, self.seed = path, names, sampling, seed
        self._fixed, self._check = dict(fixed), check
        rows, columns = photograph.shape[:2]
        self.photograph_shape = fitted((rows, columns), sampling.photograph)
        self.hidden_shape = fitted(hidden, sampling.hidden)
        self.used = np.ones(self.photograph_shape, bool)
        if mask is not None:
            photograph = np.where(mask[..., None], photograph, 0)
            left_out = area_average(~mask[..., None], self.photograph_shape)[..., 0]
            self.used = left_out < 1e-9  # a pixel that is partly left out is left out
        self._y = area_average(photograph, self.photograph_shape)[self.used]
        self.scale = np.sqrt(np.mean(self._y**2, axis=0))
        self._background: Array | None = None

    def scenario(self, values: Values) -> Scenario:
        """Load the scene at some values; see `load_scenario`.

        Raises
        ------
        SceneError
            If they are not physical.
        """
        from periscopy_sim.rendering.scene_file import load_scenario

        given = {name: f"{value:.17g}" for name, value in zip(self.names, values, strict=True)}
        scenario = load_scenario(
            self.path, self.hidden_shape, self._fixed | given, photograph=self.photograph_shape
        )
        self._check(scenario)
        return scenario

    def matrix(self, values: Values, seed: int | None = None) -> Array:
        """Render the transport matrix at some values, (used pixels, N); with the level's own seed.

        Raises
        ------
        SceneError
            If they are not physical, or no light reaches the wall.
        """
        from periscopy_sim.rendering.transport import render_transport

        A = render_transport(
            self.scenario(values),
            samples=self.sampling.samples,
            pixel_samples=self.sampling.pixel_samples,
            seed=self.seed if seed is None else seed,
        )
        return A[self.used.ravel()].astype(np.float64)

    def background(self, values: Values) -> Array:
        """Span the ambient light: an orthonormal basis of range(B).

        That of the first values is taken for all: the camera's small moves hardly change it.
        """
        from periscopy_sim.analytic.point_light import point_light_backgrounds

        if self._background is None:
            B = point_light_backgrounds(self.scenario(values))[self.used.ravel()]
            self._background = background_basis(B)
        return self._background

    def explain(self, values: Values) -> Explanation:
        """Explain the photograph by the scene at some values.

        Raises
        ------
        SceneError
            As `matrix`.
        """
        A = self.matrix(values)
        return explain(A, self.background(values), self._y, self.hidden_shape)

    def picture(self, residuals: Array) -> Array:
        """Lay out what is left of the used pixels, over the scale: (rows, columns, 3)."""
        laid = np.zeros((*self.photograph_shape, 3))
        laid[self.used] = residuals / self.scale
        return laid

    def evidence(self, values: Values) -> float:
        """Give the evidence at some values; infinite where they are not physical."""
        try:
            return self.explain(values).evidence
        except SceneError:
            return np.inf


def fitted(size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Shrink (rows, columns) until the longer is at most `longest`, in proportion."""
    factor = min(1.0, longest / max(size))
    rows, columns = (max(1, round(factor * n)) for n in size)
    return rows, columns
