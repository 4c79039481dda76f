"""Isotropic total variation and its proximal operator, Eq. 11.

The proximal operator is computed through its dual. With τ = λ/2, the minimizer of
½‖f − g‖₂² + τ‖f‖_TV is f = g + div q, where the field q, of length at most τ at each pixel,
minimizes ½‖g + div q‖₂² (Chambolle 2004). The projected gradient method on q is accelerated
(FGP, Beck and Teboulle 2009), its momentum restarted whenever it points uphill
(O'Donoghue and Candès 2015), and stopped by the duality gap Σ(τ|∇f| − ∇f·q), whose terms are
all non-negative.

In the compiled loops a field has one row and one column of zeros before its first entries, and
an image repeats its last row and column once: then differences need no case for the border. The
acceleration does not depend on the number of dimensions; the stencils do, and stand apart in
`_apply_dual`, `_descend` and `_objectives`.

References
----------
Rudin, Osher, Fatemi, "Nonlinear total variation based noise removal algorithms", 1992.
Chambolle, "An algorithm for total variation minimization and applications", 2004.
Beck, Teboulle, "Fast gradient-based algorithms for constrained total variation image denoising
and deblurring problems", 2009.
O'Donoghue, Candès, "Adaptive restart for accelerated gradient schemes", 2015.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# 1 / ‖∇‖²: the squared norm of the gradient is below 4 for each dimension.
_STEP = 1 / 8
_GAP_INTERVAL = 10

Function = TypeVar("Function", bound=Callable[..., object])


def _compiled(function: Function) -> Function:
    """Compile; sums may be reordered and errors are IEEE's, so that the loops vectorize."""
    fast = {"reassoc", "nsz", "contract"}
    compiled: Function = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=fast)(
        function
    )
    return compiled


@dataclass(frozen=True, eq=False)
class TotalVariationResult:
    """A denoised image and how well it was solved for.

    Attributes
    ----------
    image
        The minimizer f̂, the shape of the input.
    iterations
        The iterations taken; with channels, by the slowest. 0 where the answer is known: the
        image itself for a weight of zero, its mean for a large one.
    gap
        The duality gap as a fraction of the objective ‖f̂ − g‖₂² + λ‖f̂‖_TV; with channels, the
        largest. The squared distance ‖f̂ − f‖₂² to the exact minimizer f is at most this fraction
        of that objective.
    converged
        Whether `gap` is within the tolerance asked for.
    """

    image: Array
    iterations: int
    gap: float
    converged: bool


def gradient(image: ArrayLike) -> Array:
    """Differences of an image to the next row and to the next column.

    Parameters
    ----------
    image
        (rows, columns).

    Returns
    -------
    (2, rows, columns): down the rows, then along the columns; zero in the last row and in the
    last column respectively (Chambolle 2004, Section 2).

    Raises
    ------
    ValueError
        The image is not two-dimensional.
    """
    values = np.asarray(image, dtype=np.float64)
    if values.ndim != 2:
        raise ValueError(f"image has shape {values.shape}: give (rows, columns)")
    field = np.zeros((2, *values.shape))
    field[0, :-1] = np.diff(values, axis=0)
    field[1, :, :-1] = np.diff(values, axis=1)
    return field


def divergence(field: ArrayLike) -> Array:
    """Minus the adjoint of `gradient`: ⟨∇f, q⟩ = −⟨f, div q⟩ for all f and q.

    Parameters
    ----------
    field
        (2, rows, columns). Its last row down the rows, and its last column along the columns,
        meet only zeros of a gradient and do not count.

    Returns
    -------
    (rows, columns).

    Raises
    ------
    ValueError
        The field is not of shape (2, rows, columns).
    """
    values = np.asarray(field, dtype=np.float64)
    if values.ndim != 3 or values.shape[0] != 2:
        raise ValueError(f"field has shape {values.shape}: give (2, rows, columns)")
    down = np.diff(values[0, :-1], axis=0, prepend=0, append=0)
    across = np.diff(values[1, :, :-1], axis=1, prepend=0, append=0)
    return np.asarray(down + across)


def total_variation(image: ArrayLike) -> float:
    """Isotropic total variation ‖f‖_TV = Σ √(dx² + dy²) (Rudin, Osher and Fatemi 1992).

    Parameters
    ----------
    image
        (rows, columns).

    Returns
    -------
    The sum of the lengths of `gradient(image)`, in units of the image.

    Raises
    ------
    ValueError
        The image is not two-dimensional.
    """
    return float(np.hypot(*gradient(image)).sum())


