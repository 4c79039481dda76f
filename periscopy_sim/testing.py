"""Checks for whoever adds an operator, a derivative or a proximal operator.

Each check raises an AssertionError that says what is wrong and by how much, so that it serves in
any test. Random numbers come from an explicit seed.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from periscopy_sim.numerics import Array

Map: TypeAlias = Callable[[Any], Any]

NAMES = ("matvec", "rmatvec"), ("matmat", "rmatmat"), ("forward", "adjoint")
"""Names of a product and of its adjoint; ``matmat`` and ``rmatmat`` get two vectors at once."""


def adjoint_test(
    operator: Any,
    shapes: tuple[tuple[int, ...], tuple[int, ...]] | None = None,
    *,
    seed: int = 0,
    rtol: float = 1e-6,
    convert: Map = np.asarray,
) -> None:
    """Check that ⟨A x, y⟩ = ⟨x, Aᵀ y⟩ for random x and y.

    Parameters
    ----------
    operator
        Anything with ``matvec`` and ``rmatvec``, with ``matmat`` and ``rmatmat``, or with
        ``forward`` and ``adjoint``; or a pair of such functions. If an operator has several
        pairs, as SciPy's have, the check includes vectors and matrices.
    shapes
        Shapes of x and of y; None for those of ``operator.shape``, (M, N).
    seed
        Seed of the random x and y, which are normal.
    rtol
        Largest difference of the two products over ‖A x‖ ‖y‖ + ‖x‖ ‖Aᵀ y‖. Give 1e-12 for an
        operator in double precision.
    convert
        Turns the float64 arrays into what the operator takes, such as ``torch.from_numpy``.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.sparse.linalg import aslinearoperator
    >>> adjoint_test(aslinearoperator(np.arange(6.0).reshape(2, 3)))
    >>> adjoint_test((np.cumsum, np.cumsum), ((5,), (5,)))
    Traceback (most recent call last):
    ...
    AssertionError: adjoint: <A x, y> = -0.139611, but <x, A^T y> = 1.35418
    """
    rng = np.random.default_rng(seed)
    if shapes is None:
        rows, columns = operator.shape
        shapes = (columns,), (rows,)
    for name, forward, backward in _products(operator):
        more = (2,) if name == "rmatmat" else ()
        x, y = (rng.standard_normal((*shape, *more)) for shape in shapes)
        there, back = (np.asarray(f(convert(v))) for f, v in ((forward, x), (backward, y)))
        for what, v, w in (("A x", there, y), ("A^T y", back, x)):
            assert v.shape == w.shape, f"{name}: {what} has shape {v.shape} instead of {w.shape}"
        ahead, behind = float(np.vdot(there, y)), float(np.vdot(x, back))
        norm = np.linalg.norm
        scale = float(norm(there) * norm(y) + norm(x) * norm(back))
        assert abs(ahead - behind) <= rtol * scale, (
            f"{name}: <A x, y> = {ahead:.6g}, but <x, A^T y> = {behind:.6g}"
        )


def _products(operator: Any) -> list[tuple[str, Map, Map]]:
    """Return the name of an adjoint, the product and the adjoint, of each pair to be checked."""
    if isinstance(operator, tuple):
        return [("adjoint", *operator)]
    pairs = [pair for pair in NAMES if all(hasattr(operator, name) for name in pair)]
    assert pairs, f"{type(operator).__name__} has none of the pairs {NAMES}"
    return [(back, getattr(operator, name), getattr(operator, back)) for name, back in pairs]


def derivative_test(
    function: Map,
    derivatives: ArrayLike,
    point: ArrayLike,
    *,
    steps: ArrayLike = 1e-3,
    rtol: float = 1e-4,
    atol: float = 0.0,
) -> None:
    """Check derivatives against central differences, extrapolated to a step of zero.

    Differences D(h) and D(h/2) make (4 D(h/2) − D(h)) / 3, whose error falls as h⁴. It serves to
    1e-4 of functions in double precision, and of functions in single precision where the steps
    change them by far more than their rounding.

    Parameters
    ----------
    function
        From points, (P,), to a number or to an array of any shape.
    derivatives
        (P, ...) its derivatives at the point, each of the shape of the function's value; of a
        number the gradient, (P,).
    point
        (P,) where they are taken.
    steps
        h: (P,), or one for all. Too small ones show rounding, too large ones the fifth derivative.
    rtol, atol
        Largest error of a derivative: a fraction of its norm, and a number added to that. The
        message says how far the differences by h and by h/2 are apart, as a fraction: where they
        are, other steps may be needed.

    Examples
    --------
    >>> import numpy as np
    >>> derivative_test(lambda x: np.sum(x**3), [3.0, 12.0], [1.0, 2.0])
    >>> derivative_test(lambda x: np.sum(x**3), [3.0, 11.0], [1.0, 2.0])
    Traceback (most recent call last):
    ...
    AssertionError: derivative 1 is off by 1, 0.083 of its norm (steps 0.001, half: 6.2e-08 apart)
    """
    place, slopes = np.asarray(point, np.float64), np.asarray(derivatives, np.float64)
    assert len(slopes) == len(place), f"{len(slopes)} derivatives by {len(place)} numbers"

    def difference(k: int, step: float) -> Array:
        aside = step * np.eye(len(place))[k]
        ahead, behind = (np.asarray(function(place + s * aside), np.float64) for s in (1, -1))
        return np.asarray((ahead - behind) / (2 * step))

    for k, step in enumerate(np.broadcast_to(np.asarray(steps, np.float64), place.shape)):
        wide, narrow = difference(k, step), difference(k, step / 2)
        numeric = (4 * narrow - wide) / 3
        assert slopes[k].shape == numeric.shape, (
            f"derivative {k} has shape {slopes[k].shape}, the function's value {numeric.shape}"
        )
        size, error = float(np.linalg.norm(numeric)), float(np.linalg.norm(slopes[k] - numeric))
        apart = float(np.linalg.norm(wide - narrow)) / (size or 1.0)
        assert error <= rtol * size + atol, (
            f"derivative {k} is off by {error:.3g}, {error / (size or 1.0):.2g} of its norm "
            f"(steps {step:.3g}, half: {apart:.1e} apart)"
        )


def prox_oracle(
    prox: Map,
    objective: Callable[[Array, Array], float],
    point: ArrayLike,
    *,
    lower: float = -np.inf,
    seed: int = 0,
    rtol: float = 1e-6,
) -> None:
    """Check that a proximal operator minimizes its objective, by brute force.

    No image may have a lower objective: neither the solution changed at random, patch by patch,
    by a factor or towards the point, nor the end of a general minimizer (SciPy's L-BFGS-B by
    differences) that starts from either. It serves convex objectives of up to some 100 numbers.

    Parameters
    ----------
    prox
        From a point to the solution, of the same shape.
    objective
        Function of an image and the point, to be minimized over images.
    point
        Where the proximal operator is taken: an image, say.
    lower
        Least value of an image, such as 0; the solution must not fall below.
    seed
        Seed of the random changes.
    rtol
        How much lower an objective may be, as a fraction of the solution's.

    Examples
    --------
    >>> import numpy as np
    >>> def objective(f, g):
    ...     return np.sum((f - g) ** 2) / 2 + np.sum(np.abs(f))
    >>> g = np.array([3.0, -0.2, 0.7])
    >>> prox_oracle(lambda g: np.sign(g) * np.maximum(np.abs(g) - 1, 0), objective, g)
    >>> prox_oracle(lambda g: np.maximum(g - 0.5, 0), objective, g)
    Traceback (most recent call last):
    ...
    AssertionError: the objective of the result is 2.97, of a general minimizer's end 2.765
    """
    from scipy.optimize import minimize

    g = np.asarray(point, np.float64)
    solution = np.asarray(prox(point), np.float64)
    assert solution.shape == g.shape, f"the result has shape {solution.shape} instead of {g.shape}"
    assert solution.min() >= lower, f"the result falls to {solution.min():.3g}, below {lower}"

    def value(f: Array) -> float:
        return float(objective(f.reshape(g.shape), g))

    bounds = [(None if np.isinf(lower) else lower, None)] * g.size
    others = [("a general minimizer's end", minimize(value, start.ravel(), bounds=bounds).x)
              for start in (solution, np.maximum(g, lower))]  # fmt: skip
    others += [("the point", g), ("the point's mean", np.full_like(g, g.mean()))]
    rng, scale = np.random.default_rng(seed), float(np.abs(g).max()) or 1.0
    changes = [*np.eye(g.size), *rng.standard_normal((20, g.size)), (solution - g).ravel()]
    others += [
        ("the result after a small change", solution.ravel() + sign * size * scale * change)
        for change in (*changes, solution.ravel())
        for size in (1e-1, 1e-3)
        for sign in (-1, 1)
    ]
    least = value(solution)
    for name, other in others:
        reached = value(np.maximum(other, lower))
        assert least <= reached + rtol * abs(least), (
            f"the objective of the result is {least:.6g}, of {name} {reached:.6g}"
        )
