"""Video by the noise-aware method: each frame is drawn towards the one before it."""

from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from typing import Literal, get_args

import numpy as np

from periscopy_sim.model.fit import Evidence
from periscopy_sim.reconstruction.method import Series
from periscopy_sim.reconstruction.noise_aware.noise_aware import (
    NoiseAware,
    NoiseAwareReconstruction,
)
from periscopy_sim.reconstruction.noise_aware.penalized_likelihood import Schedule, Splitting
from periscopy_sim.reconstruction.video_method import FrameByFrame

Coupling = Literal["l1", "none"]

PENALTY = 0.4
"""λ/ρ over the image's scale: the step that needed the fewest iterations from a frame nearby."""

LOOSER = 3.0
"""Tolerance over that of a still: with this step, it leaves a frame as near to its minimum."""


class NoiseAwareVideo(FrameByFrame[NoiseAwareReconstruction, np.float64]):
    """The noise-aware method for video, fitted to one scene: one frame at a time, or many at once.

    The first frame is a still. Each later one is, by `coupling`:

    - ``"l1"``, Eq. 12 with the misfit taken in the photograph: the minimizer of the still's
      objective plus λ₂ Σ‖f − f_prev‖, the norm over a patch's channels, so that a patch stays as
      it was or changes in all its colours;
    - ``"none"``: a still.

    Each frame starts from the solution of the one before, which saves a sixth of the iterations
    and does not move the minimum: of what was before, a frame depends on the frame before alone.
    Frames are not corrected (`Correction`): a gain over the wall would differ between them.

    Errors are those of `FrameByFrame`.
    """

    still: NoiseAware
    couplings = get_args(Coupling)

    def __init__(
        self, still: NoiseAware, *, coupling: Coupling = "l1", l1_weight: float = 0.8
    ) -> None:
        super().__init__(still, coupling, l1_weight)

    def restart(self) -> None:
        """Forget the latest frame: the next frame starts a video."""
        super().restart()
        self._split: Splitting | None = None

    def recoveries(self, photographs: Series) -> Iterator[Callable[[], NoiseAwareReconstruction]]:
        """Apply A to many photographs in one product; see `FrameByFrame.recoveries`."""
        for still, part in self.still.batches(photographs):
            for evidence in still.evidence(part):
                yield partial(self.finish, still, evidence)

    def finish(self, still: NoiseAware, evidence: Evidence) -> NoiseAwareReconstruction:
        """Return the next frame from its photograph's evidence by the still that it is for."""
        if self.previous is None:
            solution, split = still.recover(evidence)
        else:
            weight = self.l1_weight if self.coupling == "l1" else 0.0
            tolerance = LOOSER * still.tolerance
            penalty = PENALTY / max(1.0, weight)  # the step follows the larger of λ and λ₂
            schedule = Schedule(tolerance, still.max_iterations, penalty)
            solution, split = still.recover(evidence, schedule, self._split, self.previous, weight)
        solution.warn_unless_converged()
        self._split = split
        self.previous = deepcopy(solution.image)  # the caller may change what is returned
        return solution