def prox_total_variation(
    image: ArrayLike, weight: ArrayLike, *, tolerance: float = 1e-4, max_iterations: int = 10_000
) -> Array:
    """Proximal operator of the total variation: argmin_f ‖f − g‖₂² + λ‖f‖_TV (Eq. 11).

    The data term has no factor one half. Where it has one, as in most of the literature, the
    same image belongs to the weight λ/2.

    Parameters
    ----------
    image
        g, (rows, columns) or (rows, columns, channels), of a floating-point type, finite; each
        channel is denoised on its own.
    weight
        λ ≥ 0 in units of the image, one number or one for each channel. Zero returns the image,
        infinity its mean.
    tolerance
        Stop when the duality gap is at most this fraction of the objective. Scaling image and
        weight together does not change when that is.
    max_iterations
        Give up after so many iterations, with a warning.

    Returns
    -------
    f, the shape of the image, float64.

    Raises
    ------
    TypeError
        The image is not of a real floating-point type.
    ValueError
        The image is empty, not finite or of another dimension; a weight is negative, NaN or not
        one for each channel; the tolerance or the number of iterations is not positive.

    Warns
    -----
    RuntimeWarning
        The tolerance was not reached.
    """
    result = solve_total_variation(
        image, weight, tolerance=tolerance, max_iterations=max_iterations
    )
    if not result.converged:
        warnings.warn(
            f"total variation stopped after {result.iterations} iterations at a relative duality "
            f"gap of {result.gap:.1e}, above {tolerance:.1e}: raise max_iterations or tolerance",
            RuntimeWarning,
            stacklevel=2,
        )
    return result.image


def solve_total_variation(
    image: ArrayLike, weight: ArrayLike, *, tolerance: float = 1e-4, max_iterations: int = 10_000
) -> TotalVariationResult:
    """`prox_total_variation` with an account of its convergence, and no warning.

    Parameters, errors and the problem solved are those of `prox_total_variation`.

    Returns
    -------
    The image, the iterations taken, the relative duality gap and whether it met the tolerance.
    """
    values = _checked_image(image)
    if not 0 < tolerance < math.inf:
        raise ValueError(f"tolerance is {tolerance}: give a positive number")
    if max_iterations < 1:
        raise ValueError(f"max_iterations is {max_iterations}: give at least 1")

    channels = values.reshape(*values.shape[:2], -1)
    weights = _weight_of_each_channel(weight, values)
    solved = [
        _denoise_channel(np.ascontiguousarray(channels[..., c]), λ, tolerance, max_iterations)
        for c, λ in enumerate(weights)
    ]
    gap = max(result.gap for result in solved)
    return TotalVariationResult(
        image=np.stack([result.image for result in solved], axis=-1).reshape(values.shape),
        iterations=max(result.iterations for result in solved),
        gap=gap,
        converged=gap <= tolerance,
    )


def _checked_image(image: ArrayLike) -> Array:
    values = np.asarray(image)
    if not np.issubdtype(values.dtype, np.floating):
        raise TypeError(f"image is of type {values.dtype}: convert it to floating point")
    if values.ndim not in (2, 3) or values.size == 0:
        raise ValueError(
            f"image has shape {values.shape}: give (rows, columns) or (rows, columns, channels)"
        )
    if not np.isfinite(values).all():
        raise ValueError("image holds NaN or infinity: replace those values first")
    return values.astype(np.float64)


def _weight_of_each_channel(weight: ArrayLike, image: Array) -> list[float]:
    channels = image.shape[2:]
    weights = np.asarray(weight, dtype=np.float64)
    if weights.shape not in ((), channels):
        raise ValueError(
            f"weight has shape {weights.shape} for an image of shape {image.shape}: "
            "give one number, or one for each channel"
        )
    if not (weights >= 0).all():
        raise ValueError(f"weight is {weights}: give a number that is not negative")
    return [float(λ) for λ in np.broadcast_to(weights, channels).ravel()]


def _denoise_channel(
    image: Array, weight: float, tolerance: float, max_iterations: int
) -> TotalVariationResult:
    """Shift and scale one channel to mean 0 and peak 1, where no sum can over- or underflow."""
    if np.ptp(image) == 0:
        return TotalVariationResult(image, 0, 0.0, True)
    mean = image.mean()
    deviation = image - mean
    peak = float(np.abs(deviation).max())
    deviation /= peak
    bound = weight / peak / 2
    if 4 * bound < np.finfo(np.float64).eps:  # |f − g| = |div q| ≤ 4τ: g itself, to rounding
        return TotalVariationResult(image, 0, 0.0, True)
    if bound >= _flattening_bound(deviation):
        return TotalVariationResult(np.full_like(image, mean), 0, 0.0, True)
    denoised, iterations, gap = _minimize(deviation, bound, tolerance, max_iterations)
    return TotalVariationResult(mean + peak * denoised, iterations, gap, gap <= tolerance)


