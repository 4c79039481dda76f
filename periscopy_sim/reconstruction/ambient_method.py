"""What the methods that fit ambient light beside the hidden image have in common."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.reconstruction import monitor_left_on
from periscopy_sim.reconstruction.background_subspace import background_basis, joined_basis
from periscopy_sim.reconstruction.method import Image, StillMethod
from periscopy_sim.reconstruction.unevenness import Unevenness

Array = NDArray[np.float64]
Precision = TypeVar("Precision", bound=np.floating[Any])


class AmbientMethod(StillMethod[Precision]):
    """A method that uses B, and learns of the wall's paint from background photographs.

    Parameters and errors are those of `StillMethod`.
    """

    _unevenness: Unevenness | None = None

    @abstractmethod
    def _unexplained(self, rows: Array) -> Array:
        """Return what least squares of hidden image and ambient light leave of rows, (J, M')."""

    def _ambient_basis(self, A: Any, B: Image | None, rank_tolerance: float) -> Array:
        """Return an orthonormal basis of all ambient light, (M', r); learn of the wall's paint."""
        smooth = background_basis(self.observation.used(B), rank_tolerance)
        if not self.observation.backgrounds:
            return smooth
        monitor_left_on.check_monitor_off(A, smooth, self.observation)
        if smooth.shape[1]:
            self._unevenness = Unevenness(smooth, self.observation)
        return joined_basis(smooth, self.observation.ambient(None))

    def _evenness(self, planes: Array) -> Array | None:
        """Return the evenness of a photograph's (3, M') planes; None without backgrounds."""
        if self._unevenness is None:
            return None
        return self._unevenness.evenness(planes, self._unexplained)
