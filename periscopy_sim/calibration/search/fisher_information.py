"""What a photograph tells about the parameters near a point: Fisher information, standard errors.

The slope of the evidence is taken from derivatives of the transport matrix, the information from
how the photograph moves with a parameter beyond what hidden image and light could follow (Gauss and
Newton's approximation; Kaufman, BIT 15, 1975).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values
from periscopy_sim.calibration.prior import Prior
from periscopy_sim.errors import ClosedFormError, SceneError
from periscopy_sim.scenario import Array

Matrix = NDArray[np.floating[Any]]

UNSEEN = 1e-4
"""Part of the information below which a direction of the parameters counts as unknown."""

BLOCKS = 10
"""Along each side of the photograph: what stays unexplained is independent between blocks."""

LARGER = (2, 3)
"""Blocks along each side of a larger one."""


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives by each parameter, each rendered with S = 2 independent sets of rays.

    Hidden image and light could follow nearly all of how the photograph moves. In the little that
    is left the noise of one rendering, multiplied by itself, would pass for information. By areas,
    which have no noise, there is one set, S = 1.
    """

    slopes: Array  # (S, P) of half the evidence
    moved: Array  # (S, P, M, 3) of the photograph over its noise, range(B) projected out
    projected: Array  # (S, P, M, 3) the part of it that the hidden image cannot follow


