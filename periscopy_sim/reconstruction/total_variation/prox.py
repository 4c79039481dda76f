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

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.hidden import Differences, Hidden, Size
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.validation import (
    check_stopping,
    checked_companion,
    checked_image,
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

    @property
    def converged(self) -> bool:
        """Whether the gap is at most the tolerance."""
        return self.gap <= self.tolerance

    def warn_unless_converged(self) -> None:
        """Warn, in the name of the caller's caller, that the tolerance was not reached."""
        warn_unconverged("total variation", self.iterations, self.gap, self.tolerance, stacklevel=4)


def total_variation(image: Image) -> float:
    """Return ‖f‖_TV = Σ √(dx² + dy²) of an image, (R, C) (Rudin, Osher and Fatemi 1992).

    Differences are zero in the last row and in the last column (Chambolle 2004, Section 2).
    """
    return float(_of_grid(image.shape).norms(image.ravel()).sum())


def prox_total_variation(
    image: ArrayLike,
    weight: ArrayLike,
    *,
    hidden: Hidden | None = None,
    temporal_weight: float | None = None,
    tolerance: float = 1e-4,
    max_iterations: int = 10_000,
) -> Image:
    """Proximal operator of the total variation: argmin_f ‖f − g‖₂² + λ‖f‖_TV (Eq. 11).

    The data term has no factor one half. Where it has one, as in most of the literature, the
    same image belongs to the weight λ/2.

    With a temporal weight w the images are the frames of one video, and total variation is that
    in three dimensions, Σ √(dx² + dy² + w² dt²) (Sec. 3.2, where w = 1).

    Parameters
    ----------
    image
        g, of a floating-point type, finite: (rows, columns) or (rows, columns, channels), with a
        temporal weight (frames, rows, columns) or (frames, rows, columns, channels). Each channel
        is denoised on its own.
    weight
        λ ≥ 0 in units of the image: one number, or one for each channel. Zero returns the image,
        infinity its mean.
    hidden
        Surfaces of N patches on which the images are, each denoised by itself: (rows, columns) is
        then (N,) everywhere. None for a grid of equal squares.
    temporal_weight
        w ≥ 0, finite; zero denoises each frame on its own. None for images without time.
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
    TypeError
        The image is not of a real floating-point type.
    ValueError
        The image is empty, not finite, of another dimension or not on the surfaces; a weight is
        negative, NaN or of another shape; the tolerance is not between 0 and 1, or max_iterations
        below 1.

    Warns
    -----
    RuntimeWarning
        The tolerance was not reached.
    """
    result = solve_total_variation(
        image,
        weight,
        hidden=hidden,
        temporal_weight=temporal_weight,
        tolerance=tolerance,
        max_iterations=max_iterations,
    )
    result.warn_unless_converged()
    return result.image


def solve_total_variation(
    image: ArrayLike,
    weight: ArrayLike,
    *,
    hidden: Hidden | None = None,
    temporal_weight: float | None = None,
    previous: ArrayLike | None = None,
    l1_weight: ArrayLike = 0.0,
    tolerance: float = 1e-4,
    max_iterations: int = 10_000,
    start: Array | None = None,
) -> TotalVariationResult:
    """Return a proximal operator's image with an account of its convergence, and no warning.

        argmin_f ‖f − g‖₂² + λ‖f‖_TV + λ₂‖f − p‖₁ (Eq. 11; with a previous image p, Eq. 12)

    The dual problem (Chambolle 2004) is solved by accelerated projected gradient ascent (FGP, Beck
    and Teboulle 2009) with restarts (O'Donoghue and Candès 2015), until the duality gap is small.

    Arguments and errors are those of `prox_total_variation`, beside them: p, finite and of the
    image's shape; λ₂ ≥ 0, which needs p and a finite λ, in the image's units and of a shape that λ
    may have; and `start`, the `dual` of a similar problem, ignored if it is of other sizes.
    """
    check_stopping(tolerance, max_iterations)
    if temporal_weight is not None and not 0 <= temporal_weight < math.inf:
        raise ValueError(f"temporal_weight is {temporal_weight}: give a number of at least 0")
    values = checked_image(image)
    grids, planes = _planes(values, hidden, temporal_weight is not None)
    channels, frames, patches = planes.shape
    w = float(temporal_weight) if temporal_weight and frames > 1 else 0.0
    shape = (-1, frames, patches) if w else (-1, 1, patches)  # frames that time does not tie
    g = p = planes.reshape(shape)
    if previous is not None:
        before = checked_companion(previous, "previous", values)
        p = _planes(before, hidden, temporal_weight is not None)[1].reshape(shape)
    weights, l1_weights = (
        np.repeat(_of_each_channel(*each, channels), len(g) // channels)
        for each in ((weight, "weight"), (l1_weight, "l1_weight"))
    )
    if l1_weights.any() and (previous is None or np.isinf(weights).any()):
        raise ValueError("an l1_weight needs a previous image and a finite weight beside it")

    dual = np.zeros((len(g), 3 if w else 2, *g.shape[1:]))
    if start is not None and start.shape == dual.shape:
        dual[:] = start
    bounds, stop = (weights / 2, l1_weights / 2), (float(tolerance), int(max_iterations))
    f, iterations, gaps = np.empty(g.shape), [], []
    for part, size, differences in grids:  # no surface depends on another
        of_surface = _frames(differences, size, g.shape[1], w)
        own_g, own_p = (each[..., part].reshape(len(g), -1) for each in (g, p))
        own_dual = np.reshape(dual[..., part].copy(), (len(g), dual.shape[1], -1))
        solved, *account = solve_dual(own_g, own_p, bounds, of_surface, stop, own_dual)
        f[..., part] = solved.reshape(f[..., part].shape)
        dual[..., part] = own_dual.reshape(dual[..., part].shape)
        iterations.append(account[0].max())
        gaps.append(account[1].max())
    images = np.moveaxis(f.reshape(planes.shape), 0, -1)
    return TotalVariationResult(
        image=images.reshape(values.shape).astype(values.dtype),
        iterations=int(max(iterations)),
        gap=float(max(gaps)),
        tolerance=tolerance,
        dual=dual,
    )


Grids = list[tuple[slice, Size, Differences]]
"""Each surface's part of the patches, its size and its ∇."""

# Images of one size follow each other: few are kept, for they are as large as images.
_of_grid = lru_cache(maxsize=1)(Differences.of_grid)
_frames = lru_cache(maxsize=4)(ImageGrid.of)


def _planes(image: Image, hidden: Hidden | None, in_time: bool) -> tuple[Grids, Array]:
    """Return the surfaces of images, and (channels, frames, patches) in double precision."""
    known = in_time + (2 if hidden is None else 1)
    if image.ndim not in (known, known + 1) or image.size == 0:
        axes = "rows, columns" if hidden is None else "patches"
        raise ValueError(
            f"image has shape {image.shape}: give ({axes}[, channels]), or with a "
            f"temporal_weight (frames, {axes}[, channels])"
        )
    if hidden is None:
        size = image.shape[in_time:known]
        grids = [(slice(None), size, _of_grid(size))]
    else:
        grids = [
            (part, hidden[name].shape, hidden.differences_by_surface[name])
            for name, part in hidden.slices.items()
        ]
    channels = image.shape[-1] if image.ndim > known else 1
    patches = math.prod(image.shape[in_time:known])
    if hidden is not None and patches != hidden.patches:
        raise ValueError(f"image has {patches} patches, the surfaces have {hidden.patches}")
    frames = image.reshape(-1, patches, channels)
    return grids, np.ascontiguousarray(np.moveaxis(frames, -1, 0), np.float64)


def _of_each_channel(weight: ArrayLike, name: str, channels: int) -> Array:
    weights = np.asarray(weight, np.float64)
    if weights.shape not in ((), (channels,)):
        raise ValueError(
            f"{name} has shape {weights.shape} for {channels} channels: give one number, or one "
            "for each channel"
        )
    if not (weights >= 0).all():
        raise ValueError(f"{name} is {weights}: give a number that is not negative")
    return np.broadcast_to(weights, channels)