def _flattening_bound(deviation: Array) -> float:
    """Return a τ from which on the minimizer is the mean, for an image of mean zero.

    Any field q with div q = −g makes f = g + div q = 0 optimal for τ ≥ max|q| (Meyer's G-norm is
    the least such τ). Up to its sign, this q carries each row's deviations along the row, and what
    its mean leaves over down the rows.
    """
    row_means = deviation.mean(axis=1, keepdims=True)
    across = np.cumsum(deviation - row_means, axis=1)
    down = np.cumsum(row_means, axis=0)
    return float(np.hypot(across, down).max())


@_compiled
def _minimize(
    image: Array, bound: float, tolerance: float, max_iterations: int
) -> tuple[Array, int, float]:
    """FGP with restart: the minimizer of ½‖f − g‖₂² + τ‖f‖_TV, iterations and relative gap."""
    rows, columns = image.shape
    dual = np.zeros((2, rows + 1, columns + 1))
    extrapolated = np.zeros_like(dual)
    denoised = np.empty((rows + 1, columns + 1))
    t = 1.0
    gap, objective = math.inf, 1.0
    iteration = 0
    while iteration < max_iterations and gap > tolerance * objective:
        iteration += 1
        t_next = (1 + math.sqrt(1 + 4 * t * t)) / 2
        uphill = _descend(image, bound, (t - 1) / t_next, dual, extrapolated, denoised)
        t = t_next
        if uphill > 0:
            extrapolated[:] = dual
            t = 1.0
        if iteration % _GAP_INTERVAL == 0 or iteration == max_iterations:
            gap, objective = _objectives(image, bound, dual, denoised)
    return denoised[:rows, :columns].copy(), iteration, gap / objective


@_compiled
def _apply_dual(image: Array, dual: Array, primal: Array) -> None:
    """Set f = g + div q."""
    rows, columns = image.shape
    for i in range(rows):
        for j in range(columns):
            primal[i, j] = (
                image[i, j]
                + (dual[0, i + 1, j + 1] - dual[0, i, j + 1])
                + (dual[1, i + 1, j + 1] - dual[1, i + 1, j])
            )
        primal[i, columns] = primal[i, columns - 1]
    primal[rows] = primal[rows - 1]


@_compiled
def _descend(
    image: Array, bound: float, momentum: float, dual: Array, extrapolated: Array, primal: Array
) -> float:
    """Take one step, q ← Π(r + ∇(g + div r)/8) and r ← q + momentum · (change of q).

    Π shortens what is longer than τ. Returns ⟨r − q, change of q⟩, positive where the momentum
    points uphill.
    """
    rows, columns = image.shape
    _apply_dual(image, extrapolated, primal)
    uphill = 0.0
    for i in range(rows):
        for j in range(columns):
            k, m = i + 1, j + 1
            down = extrapolated[0, k, m] + _STEP * (primal[k, j] - primal[i, j])
            across = extrapolated[1, k, m] + _STEP * (primal[i, m] - primal[i, j])
            shrink = bound / max(bound, math.sqrt(down * down + across * across))
            down *= shrink
            across *= shrink
            change_down = down - dual[0, k, m]
            change_across = across - dual[1, k, m]
            uphill += (extrapolated[0, k, m] - down) * change_down
            uphill += (extrapolated[1, k, m] - across) * change_across
            dual[0, k, m] = down
            dual[1, k, m] = across
            extrapolated[0, k, m] = down + momentum * change_down
            extrapolated[1, k, m] = across + momentum * change_across
    return uphill


@_compiled
def _objectives(image: Array, bound: float, dual: Array, primal: Array) -> tuple[float, float]:
    """Return the duality gap and the primal objective at f = g + div q, which is set."""
    rows, columns = image.shape
    _apply_dual(image, dual, primal)
    gap = 0.0
    objective = 0.0
    for i in range(rows):
        for j in range(columns):
            down = primal[i + 1, j] - primal[i, j]
            across = primal[i, j + 1] - primal[i, j]
            variation = bound * math.sqrt(down * down + across * across)
            gap += variation - down * dual[0, i + 1, j + 1] - across * dual[1, i + 1, j + 1]
            objective += variation + (primal[i, j] - image[i, j]) ** 2 / 2
    return max(gap, 0.0), objective