@dataclass(frozen=True, eq=False)
class Curvature:
    """What the photograph tells about the parameters near one point.

    `slope_errors` are standard errors of the slope, half of how those by two sets of rays differ,
    with the signs of one draw.
    """

    jacobian: Jacobian
    slope: Array  # (P,) derivatives of half the evidence, the prior's penalty in it
    information: Array  # (P, P) Fisher information
    noisy_diagonal: Array  # (P,) of the information with the rendering's noise in it: more than it
    slope_errors: Array  # (P,)
    prior: Prior

    def damped(self, damping: float | Values) -> Array:
        """Return the information, negative eigenvalues (of noise) set to 0, plus damping and prior.

        The damping, of each parameter, is in parts of the information on it.
        """
        scale = self._scale
        values, vectors = np.linalg.eigh(self.information * np.outer(scale, scale))
        seen = (vectors * np.maximum(values, 0)) @ vectors.T + damping * np.eye(len(scale))
        return np.asarray(seen / np.outer(scale, scale) + np.diag(self.prior.precision))

    def invertible(self) -> Array:
        """Return the information and the prior's, (P, P), a little where there is neither."""
        return self.damped(np.where(self.prior.precision > 0, 0.0, UNSEEN))

    @property
    def _scale(self) -> Array:
        """(P,) standard errors of each parameter alone: units in which none is large or small.

        The scene's own unit of one that neither photograph nor ruler knows.
        """
        precision = np.where(self.noisy_diagonal > 0, self.noisy_diagonal, self.prior.precision)
        return 1 / np.sqrt(np.where(precision > 0, precision, 1.0))

    def step(self, damping: float, longest: Values) -> Values:
        """Return Newton's step to where the slope vanishes, shortened to the longest allowed."""
        step = -np.linalg.solve(self.damped(damping), self.slope)
        return np.asarray(step * min(1.0, np.min(longest / np.maximum(np.abs(step), 1e-300))))

    def left_of(self, errors: Array) -> Array:
        """Return what the parameters leave of errors, (M, 3), that `Explanation.left_of` left."""
        directions = self.jacobian.projected.mean(axis=0)
        pull = np.einsum("pmc,mc->p", directions, errors, optimize=True)
        by_parameters = np.linalg.solve(self.invertible(), pull)
        return np.asarray(errors - np.einsum("p,pmc->mc", by_parameters, directions, optimize=True))

    @property
    def predicted_gain(self) -> float:
        """Gain in evidence that the slope predicts for a whole step, undamped."""
        return float(self.slope @ np.linalg.solve(self.invertible(), self.slope))

    def overdispersion(self, partitions: Sequence[Array]) -> float:
        """Return how much more the slope varies than by white noise, from the `block_scores`, or 1.

        It is the mean over what the photograph tells of the parameters, tr(H⁻¹J)/tr(H⁻¹I), by which
        a likelihood is tempered (Ribatet, Cooley and Davison, Statistica Sinica 22, 2012): J is the
        spread of the scores, I the information, H both that and the prior's. The partition into
        blocks with the largest spread counts.
        """
        inverse = np.linalg.inv(self.invertible())
        white = np.trace(inverse @ (self.invertible() - np.diag(self.prior.precision)))
        spreads = [np.trace(inverse @ (scores.T @ scores)) for scores in partitions]
        return max(1.0, float(max(spreads) / white)) if white > 0 else 1.0

    def of(self, some: NDArray[np.bool_]) -> Curvature:
        """Return what the photograph tells of some parameters, (P,), where the others are known."""
        jacobian = Jacobian(*(each[:, some] for each in vars(self.jacobian).values()))
        return Curvature(
            jacobian,
            self.slope[some],
            self.information[np.ix_(some, some)],
            self.noisy_diagonal[some],
            self.slope_errors[some],
            Prior(self.prior.centers[some], self.prior.errors[some]),
        )

    def tempered(self, overdispersion: float) -> Curvature:
        """Return what the photograph tells where it counts for so much less, the prior as it is."""
        κ, ruler = overdispersion, self.slope - self.jacobian.slopes.mean(axis=0)
        jacobian = Jacobian(
            self.jacobian.slopes / κ,
            self.jacobian.moved / np.sqrt(κ),
            self.jacobian.projected / np.sqrt(κ),
        )
        return replace(
            self,
            jacobian=jacobian,
            slope=jacobian.slopes.mean(axis=0) + ruler,
            information=self.information / κ,
            noisy_diagonal=self.noisy_diagonal / κ,
            slope_errors=self.slope_errors / κ,
        )

    def covariance(self, partitions: Sequence[Array]) -> Array:
        """Return the parameters' covariance, (P, P), from the `block_scores`.

        What the model leaves unexplained is no white noise, so its spread is taken from the
        photograph: blocks of pixels are independent, not pixels (the sandwich estimate: White,
        Econometrica 50, 1982). The partition into blocks with the largest spread counts, and none
        below that of white noise. What the rays add is from the errors of the slope. The prior's
        centre errs as its errors say.
        """
        scale = self._scale
        inverse = np.linalg.inv(self.invertible() * np.outer(scale, scale))
        spreads = [(scores * scale).T @ (scores * scale) for scores in partitions]
        ruler = np.diag(self.prior.precision * scale**2)
        white = np.diag(inverse)
        robust = np.max([np.diag(inverse @ (s + ruler) @ inverse) for s in spreads], axis=0)
        growth = np.sqrt(np.maximum(robust / white, 1))
        by_rays = inverse @ (scale * self.slope_errors)
        covariance: Array = inverse * np.outer(growth, growth) + np.outer(by_rays, by_rays)
        return covariance * np.outer(scale, scale)


def differences(level: ResolutionLevel, values: Values, offsets: Array) -> NDArray[np.float32]:
    """Return derivatives of A by each of some parameters, about values of shape (P,).

    (S, K, M, N) by the sets of `Jacobian`. Each row of the offsets, (K, P), moves one parameter to
    either side; where neither is physical, a SceneError is raised.
    """
    if level.by_area:
        with suppress(ClosedFormError):  # an occluder that went behind the monitor, say
            return level.derivatives(values, offsets)[None]
        level = level.by_rays()
    drawn, sets = level.differing(), 2
    changes = np.empty((0, 0, 0, 0), np.float32)
    for s in range(sets):
        for k, offset in enumerate(offsets):
            change = _difference(drawn, values, offset, level.seed + s) / offset.sum()
            if not changes.size:
                changes = np.empty((sets, len(offsets), *change.shape), np.float32)
            changes[s, k] = change
    return changes


