"""Isotropic total variation and its proximal operators: Eq. 11, its video form, and Eq. 12.

`dual_solver` solves them.

References
----------
Rudin, Osher, Fatemi, "Nonlinear total variation based noise removal algorithms", 1992.
Chambolle, "An algorithm for total variation minimization and applications", 2004.
Beck, Teboulle, "Fast gradient-based algorithms for constrained total variation image denoising
and deblurring problems", 2009.
O'Donoghue, Candès, "Adaptive restart for accelerated gradient schemes", 2015.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.hidden import Hidden
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.validation import (
    InputError,
    check_stopping,
    checked_companion,
    checked_image,
    checked_number,
    warn_unconverged,
)
from periscopy_sim.reconstruction.total_variation.dual_solver import ImageGrid, solve_dual

Image = NDArray[Any]  # of the type of the image given


@dataclass(frozen=True, eq=False)
class TotalVariationResult:
    """A denoised image and how well it was solved for.

    No iteration is taken where the answer is known: the image itself for a weight of zero, its mean
    for a large one. The squared distance ‖f̂ − f‖₂² to the exact minimizer f is at most the gap
    times the objective. The dual field starts similar problems.
    """

    image: Image  # the minimizer f̂, the shape of the input
    iterations: int  # by the slowest channel
    gap: float  # the duality gap as a fraction of the objective, the largest of the channels
    tolerance: float  # the largest gap that counts as converged
    dual: Array  # (channels, axes, frames, patches) the dual field over its largest length λ/2

    def warn_unless_converged(self) -> None:
        """Warn, in the name of the caller's caller, that the tolerance was not reached."""
        warn_unconverged("total variation", self.iterations, self.gap, self.tolerance, stacklevel=4)


def prox_total_variation(
    image: ArrayLike,
    weight: ArrayLike,
    *,
    hidden: Hidden | None = None,
    tolerance: float = 1e-4,
    max_iterations: int = 10_000,
) -> Image:
    """Proximal operator of the total variation: argmin_f ‖f − g‖₂² + λ‖f‖_TV (Eq. 11).

    The data term has no factor one half. Where it has one, as in most of the literature, the
    same image belongs to the weight λ/2.

    Parameters
    ----------
    image
        g, of a floating-point type, finite: (rows, columns) or (rows, columns, channels). Each
        channel is denoised on its own.
    weight
        λ ≥ 0 in units of the image: one number, or one for each channel. Zero returns the image,
        infinity its mean.
    hidden
        Surfaces of N patches, each denoised by itself; g is then (N,) or (N, channels). None for a
        grid of equal squares.
    tolerance
        Stop when the duality gap is at most this fraction of the objective. Scaling image and
        weight together does not change when that is.
    max_iterations
        Give up after so many iterations, with a warning.

    Returns
    -------
    f, the shape and the type of the image, float32 at least and float64 at most.

    Raises
    ------
    TypeError, ValueError
        An argument is not as above.

    Warns
    -----
    RuntimeWarning
        The tolerance was not reached.
    """
    g = np.asarray(image)
    axes = 2 if hidden is None else 1
    if g.ndim not in (axes, axes + 1) or not g.size:
        names = "rows, columns" if hidden is None else "patches"
        raise InputError(f"image has shape {g.shape}: give ({names}[, channels])")
    hidden = Hidden.of(g.shape[:2]) if hidden is None else hidden
    vectors = g.reshape(-1, *(g.shape[axes:] or (1,)))
    result = solve_total_variation(
        vectors, weight, hidden, tolerance=tolerance, max_iterations=max_iterations
    )
    result.warn_unless_converged()
    return result.image.reshape(g.shape)


def solve_total_variation(
    images: Image,
    weight: ArrayLike,
    hidden: Hidden,
    *,
    temporal_weight: float = 0.0,
    previous: Image | None = None,
    l1_weight: ArrayLike = 0.0,
    tolerance: float = 1e-4,
    max_iterations: int = 10_000,
    start: Array | None = None,
) -> TotalVariationResult:
    """Return a proximal operator's image with an account of its convergence, and no warning.

        argmin_f ‖f − g‖₂² + λ‖f‖_TV + λ₂‖f − p‖₁ (Eq. 11; with a previous image p, Eq. 12)

    The dual problem (Chambolle 2004) is solved by accelerated projected gradient ascent (FGP, Beck
    and Teboulle 2009) with restarts (O'Donoghue and Candès 2015), until the duality gap is small.

    The images g on hidden surfaces are (N, channels), or (frames, N, channels) of a video, whose
    total variation with a temporal weight w > 0 is that in three dimensions,
    Σ √(dx² + dy² + w² dt²) (Sec. 3.2, where w = 1). The weights are as of `prox_total_variation`;
    λ₂ ≥ 0 needs p, of the shape of g, and a finite λ. `start` is the `dual` of a similar problem,
    ignored if it is of other sizes.
    """
    check_stopping(tolerance, max_iterations)
    checked_number(temporal_weight, "temporal_weight", 0)
    values = checked_image(images)
    if values.ndim not in (2, 3) or values.shape[-2] != hidden.patches:
        raise InputError(
            f"the images have shape {values.shape}, the surfaces have {hidden.patches} patches: "
            "give ([frames, ]patches, channels)"
        )
    in_time = temporal_weight > 0 and values.ndim == 3
    frames, channels = len(values) if in_time else 1, values.shape[-1]

    def planes(each: Image) -> Array:  # (K, frames that time ties, N)
        flat = np.moveaxis(each, -1, 0).reshape(-1, frames, hidden.patches)
        return np.ascontiguousarray(flat, np.float64)

    g = p = planes(values)
    if previous is not None:
        p = planes(checked_companion(previous, "previous", values))
    given = (
        np.broadcast_to(np.asarray(each, np.float64), channels) for each in (weight, l1_weight)
    )
    weights, l1_weights = (np.repeat(each, len(g) // channels) for each in given)
    if not (min(weights) >= 0 and min(l1_weights) >= 0):
        raise InputError(f"weight {weights}, l1_weight {l1_weights}: give numbers, not negative")
    if l1_weights.any() and (previous is None or np.isinf(weights).any()):
        raise InputError("an l1_weight needs a previous image and a finite weight beside it")

    dual = np.zeros((len(g), 3 if in_time else 2, *g.shape[1:]))
    if start is not None and start.shape == dual.shape:
        dual[:] = start
    bounds, stop = (weights / 2, l1_weights / 2), (float(tolerance), int(max_iterations))
    f, iterations, gaps = np.empty(g.shape), [], []
    for name, part in hidden.slices.items():  # no surface depends on another
        differences, size = hidden.differences_by_surface[name], hidden[name].shape
        of_surface = _frames(differences, size, frames, temporal_weight if in_time else 0.0)
        own_g, own_p = (each[..., part].reshape(len(g), -1) for each in (g, p))
        own_dual = np.reshape(dual[..., part].copy(), (len(g), dual.shape[1], -1))
        solved, *account = solve_dual(own_g, own_p, bounds, of_surface, stop, own_dual)
        f[..., part] = solved.reshape(f[..., part].shape)
        dual[..., part] = own_dual.reshape(dual[..., part].shape)
        iterations.append(account[0].max())
        gaps.append(account[1].max())
    image = np.moveaxis(f.reshape(channels, *values.shape[:-1]), 0, -1).astype(values.dtype)
    return TotalVariationResult(image, int(max(iterations)), float(max(gaps)), tolerance, dual)


# A few: they are as large as images.
_frames = lru_cache(maxsize=4)(ImageGrid.of)
