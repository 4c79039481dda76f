"""A chair elsewhere than measured, and what a calibration of it returns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.analytic.area_transport import area_transport
from periscopy_sim.calibration.prior import UncertainParameters
from periscopy_sim.calibration.problem import CalibrationProblem
from periscopy_sim.calibration.resolution_level import ResolutionLevel
from periscopy_sim.calibration.result import Calibration, Parameter
from periscopy_sim.photograph import Photograph
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]


SIDE, HIDDEN = 24, (6, 7)


SIZE = {"resolution": str(SIDE)}


ERRORS = {"occluder_dx": 0.005, "occluder_dz": 0.005, "monitor_turn": 0.5}


TRUTH = {"occluder_dx": 0.004, "occluder_dz": -0.006, "monitor_turn": 0.3}


AMBIENT = np.ones((SIDE, SIDE, 1)) * np.array([1, 0.9, 0.8])


def picture(seed: int) -> Array:
    """Return a smooth picture of saturated colours with a dark border, (R, C, 3)."""
    row, column = (np.linspace(-1, 1, size) for size in HIDDEN)
    border = np.outer(1 - row**4, 1 - column**4)
    waves = np.random.default_rng(seed).uniform(-3, 3, (3, 3))
    light = [np.sin(a * row[:, None] + b * column + c) ** 2 for a, b, c in waves]
    return np.asarray(border[..., None] * np.stack(light, axis=2))


@dataclass(frozen=True, eq=False)
class Small:
    """A chair elsewhere than measured, and its photographs of two pictures."""

    scenario: Scenario
    pictures: list[Array]

    def photograph(self, index: int, snr: float = 55) -> Array:
        """Return a photograph by areas, of 64 wall points a pixel, with noise."""
        scene = self.scenario.at(**TRUTH).averaged(8)
        light = area_transport(scene) @ self.pictures[index].reshape(-1, 3)
        composite = ps.composite(light.reshape(SIDE, SIDE, 3), AMBIENT, 1.0)
        return np.asarray(ps.add_noise(composite, snr, index))

    def problem(self, shown: int = 0, count: int = 1) -> CalibrationProblem:
        """Return the problem of so many photographs, of the first of which pictures are known."""
        return CalibrationProblem(
            self.scenario,
            tuple(ERRORS),
            np.zeros(len(ERRORS)),
            np.array(list(ERRORS.values())),
            UncertainParameters((), np.zeros(0), np.zeros(0)),
            [Photograph.of(self.photograph(k)) for k in range(count)],
            self.pictures[:shown],
        )

    def level(self, shown: int = 0, count: int = 1) -> ResolutionLevel:
        """Return the fine level of that problem."""
        return self.problem(shown, count).fine()


DESCENT = np.array([[0.11, 1.8], [0.1, 1.7], [0.1, 1.6]])


def calibration(doubts: tuple[str, ...] = ()) -> Calibration:
    """Return what a calibration of two parameters has found."""
    residuals = 0.02 * np.random.default_rng(0).standard_normal((2, 16, 18, 3))
    return Calibration(
        parameters=(
            Parameter("dx", 0.0, 0.1, 0.01, 0.01, 0.05),
            Parameter("turn", 2.0, 1.6, 0.3, 0.5, 0.5),
        ),
        uncertain=UncertainParameters((), np.zeros(0), np.zeros(0)),
        moves=np.zeros((2, 0)),
        correlation=np.eye(2),
        path=(np.pad(DESCENT, ((0, 0), (0, 1))),),
        noise_before=np.full(3, 0.0289),
        noise=np.full(3, 0.01),
        residual_before=residuals[0],
        residual=residuals[1],
        gain=np.ones((16, 18)),
        doubts=doubts,
    )
