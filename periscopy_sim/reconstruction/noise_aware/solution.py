"""What the noise-aware method returns: a hidden image, and how it came about."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction.method import Solution
from periscopy_sim.reconstruction.noise_aware.evidence import Evidence
from periscopy_sim.reconstruction.noise_aware.nuisance.ambient_prior import AmbientEstimate
from periscopy_sim.reconstruction.uncertain_scene.found_scene import FoundScene

Array = NDArray[np.float64]

LENS = 0.7, 1.2
"""Least and largest gain that a lens makes: one that darkens corners by 27 % made 0.75 to 1.11."""


@dataclass(frozen=True, eq=False, repr=False)
class NoiseAwareReconstruction(Solution[np.float64]):
    """A hidden image and how it came about; see `Solution`. One λ serves all channels.

    Attributes
    ----------
    iterations
        Those taken.
    residual
        The larger of the relative primal and dual residuals (Boyd et al., Sec. 3.3) at the end.
    tolerance
        What it was to be at most.
    gain
        (rows, columns) gain over the wall that was found and corrected for; 1 where there is none,
        or none was looked for. (M,) where the photograph's shape is not known.
    evidence
        Of the photograph, the gain corrected for.
    first_image
        (R, C, 3) the image that the gain was found from; None where there is none.
    scene
        Where its uncertain parameters were found; None where the scene is taken for right.
    ambient
        The ambient light beyond range(B); None where there is none.
    """

    weight: float
    iterations: int
    residual: float
    tolerance: float
    gain: Array
    evidence: Evidence
    first_image: Array | None = None
    scene: FoundScene | None = None
    ambient: AmbientEstimate | None = None

    @property
    def has_gain(self) -> bool:
        """Whether a gain over the wall was found."""
        return bool((self.gain != 1).any())

    @property
    def ambient_strengths(self) -> list[float]:
        """κ of each group of the ambient light beyond range(B); none where there is none."""
        return [] if self.ambient is None else self.ambient.strengths.tolist()

    @property
    def gain_remark(self) -> str:
        """What the gain means to a user, and whether anything need be done; empty without one."""
        if not self.has_gain:
            return ""
        least, largest = float(self.gain.min()), float(self.gain.max())
        told = (
            f"a smooth gain over the wall: the monitor's light there is {least:.2f} to "
            f"{largest:.2f} times what the scene makes it"
        )
        if LENS[0] <= least and largest <= LENS[1]:
            return (
                f"{told}, as by a lens that darkens corners (prepare --flat); the image allows for "
                "it, and nothing need be done"
            )
        return (
            f"{told}, more than a lens does: by light that bounces, another falloff of the monitor "
            "with angle, or something that stands elsewhere (periscopy calibrate, if that was not "
            "done); the image allows for it, only its place and brightness are less sure"
        )

    def told(self) -> dict[str, Any]:
        """Return the noise, the weight and the iterations."""
        return {**super().told(), "iterations": self.iterations}

    @property
    def converged(self) -> bool:
        """Whether the residual is what was asked for."""
        return self.residual <= self.tolerance

    def warn_unless_converged(self) -> None:
        """Warn where the iterations did not suffice."""
        if not self.converged:
            warnings.warn(
                f"noise-aware recovery stopped after {self.iterations} iterations at a relative "
                f"residual of {self.residual:.1e}, above {self.tolerance:.1e}: raise "
                "max_iterations or tolerance",
                RuntimeWarning,
                stacklevel=3,
            )
