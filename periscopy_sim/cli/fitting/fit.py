"""A method, fitted to the scene that a command was given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from periscopy_sim.cli.fitting.prototypes import AskedPrototypes
from periscopy_sim.cli.fitting.transport_matrix import AskedTransport, check_memory
from periscopy_sim.cli.output import Stopwatch, fixable, progress, warn

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from periscopy_sim.model.uncertain_transport import UncertainTransport
    from periscopy_sim.scenario import Array, Scenario


def fit(
    method: str,
    settings: Mapping[str, float],
    scenario: Scenario,
    used: NDArray[np.bool_] | None,
    dark: Mapping[str, Array],
    timed: Stopwatch,
    asked: AskedTransport,
    prototypes: AskedPrototypes,
    uncertain: UncertainTransport | None = None,
) -> tuple[Any, NDArray[np.float32]]:
    """Fit a method to a scene's B and A; return it and A, the channels' mean."""
    from periscopy_sim.evaluation.methods import fit_method
    from periscopy_sim.rendering.transport.bounced_transport import channels_mean
    from periscopy_sim.storage.transport_matrix import record_of

    with timed("transport matrix"):
        check_memory(scenario, method)
        A = channels_mean(asked.matrix(scenario))
    place = str(asked.file or f"scene '{scenario.path}'")
    with timed("prototype backgrounds"):
        B = prototypes.matrix(scenario)
    with timed("fit the method"), progress(f"fitting {method}"), fixable(place, dark):
        fitted = fit_method(method, scenario, A, B, used, dark, uncertain, **settings)
    if asked.file is not None and not record_of(asked.file).is_file():
        warn(f"{asked.file} has no JSON file beside it: it may be of another scene of this size")
    return fitted, A
