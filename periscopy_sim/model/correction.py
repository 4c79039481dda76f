"""Corrections of what A f + B c + n does not describe, each an object in a list.

A method for stills is given a list of corrections; a method without them is the plain method. The
gain over the wall has gained on a real photograph. Paint is measured on rendered photographs alone,
and acts where photographs with the monitor off are given.
"""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from periscopy_sim.model.fit import FittedPhotograph
from periscopy_sim.numerics import Array

ERROR_RATE = 1e-4
"""Largest fraction of photographs of a right model in which a correction has an effect. In scenes a
little wrong, 18 gains of a probability between this and 1e-3 cost 0.2 dB in the mean."""

RESOLVED = 1e-3
"""Sine of the angle between two fields, below which they count as equal: a thousand times single
precision's."""

FirstImage = Callable[[FittedPhotograph], Array]
"""Returns a first hidden image, (R, C, 3), of a photograph."""


class Correction(Protocol):
    """A correction, made for one scene from its `Fit`."""

    def __call__(
        self, photograph: FittedPhotograph, first_image: FirstImage
    ) -> tuple[FittedPhotograph, Mapping[str, Any]]:
        """Return the corrected photograph, and numbers by name for a summary.

        A correction that has no effect returns the same photograph.
        """
