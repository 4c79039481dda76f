"""How errors of a scene's parameters change its light transport: A on either side of the scene.

A comes by areas, without noise (`area_transport`), or by rays where the scene has no closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.area_transport import area_transport, has_areas
from periscopy_sim.calibration.prior import check_error, start_values
from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.errors import ClosedFormError, PeriscopyError, SceneError
from periscopy_sim.model.uncertain_transport import UncertainTransport
from periscopy_sim.numerics.memory import available_memory, has_memory
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from periscopy_sim.rendering.variant import require_vectorized
from periscopy_sim.scenario import Array, Scenario

Matrix = NDArray[np.float32]

STEPS = 1.0, 0.5, 0.25
"""Fractions of a standard error by which a scene moves: the first that both sides allow."""


def uncertain_transport(
    scenario: Scenario,
    errors: Mapping[str, float],
    *,
    samples: int = 16,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> UncertainTransport:
    """Render how errors of a scene's parameters change A, for `NoiseAware`.

    Parameters
    ----------
    scenario
        The scene at its measured values.
    errors
        Standard errors of ``<default>``s, independent of each other, by name.
    samples, seed
        Of A by rays, see `render_transport`; both sides use the same rays.
    progress
        Called with the fraction done.

    Returns
    -------
    UncertainTransport
        For ``NoiseAware.for_scene(scenario, A, B, uncertain=...)``.

    Raises
    ------
    SceneError
        If a parameter is unknown, no number or without effect, an error not positive, or the scene
        not physical on either side.
    PeriscopyError
        If memory is too small: a matrix of the size of A for each error.
    VariantError
        In scalar variants, of a scene without a closed form.
    """
    names = tuple(errors)
    values = start_values(scenario.path, names, scenario.parameters)
    for name, error in errors.items():
        check_error(name, error)
    directions = np.diag(list(errors.values()))
    changes = _Sides(scenario, names, values, samples, seed).changes(directions, progress)
    for name, change in zip(errors, changes, strict=True):
        if not change.any():
            raise SceneError(
                f"the photograph does not show an error of {errors[name]:g} of '{name}'; leave it "
                "out"
            )
    return UncertainTransport(names, values, directions, changes)


def calibrated_transport(
    scenario: Scenario,
    known: SceneCovariance,
    *,
    samples: int = 16,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> UncertainTransport | None:
    """Render how the errors of a calibration change A; None if they do not.

    The other parameters and the errors are those of `uncertain_transport`.
    """
    sides = _Sides(scenario, known.names, known.values, samples, seed)
    changes = sides.changes(known.directions, progress)
    shown = changes.any(axis=(1, 2))
    if not shown.any():
        return None
    return UncertainTransport(known.names, known.values, known.directions[:, shown], changes[shown])


@dataclass(frozen=True, eq=False)
class _Sides:
    """A scene, moved to either side of some values of its parameters."""

    scenario: Scenario
    names: tuple[str, ...]
    values: Array
    samples: int
    seed: int

    def changes(self, directions: Array, progress: Callable[[float], None] | None) -> Matrix:
        """Return the changes of A along directions, (P, K), as (K, M, N): half the differences."""
        if not has_areas(self.scenario):
            require_vectorized("an uncertain scene by rays")
        shape = directions.shape[1], *self.scenario.transport_shape
        size = 4.0 * np.prod(shape)
        if not has_memory(size):
            raise PeriscopyError(
                f"{shape[0]} matrices of {shape[1]} pixels x {shape[2]} patches, one an error, "
                f"need {size / 1e9:.1f} GB of memory, of {(available_memory() or 0) / 1e9:.1f} GB: "
                "give fewer errors, or a smaller photograph"
            )
        changes = np.empty(shape, np.float32)
        transport = area_transport if has_areas(self.scenario) else self._by_rays
        for k, direction in enumerate(directions.T):
            changes[k] = self._change(direction, transport)
            if progress is not None:
                progress((k + 1) / len(changes))
        return changes

    def _change(self, direction: Array, transport: Callable[[Scenario], Matrix]) -> Matrix:
        for fraction in STEPS:
            step = fraction * direction
            try:
                ahead, behind = (transport(self._at(self.values + side)) for side in (step, -step))
            except (SceneError, ClosedFormError) as error:
                unphysical = error
            else:
                return np.asarray((ahead - behind) / np.float32(2 * fraction))
        name = self.names[int(np.argmax(np.abs(direction)))]
        raise SceneError(f"an error of '{name}' is too large: give a smaller one ({unphysical})")

    @cached_property
    def _movable(self) -> Scenario:
        """The scene, whose photograph keeps its size."""
        scenario = self.scenario
        return load_scenario(
            scenario.path,
            scenario.hidden_shape,
            scenario.parameters,
            photograph=scenario.photograph_shape,
        )

    def _at(self, values: Array) -> Scenario:
        named = zip(self.names, values, strict=True)
        return self._movable.at(**{name: f"{value:.9g}" for name, value in named})

    def _by_rays(self, scenario: Scenario) -> Matrix:
        # None of A's own rays, whose noise the image follows.
        return render_transport(scenario, samples=self.samples, seed=self.seed + 1)