def differentiate(explanation: Explanation, changes: NDArray[np.float32]) -> Jacobian:
    """Differentiate photograph and evidence by parameters that change A so, see `differences`."""
    shape = (*changes.shape[:2], *explanation.residuals.shape)
    slopes, moved, projected = np.empty(shape[:2]), np.empty(shape), np.empty(shape)
    for s, by_parameter in enumerate(changes):
        moved[s] = explanation.moved(np.array([explanation.lit(change) for change in by_parameter]))
        projected[s] = explanation.projected(moved[s])
        for p, change in enumerate(by_parameter):
            slopes[s, p] = explanation.slope(change, moved[s, p]) / 2
    return Jacobian(slopes, moved, projected)


def _difference(level: ResolutionLevel, values: Values, offset: Values, seed: int) -> Matrix:
    """Return half the change of A between the sides; all of it where one is not physical."""
    sides = []
    for sign in (1, -1):
        try:
            sides.append((sign, level.matrix(values + sign * offset, seed)))
        except SceneError as error:
            unphysical = error
    if len(sides) == 2:
        return np.asarray((sides[0][1] - sides[1][1]) / 2)
    if not sides:
        raise unphysical
    sign, A = sides[0]
    return np.asarray(sign * (A - level.matrix(values, seed)))


def information(one: Jacobian, other: Jacobian) -> Array:
    """Return the Fisher information on pairs of parameters, (P, K), from products of other rays."""
    forward = np.einsum("imc,jmc->ij", one.projected[0], other.moved[-1])
    backward = np.einsum("imc,jmc->ij", other.projected[0], one.moved[-1])
    return np.asarray((forward + backward.T) / 2)


def curvature(
    level: ResolutionLevel,
    values: Values,
    explanation: Explanation,
    changes: NDArray[np.float32],
) -> Curvature:
    """Return what the photograph tells about all of a level's parameters near some values.

    The explanation is the level's there, the changes of A are those of `differences`.
    """
    jacobian = differentiate(explanation, changes)
    return Curvature(
        jacobian=jacobian,
        slope=jacobian.slopes.mean(axis=0) + level.prior.slope(values),
        information=information(jacobian, jacobian),
        noisy_diagonal=np.mean(
            [
                [np.vdot(*pair) for pair in zip(*by_parameter, strict=True)]
                for by_parameter in zip(jacobian.projected, jacobian.moved, strict=True)
            ],
            axis=0,
        ),
        slope_errors=(jacobian.slopes[0] - jacobian.slopes[-1]) / 2,
        prior=level.prior,
    )


def block_scores(
    level: ResolutionLevel, explanation: Explanation, jacobian: Jacobian
) -> list[Array]:
    """Return what each block of pixels adds to the pull on the parameters, (blocks, P) of each.

    The pull is minus the slope of the misfit.

    The partitions are into squares, into larger squares, rows and columns of them: errors may be
    alike over any. Residuals are those `unabsorbed`: hidden image and light follow errors in a
    block as well; a spread of what they leave, of 50 blocks, would be up to a seventh too small.
    """
    block = blocks(level)
    numbers = np.unique(block)
    scores = np.empty((len(numbers), jacobian.projected.shape[1]))
    for score, number in zip(scores, numbers, strict=True):
        pixels = np.flatnonzero(block == number)
        moved = jacobian.projected[:, :, pixels].mean(axis=0)
        score[:] = np.einsum("imc,mc->i", moved, explanation.unabsorbed(pixels))
    down, across = np.divmod(numbers, BLOCKS)
    larger = [down // size * BLOCKS + across // size for size in LARGER]
    return [scores, *(_summed(scores, group) for group in (*larger, down, across))]


def blocks(level: ResolutionLevel) -> NDArray[np.intp]:
    """Return the number of the block in which each used pixel lies, of `BLOCKS` x `BLOCKS`."""
    rows, columns = np.nonzero(level.used)
    height, width = level.photograph_shape
    return np.asarray((rows * BLOCKS // height) * BLOCKS + columns * BLOCKS // width)


def _summed(scores: Array, group: NDArray[np.intp]) -> Array:
    """Return the sums of the scores, (blocks, P), of each group."""
    return np.array([scores[group == number].sum(axis=0) for number in np.unique(group)])
