"""Video (Sec. 3.2): each frame is denoised and repaired together with the one before it."""

from collections.abc import Callable, Iterator
from copy import deepcopy
from functools import partial
from typing import Any, Literal, get_args

import numpy as np

from periscopy_sim.numerics import Array
from periscopy_sim.numerics.validation import checked_number
from periscopy_sim.reconstruction.method import Series
from periscopy_sim.reconstruction.preconditioned.still import (
    Estimate,
    Periscope,
    Reconstruction,
    repaired,
)
from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation
from periscopy_sim.reconstruction.video_method import FrameByFrame

Coupling = Literal["total-variation", "l1", "none"]


class Video(FrameByFrame[Reconstruction, np.floating[Any]]):
    """The method `preconditioned` for video, fitted to one scene: frames singly, or many at once.

    The first frame is a still. Each later one is, by `coupling`:

    - ``"l1"``, Eq. 12 as written: argmin_f ‖f − P y‖² + λ‖f‖_TV + λ₂‖f − f_prev‖₁;
    - ``"total-variation"``, as the paper does it instead: the new P y and the previous frame are
      stacked and denoised by the proximal operator of three-dimensional total variation;
    - ``"none"``: denoised on its own.

    The first is the default because it had the smaller error where the scene moves, and it is
    the faster one; a scene that changes everywhere from frame to frame is best left uncoupled.

    Repair follows, its window widened to the previous frame (not with ``"none"``). Each frame's
    dual problem starts from the solution of the one before, which saves a third of the iterations.

    Parameters
    ----------
    still
        The method for stills, whose P, λ and κ serve every frame.
    temporal_weight
        Weight of the difference in time within three-dimensional total variation; the paper's is 1.
    coupling, l1_weight
        As of `FrameByFrame`, whose other errors it raises, too.

    Raises
    ------
    ValueError
        If the `tv_weight` for stills is infinite and the frames are coupled.
    """

    still: Periscope
    couplings = get_args(Coupling)

    def __init__(
        self,
        still: Periscope,
        *,
        coupling: Coupling = "l1",
        temporal_weight: float = 1.0,
        l1_weight: float = 0.4,
    ) -> None:
        super().__init__(still, coupling, l1_weight)
        checked_number(temporal_weight, "temporal_weight", 0)
        if np.isinf(still.tv_weight) and coupling != "none":
            raise ValueError("frames of an infinite tv_weight are flat; couple them by 'none'")
        self.temporal_weight = temporal_weight

    def restart(self) -> None:
        """Forget the latest frame: the next one is a first one."""
        super().restart()
        self._dual: Array | None = None

    def recoveries(self, photographs: Series) -> Iterator[Callable[[], Reconstruction]]:
        """Apply P to many photographs in one product; see `FrameByFrame.recoveries`."""
        for still, part in self.still.batches(photographs):
            estimate = still.estimate(part)
            for k in range(len(estimate.noise)):
                yield partial(self.finish, estimate, k)

    def finish(self, estimate: Estimate, k: int) -> Reconstruction:
        """Denoise and repair the k-th of the preconditioned photographs as the next frame."""
        hidden = self.still.hidden
        g, weight = estimate.preconditioned[k], estimate.weight[k]
        images, term, previous = g, dict[str, Any](), None
        if self.coupling != "none" and self.previous is not None:
            previous, term = hidden.vector(self.previous), {"start": self._dual}
            if self.coupling == "l1":
                term |= {"previous": previous, "l1_weight": self.l1_weight * weight}
            else:
                images = np.stack([previous, g])
                term["temporal_weight"] = self.temporal_weight
        result = solve_total_variation(images, weight, hidden, **term)
        result.warn_unless_converged()
        self._dual = result.dual
        denoised = result.image[1] if result.image.ndim == 3 else result.image
        image, threshold = repaired(hidden, denoised, self.still.repair_threshold, previous)
        image, g, denoised = map(hidden.image, (image, g, denoised))
        self.previous = deepcopy(image)  # the caller may change what is returned
        return Reconstruction(image, estimate.noise[k], weight, g, denoised, threshold)
