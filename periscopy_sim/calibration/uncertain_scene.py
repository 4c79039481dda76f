"""What errors of a scene's parameters do to its light transport: A to either side of where it is.

It is had by areas, without noise, see `area_transport`, or by rays where these do not serve.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.area_transport import area_transport, has_areas
from periscopy_sim.calibration.constraints import InFront
from periscopy_sim.calibration.prior import start_values
from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.errors import ClosedFormError, PeriscopyError, SceneError, VariantError
from periscopy_sim.model.uncertain_transport import UncertainTransport
from periscopy_sim.numerics.memory import available_memory, has_memory
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_penumbrae, render_transport
from periscopy_sim.rendering.variant import install_llvm, is_vectorized, use_variant
from periscopy_sim.scenario import Array, Scenario

STEPS = 1.0, 0.5, 0.25
"""Parts of a standard error by which a scene is moved, the first to both sides of which it can."""


def uncertain_transport(
    scenario: Scenario,
    errors: Mapping[str, float],
    *,
    samples: int = 16,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> UncertainTransport:
    """Render what errors of a scene's parameters do to A, as `NoiseAware` takes it.

    Parameters
    ----------
    scenario
        The scene with its parameters as they are said to be.
    errors
        Standard errors of ``<default>``s, independent of each other, by name.
    samples, seed
        Of A, see `render_transport`: the scene elsewhere is rendered with the same rays.
    progress
        Called with the fraction done.

    Returns
    -------
    UncertainTransport
        For ``NoiseAware.for_scene(scenario, A, B, uncertain=...)``.

    Raises
    ------
    SceneError
        If a parameter is unknown, no number or not seen, an error not positive, or the scene not
        physical at either side.
    PeriscopyError
        If there is not enough memory: a matrix of the size of A for each error, by rays two.
    VariantError
        In scalar variants, which would take hours.
    """
    values = start_values(scenario.path, tuple(errors), scenario.parameters)
    for name, error in errors.items():
        if not (np.isfinite(error) and error > 0):
            raise SceneError(f"standard error {error:g} of '{name}': give a positive number")
    renderer = _Renderer(scenario, tuple(errors), samples, seed)
    directions = np.diag(list(errors.values()))
    changes = renderer.changes(values, directions, progress)
    for name, change in zip(errors, changes, strict=True):
        if not change.any():
            raise SceneError(
                f"the photograph does not show an error of {errors[name]:g} of '{name}'; leave it "
                "out"
            )
    return UncertainTransport(tuple(errors), values, directions, changes)


def calibrated_transport(
    scenario: Scenario,
    known: SceneCovariance,
    *,
    samples: int = 16,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> UncertainTransport | None:
    """Render what the errors that a calibration left do to A; None if nothing.

    Parameters and errors are those of `uncertain_transport`.
    """
    renderer = _Renderer(scenario, known.names, samples, seed)
    directions = known.directions
    changes = renderer.changes(known.values, directions, progress)
    shown = changes.any(axis=(1, 2))
    if not shown.any():
        return None
    return UncertainTransport(known.names, known.values, directions[:, shown], changes[shown])


class _Renderer:
    """The transport matrix of a scene at any values of some of its parameters."""

    def __init__(self, scenario: Scenario, names: tuple[str, ...], samples: int, seed: int) -> None:
        use_variant()
        if not is_vectorized():
            raise VariantError(
                "an uncertain scene is rendered many times over, hours without LLVM or CUDA; "
                + install_llvm()
            )
        self._scenario, self._names = scenario, names
        self._samples, self._seed = samples, seed
        self._check = InFront(scenario).check
        self.by_area = has_areas(scenario)

    def changes(
        self,
        values: Array,
        directions: Array,
        progress: Callable[[float], None] | None,
    ) -> NDArray[np.float32]:
        """Return the changes of A along directions, (P, K), as (K, M, N).

        Each is half of the difference between the two sides, by the same rays if not by areas.
        """
        count = directions.shape[1]
        pixels, patches = self._scenario.transport_shape
        size = 4.0 * count * pixels * patches
        if not has_memory(size):
            raise PeriscopyError(
                f"{count} matrices of {pixels} pixels x {patches} patches, of what errors "
                f"of {len(self._names)} parameters do, need {size / 1e9:.1f} GB of memory, where "
                f"{(available_memory() or 0) / 1e9:.1f} GB can be had; name fewer "
                "uncertain parameters, or average pixels"
            )
        changes = np.empty((count, pixels, patches), np.float32)
        for k, direction in enumerate(directions.T):
            part, sides = self._sides(values, direction)
            changes[k] = self._difference(sides) / (2 * part)
            if progress is not None:
                progress((k + 1) / count)
        return changes

    def _sides(self, values: Array, direction: Array) -> tuple[float, list[Scenario]]:
        """Return by what part of a direction the scene can be moved to both sides, and these."""
        for part in STEPS:
            try:
                return part, [self._at(values + sign * part * direction) for sign in (1, -1)]
            except SceneError as error:
                unphysical = error
        name = self._names[int(np.argmax(np.abs(direction)))]
        raise SceneError(f"an error of '{name}' is too large: give a smaller one ({unphysical})")

    def _at(self, values: Array) -> Scenario:
        moved = {name: f"{v:.9g}" for name, v in zip(self._names, values, strict=True)}
        scenario = load_scenario(
            self._scenario.path,
            self._scenario.hidden_shape,
            {**self._scenario.parameters, **moved},
            photograph=self._scenario.photograph_shape,
        )
        self._check(scenario)
        return scenario

    def _difference(self, sides: list[Scenario]) -> NDArray[np.float32]:
        """Return by how much A differs, by areas or by rays."""
        if self.by_area:
            with suppress(ClosedFormError):  # an occluder that went behind the monitor, say
                ahead, behind = (area_transport(side) for side in sides)
                return np.asarray(ahead - behind)
        seed = self._seed + 1  # none of A's own rays, whose noise the image has followed
        ahead, behind = (self._penumbrae(side, seed) for side in sides)
        return np.asarray(ahead - behind)

    def _penumbrae(self, scenario: Scenario, seed: int) -> NDArray[np.float32]:
        if scenario.wall_texture is not None:
            return render_transport(scenario, samples=self._samples, seed=seed)
        return render_penumbrae(scenario, samples=self._samples, pixel_samples=1, seed=seed)
