"""How errors of a scene's parameters change its light transport: A on either side of the scene.

A comes by areas, without noise (`area_transport`), or by rays where the scene has no closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.analytic.area_transport import area_transport, has_areas
from periscopy_sim.calibration.prior import check_error, start_values
from periscopy_sim.calibration.scene_covariance import SceneCovariance
from periscopy_sim.errors import ClosedFormError, SceneError
from periscopy_sim.model.uncertain_transport import UncertainTransport
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.transport.shadow_rays import render_transport
from periscopy_sim.rendering.variant import require_vectorized
from periscopy_sim.scenario import Array, Scenario


def uncertain_transport(
    scenario: Scenario,
    errors: Mapping[str, float] | SceneCovariance,
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
        Standard errors of ``<default>``s, independent of each other, by name; or the covariance
        that a calibration wrote. Directions in which A does not change are left out.
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
        If a parameter is unknown or no number, an error not positive, the scene not physical on
        either side, or A does not change.
    VariantError
        In scalar variants, of a scene without closed form.
    """
    if isinstance(errors, SceneCovariance):
        names, values, directions = errors.names, errors.values, errors.directions
    else:
        names = tuple(errors)
        values = start_values(scenario.path, names, scenario.parameters)
        for name, error in errors.items():
            check_error(name, error)
        directions = np.diag(list(errors.values()))
    if not has_areas(scenario):
        require_vectorized("an uncertain scene by rays")
    movable = load_scenario(
        scenario.path,
        scenario.hidden_shape,
        scenario.parameters,
        photograph=scenario.photograph_shape,
    )

    def transport(place: Array) -> NDArray[np.float32]:
        moved = movable.at(**{n: f"{v:.9g}" for n, v in zip(names, place, strict=True)})
        if has_areas(scenario):
            return area_transport(moved)
        # None of A's own rays, whose noise the image follows.
        return render_transport(moved, samples=samples, seed=seed + 1)

    changes = np.empty((directions.shape[1], *scenario.transport_shape), np.float32)
    for k, direction in enumerate(directions.T):
        try:
            changes[k] = (transport(values + direction) - transport(values - direction)) / 2
        except (SceneError, ClosedFormError) as error:
            name = names[int(np.argmax(np.abs(direction)))]
            raise SceneError(f"an error of '{name}' is too large ({error})") from None
        if progress is not None:
            progress((k + 1) / len(changes))
    shown = changes.any(axis=(1, 2))
    if not shown.any():
        raise SceneError(f"the photograph shows no error of {', '.join(names)}; leave that out")
    return UncertainTransport(names, values, directions[:, shown], changes[shown])
