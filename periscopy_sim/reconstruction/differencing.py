"""The method of [15] (Eq. 2 and 3): least squares of neighbouring pixels' differences.

References
----------
[15] Saunders, Murray-Bruce, Goyal, "Computational periscopy with an ordinary digital camera",
Nature, 2019.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.fit import Evidence
from periscopy_sim.model.spectral_basis import SpectralBasis
from periscopy_sim.numerics import Array, Image, Mask, validation
from periscopy_sim.reconstruction.method import Precision, Solution, StillMethod, of_all
from periscopy_sim.reconstruction.penalized_likelihood import Objective, Schedule
from periscopy_sim.reconstruction.preconditioned import Preconditioner, form_preconditioner


def neighbour_differences(
    A: NDArray[Precision],
    photograph_shape: tuple[int, int],
    mask: Mask | None = None,
) -> NDArray[Precision]:
    """Apply the D of Eq. 3 to the rows of A, (M, N), or to one photograph, (M,); row-major.

    The published code of [15] vectorizes the photograph by columns, so that neighbours lie one
    below the other, takes differences across the ends of columns too, and keeps the last pixel as
    it is: its D is square, (M, M), and the last row lets the background through. D A is in
    column-major order.

    With a mask, flat or (rows, columns), A has the M' rows used alone. A difference then counts if
    both its pixels are used, and the last pixel if it is; only the rows that count are returned.
    """
    rows, columns = photograph_shape
    if mask is not None:
        whole = np.zeros((rows * columns, *A.shape[1:]), A.dtype)
        whole[np.ravel(mask)] = A
        differences = neighbour_differences(whole, photograph_shape)
        unused = np.where(mask, 0, np.nan).ravel()
        counted = np.isfinite(neighbour_differences(unused, photograph_shape))
        return np.compress(counted, differences, axis=0)
    differences = A.reshape(rows, columns, *A.shape[1:]).swapaxes(0, 1).reshape(A.shape).copy()
    differences[:-1] = differences[1:] - differences[:-1]
    return differences


class NormalEquations(NamedTuple):
    """‖D(A f − y)‖² of C channels, fᵀG f − 2 hᵀf and a constant; and start, noise and level."""

    gram: Array  # (N, N) G = (D A)ᵀD A
    right: Array  # (N, C) h = (D A)ᵀD y
    start: Array  # (N, C) the minimum, G⁻¹ h
    noise: Array  # (C,) of the differenced photograph: what D A cannot explain of it
    level: Array  # (C,) root mean square of D y


@dataclass(frozen=True, eq=False, repr=False)
class DifferencingResult(Solution[np.float64]):
    """A hidden image by differencing; the noise is that of the differenced photograph."""

    iterations: NDArray[np.int64]  # (channels,)
    residual: Array  # (channels,) as in `NoiseAwareReconstruction`

    def numbers(self) -> dict[str, Any]:
        """Return the noise, the weights and the iterations."""
        return {**super().numbers(), "iterations": self.iterations}


class Differencing(StillMethod[np.float64]):
    """The method of [15]: f̂ = argmin_f ‖D(A f − y)‖² + λ‖f‖_TV for each channel (Eq. 2).

    λ follows the photograph: it is `tv_weight` σ ‖D A‖_F / √N, with σ the noise of the differenced
    photograph, estimated from what D A cannot explain of it. So λ is `tv_weight` standard
    deviations of what noise adds to an entry of (D A)ᵀD y, and neither exposure nor albedo nor
    units need tuning. The weights that [15] chose by hand for each image are of that size.

    Each channel is a problem of its own, solved by the noise-aware method's steps with D A in the
    place of A⊥. The published code stops before the minimum: `experiments.paper.as_published`.

    Parameters
    ----------
    B
        (M, L) prototype backgrounds, for the residual alone; None for none.
    photograph_shape
        (rows, columns) of photographs; the method must know it, or get `Photograph`s. In one with
        a mask a difference counts only if both its pixels are used, see `neighbour_differences`.
    tv_weight
        λ in standard deviations of what noise adds to an entry of (D A)ᵀD y, as above.
    tolerance, max_iterations
        As of `NoiseAware`.
    A, **scene
        As of `StillMethod`, whose other errors it raises, too.

    Raises
    ------
    ValueError
        If the mask leaves fewer differences than patches, or D A has not full column rank.
    """

    def __init__(
        self,
        A: Image,
        B: Image | None = None,
        *,
        tv_weight: float = 1.0,
        tolerance: float = 1e-4,
        max_iterations: int = 10_000,
        **scene: Any,
    ) -> None:
        super().__init__(A, B, **scene)
        validation.checked_number(tv_weight, "tv_weight", 0)
        validation.check_stopping(tolerance, max_iterations)
        self.tv_weight = tv_weight
        self.tolerance, self.max_iterations = tolerance, max_iterations

    def _differenced(self, values: Image) -> Any:
        """Return D of values, (M', K), in the pixels used."""
        shape = self.fit.shape
        if shape is None:
            raise validation.InputError("differencing needs photograph_shape, (rows, columns)")
        return neighbour_differences(values, shape, mask=self.fit.mask)

    @cached_property
    def _inverse(self) -> Preconditioner:
        """The pseudoinverse of D A, photographs with the monitor off projected out."""
        DA = self._differenced(np.asarray(self.fit.rows, np.float64))
        patches = self.hidden.patches
        if self.fit.mask is not None and len(DA) < patches:
            raise validation.InputError(
                f"the mask leaves {len(DA)} differences of neighbouring pixels for {patches} "
                "patches: leave out less of the wall, or use fewer patches"
            )
        return form_preconditioner(DA, self._differenced(self.fit.monitor_off_columns))

    @cached_property
    def _gram(self) -> Array:
        R = self._inverse.cholesky
        return np.asarray(R.T @ R)

    @cached_property
    def _unit(self) -> float:
        """‖D A‖_F/√N."""
        return float(np.sqrt(np.trace(self._gram) / len(self._gram)))

    def prepare(self) -> None:
        """Form the pseudoinverse of D A; see `StillMethod`."""
        _ = self._unit, self._objective

    def equations(self, photograph: Image) -> NormalEquations:
        """Return the least squares of a photograph, (rows, columns, C) or (M, C)."""
        Dy = self._inverse.project_out(self._differenced(self.fit.vectors(photograph)))
        h = self._inverse.A.T @ Dy
        start = self._inverse.solve(h)
        noise = self._inverse.noise(*(np.ascontiguousarray(each.T) for each in (Dy, start)))
        return NormalEquations(self._gram, h, start, noise, np.sqrt(np.mean(Dy**2, axis=0)))

    @of_all
    def solve(self, photograph: Image) -> DifferencingResult:
        """Recover the hidden image, with the state of the iterations; see `reconstruct`."""
        _, h, start, noise, level = self.equations(photograph)
        weight = self.tv_weight * noise * self._unit
        images, ends = list(start.T), [(0, 0.0)] * len(noise)
        for channel in np.flatnonzero(weight).tolist():  # not of a black one
            solved = self._minimum(h[:, channel], noise[channel], float(level[channel]))
            images[channel], ends[channel] = solved
        iterations, residual = (np.array(each) for each in zip(*ends, strict=True))
        error = float(residual.max())
        validation.warn_unconverged("differencing", iterations.max(), error, self.tolerance)
        image = self.hidden.image(np.stack([each.ravel() for each in images], axis=1))
        return DifferencingResult(image, noise, weight, iterations, residual)

    @cached_property
    def _objective(self) -> Objective:
        patterns = SpectralBasis.of_gram(self._gram / self._unit**2, self.hidden)
        weight = self.tv_weight / np.sqrt(len(self._gram))
        return Objective(patterns, self.hidden, np.eye(1), weight, positive=False)

    def _minimum(self, h: Array, noise: float, level: float) -> tuple[Array, tuple[int, float]]:
        """Return a channel's image that minimizes Eq. 2, its iterations and residual."""
        coefficients = self._objective.basis.rows @ h / (level * self._unit)
        evidence = Evidence(coefficients[None], np.array([noise / level]), level, 0.0)
        minimum = self._objective.minimize(evidence, Schedule(self.tolerance, self.max_iterations))
        image = minimum.image.astype(np.float64) * (level / self._unit)
        return image, (minimum.iterations, minimum.residual)
