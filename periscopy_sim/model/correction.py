"""What else shapes a photograph than A f + B c + n: corrections, each an object in a list.

A method for stills is given a list of corrections; a method without them is the plain method. The
gain over the wall has gained on a real photograph. Paint is measured on rendered photographs alone,
and acts where photographs with the monitor off are given.
"""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.fit import FittedPhotograph

Array = NDArray[np.float64]

ERROR_RATE = 1e-3
"""Fraction, at most, of photographs of a right model in which a correction finds something."""

RESOLVED = 1e-3
"""Sine of the angle between two fields, below which they are taken for one: a thousand times single
precision's."""

FirstImage = Callable[[FittedPhotograph], Array]
"""Returns a first hidden image, (R, C, 3), of a photograph."""


class Correction(Protocol):
    """A correction, made for one scene from its `Fit`."""

    def __call__(
        self, photograph: FittedPhotograph, first_image: FirstImage
    ) -> tuple[FittedPhotograph, Mapping[str, Any]]:
        """Return the photograph corrected, and what was found, by name, for a summary.

        Where nothing is found, the photograph is returned as it was given.
        """
