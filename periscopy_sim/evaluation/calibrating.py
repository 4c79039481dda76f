"""Methods that calibrate their scene by each photograph before they reconstruct it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np

from periscopy_sim.calibration.result import Calibration
from periscopy_sim.numerics import Image
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.method import Method
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.outputs.provenance import array_sha256

_SHARE = {"units": "1", "valid_range": [0, 1]}
MEASURES = {
    "trusted": {
        "long_name": "whether nothing speaks against the calibration: 1, else 0", **_SHARE
    },
    "within_1": {
        "long_name": "share of calibrated numbers within a standard error of the true ones",
        **_SHARE,
    },
    "within_3": {
        "long_name": "share of calibrated numbers within three standard errors of the true ones",
        **_SHARE,
    },
}  # fmt: skip
"""What a sweep measures of calibrations, beside each number."""


def measures_of(units: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return `MEASURES`, then each number's error and its claimed one, in the number's unit."""
    each = {
        f"{of}.{name}": {"long_name": f"{words} of {name}", "units": unit}
        for name, unit in units.items()
        for of, words in (("error", "calibrated minus true value"), ("claimed", "standard error"))
    }
    return {**MEASURES, **each}


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A method whose scene is calibrated by the photograph that it reconstructs.

    Attributes
    ----------
    scenario
        The scene by the ruler; its memo keeps a calibration for all methods.
    truth
        The true values of the numbers that declare an error, by name.
    wall
        The conditions of the photographs.
    fit
        Returns the method, fitted to a calibrated scenario.
    """

    scenario: Scenario
    truth: Mapping[str, float]
    wall: Photograph
    fit: Callable[[Scenario], Method]

    def fitted_to(self, photograph: Photograph) -> Self:
        """Return this: it knows the photographs' conditions."""
        del photograph
        return self

    def calibration(self, values: Image) -> Calibration:
        """Calibrate by a photograph, (rows, columns, channels)."""
        wall = replace(self.wall, values=np.asarray(values, np.float64))
        key = "calibration", self.scenario.digest, array_sha256(wall.values), wall.conditions
        make = partial(self.scenario.calibrate, wall, seed=0)
        return self.scenario.memo.get(key, make, 16 * self.scenario.view.points.nbytes)

    def reconstruct(self, photograph: Image) -> Any:
        """Recover the hidden image, (R, C, channels), by the method that `fitted_by` returns.

        Of several surfaces it is a mapping by id.
        """
        return self.fitted_by(photograph).reconstruct(photograph)

    def fitted_by(self, photograph: Image) -> Method:
        """Calibrate by a photograph, and return the method fitted to the calibrated scene.

        A PhotographError or a SceneError says that this photograph determines no number.
        """
        calibrated = self.calibration(photograph).scenario
        return self.fit(replace(calibrated, light=self.scenario.light))

    def measures(self, photograph: Image) -> dict[str, float]:
        """Return the measures of the calibration by a photograph, see `measures_of`."""
        found = self.calibration(photograph)
        errors = {p.name: p.value - self.truth[p.name] for p in found.parameters}
        claimed = {p.name: float(p.standard_error) for p in found.parameters}
        off = [abs(errors[name]) / claimed[name] for name in errors]
        within = {f"within_{k}": float(np.mean(np.less(off, k))) for k in (1, 3)}
        each = {"error": errors, "claimed": claimed}
        numbers = {f"{of}.{n}": v for of, values in each.items() for n, v in values.items()}
        return {"trusted": float(found.trusted), **within, **numbers}
