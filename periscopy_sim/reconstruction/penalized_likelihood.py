"""The minimization behind `noise_aware`, for one photograph or for a frame of a video.

    f̂ = argmin_{f ≥ 0} ½ Σ_c w_c ‖A⊥ Σ_k M_ck f_k − y⊥_c‖² + λ Σ ‖∇f‖ [+ λ₂ Σ ‖f − f_prev‖]

with w_c = σ²/σ_c², in units in which A⊥ᵀA⊥ has a mean diagonal of 1, and M a colour matrix that
keeps the norm of grey. The sums are over the patches; their norms are over the colours too. The
last term, in a video, is Eq. 12's, of the patches' colours: a patch keeps what it showed in the
frame before, or changes in all its channels.

The misfit couples the primaries by MᵀWM = V diag(p) Vᵀ, W = diag(w), but not the channels Vᵀf.

It is solved by the alternating direction method of multipliers (Boyd et al. 2011, Sec. 3) with
u = ∇f and v = f split off; `spectral_basis` solves each iteration's equations. With the scaled
multipliers p and q (ibid., Sec. 3.1.1), an iteration after f has been solved for is, x̃ the
over-relaxed f (ibid., Sec. 3.4.3),

    u ← shrink(∇x̃ + p, λ/ρ),   p ← p + ∇x̃ − u;     v ← max(x̃ + q, 0),   q ← q + x̃ − v.

In a video v is drawn towards the frame before it, by Σ‖v − v_prev‖ over the patches' colours.
"""

import math
import sys
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.fit import Evidence
from periscopy_sim.model.spectral_basis import Solver, SpectralBasis
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.products import compiled_reordered

Image = NDArray[Any]

RELAXATION = 1.8

AXES = 2
"""Directions of differences; the compiler unrolls a loop over a constant."""

BISECTIONS = -int(np.finfo(np.float32).negep)
"""Halvings after which single precision has no more digits."""


class Splitting(NamedTuple):
    """The split variables of C channels, in single precision; `advance` changes them in place."""

    u: Image  # (2, C, N) the gradient, down and across
    p: Image  # (2, C, N) its multiplier over ρ
    v: Image  # (C, N) the image
    q: Image  # (C, N) its multiplier over ρ

    @classmethod
    def zeros(cls, shape: tuple[int, ...]) -> "Splitting":
        """Return the start from a black image, (C, N)."""
        shapes = [(2, *shape)] * 2 + [shape] * 2
        return cls(*(np.zeros(each, np.float32) for each in shapes))

    def scaled(self, image: float, multiplier: float) -> "Splitting":
        """Return the split with the image's parts and the multipliers over ρ scaled."""
        primal, dual = np.float32(image), np.float32(multiplier)
        return Splitting(primal * self.u, dual * self.p, primal * self.v, dual * self.q)


class Penalties(NamedTuple):
    """The terms beside the misfit, over ρ."""

    threshold: float  # λ/ρ of total variation
    positive: bool  # whether v ≥ 0
    pull: float = 0.0  # λ₂/ρ of the distance to the frame before


class Residuals(NamedTuple):
    """The sums of squares that an iteration's residuals are made of."""

    gap: float  # ‖(∇f − u, f − v)‖², of the split variables before the iteration
    change: float  # of (u, v)
    image: float  # ‖(∇f, f)‖²
    split: float  # ‖(u, v)‖²

    def largest(self, black: float = 0.0) -> float:
        """Return the larger of the relative primal and dual residuals.

        The primal one is the root of the gap over the larger of the image and the split, the dual
        one is in proportion to the root of the change over the split. None is over less than
        `black`, the norm of an image that counts as black: such an image could not be distinguished
        from its own rounding.
        """
        gap, change, image, split = map(math.sqrt, self)
        least = max(black, sys.float_info.min)
        return max(gap / max(image, split, least), change / max(split, least))


@compiled_reordered
def right_hand_side(split: Splitting, following: NDArray[np.uintp]) -> Image:
    """Return ∇ᵀ(u − p) + v − q, (C, N); `following`, (2, N), are that of `Differences`."""
    u, p, v, q = split
    channels, patches = v.shape
    g = v - q
    for axis in range(AXES):
        for c in range(channels):
            for n in range(patches):
                value = u[axis, c, n] - p[axis, c, n]
                g[c, n] -= value
                g[c, following[axis, n]] += value
    return g


@compiled_reordered
def advance(
    f: Image,
    split: Splitting,
    following: NDArray[np.uintp],
    penalties: Penalties,
    previous: Image | None,
) -> Residuals:
    """Update u, v, p and q in place from a new f, (C, N), in single precision.

    The frame before, (C, N), is of single precision too, and ≥ 0 where v is; None for a still.
    """
    u, p, v, q = split
    channels, patches = v.shape
    zero, α = f.dtype.type(0), f.dtype.type(RELAXATION)
    rest, κ = f.dtype.type(1) - α, f.dtype.type(penalties.threshold)
    moved = np.empty((AXES, channels), f.dtype)
    target, kept = np.empty(channels, f.dtype), np.empty(channels, f.dtype)
    gap = change = image = size = 0.0
    for n in range(patches):
        squared = zero
        for c in range(channels):
            for axis in range(AXES):
                slope = f[c, following[axis, n]] - f[c, n]
                image += slope * slope
                gap += (slope - u[axis, c, n]) ** 2
                moved[axis, c] = α * slope + rest * u[axis, c, n] + p[axis, c, n]
                squared += moved[axis, c] ** 2
        length = math.sqrt(squared)
        shrink = max(length - κ, zero) / length if length > 0 else zero
        for c in range(channels):
            for axis in range(AXES):
                new = shrink * moved[axis, c]
                change += (new - u[axis, c, n]) ** 2
                size += new * new
                p[axis, c, n] = moved[axis, c] - new
                u[axis, c, n] = new
            image += f[c, n] ** 2
            gap += (f[c, n] - v[c, n]) ** 2
            target[c] = α * f[c, n] + rest * v[c, n] + q[c, n]
            kept[c] = max(target[c], zero) if penalties.positive else target[c]
        if previous is not None:
            pull = f.dtype.type(penalties.pull)
            _approach(target, previous[:, n], pull, penalties.positive, kept)
        for c in range(channels):
            change += (kept[c] - v[c, n]) ** 2
            size += kept[c] * kept[c]
            q[c, n] = target[c] - kept[c]
            v[c, n] = kept[c]
    return Residuals(gap, change, image, size)


@compiled_reordered
def _approach(target: Image, previous: Image, pull: float, positive: bool, kept: Image) -> None:
    """Set v = argmin ½‖v − target‖² + pull ‖v − previous‖, over v ≥ 0 where that is asked for.

    With d = ‖v − previous‖, v is max(0, t + s (previous − t)), s = pull/(d + pull): in closed form
    as long as nothing is cut off, and otherwise with the one d that agrees with its v.
    """
    zero = target.dtype.type(0)
    squared = zero
    for c in range(len(target)):
        # Black before and to be darker yet: it stays black, which need not be searched for.
        kept[c] = max(target[c], zero) if positive and previous[c] == 0 else target[c]
        squared += (kept[c] - previous[c]) ** 2
    distance = max(math.sqrt(squared) - pull, zero)
    least = zero  # of v over the sum of distance and pull; below zero, something is cut off
    for c in range(len(target)):
        least = min(least, distance * kept[c] + pull * previous[c])
    if positive and least < 0:
        near, far = zero, distance
        for _ in range(BISECTIONS):
            distance = (near + far) / 2
            share = distance / (distance + pull)
            squared = zero
            for c in range(len(target)):
                squared += min(share * (previous[c] - kept[c]), previous[c]) ** 2
            if squared > distance * distance:
                near = distance
            else:
                far = distance
    share = pull / (distance + pull) if distance > 0 else zero
    for c in range(len(target)):
        # Not from the frame before, which may be so bright that the rest is lost in rounding.
        value = kept[c] + share * (previous[c] - kept[c]) if distance > 0 else previous[c]
        kept[c] = max(value, zero) if positive else value


RIDGE = 0.01
"""Weight of K beside A⊥ᵀA⊥ in the image that sets the scale."""

WEAK, RENEWED = 0.1, 10
"""Part of ρ below which a pattern's curvature is weak, as that of most patterns, and iterations
between two sums of weak patterns. The iterations stay as many and take a third of the time."""

BLACK = 1e-3
"""Over the image's scale, root mean square: an image so dark is black."""


@dataclass(frozen=True)
class Schedule:
    """Parameters of the splitting and of its stop by relative residuals (Boyd et al., Sec. 3.3)."""

    tolerance: float  # largest residual that counts as converged
    max_iterations: int
    # λ/ρ over the image's scale: of 0.1 to 0.4, 0.2 needed the fewest iterations from black.
    penalty: float = 0.2


@dataclass(frozen=True, eq=False)
class Minimum:
    """The result of the iterations.

    The split variables are over the image's scale, their multipliers over λ.
    """

    image: Image  # (C, N) in single precision
    split: Splitting | None  # None of a photograph that shows nothing
    iterations: int
    residual: float  # the larger of the relative primal and dual one


@dataclass(frozen=True, eq=False)
class Objective:
    """The objective of one scene, for any photograph."""

    basis: SpectralBasis  # of A⊥ᵀA⊥, its mean diagonal 1
    hidden: Hidden
    mixing: Array  # (3, 3) M, from the monitor's primaries to the camera's channels; (1, 1) of one
    regularization: float  # λ over √N σ/2
    positive: bool  # whether f ≥ 0

    def minimize(
        self,
        evidence: Evidence,
        schedule: Schedule,
        start: Splitting | None = None,
        previous: Image | None = None,
        l1_weight: float = 0.0,
    ) -> Minimum:
        """Return the minimizer that the splitting finds from a `Minimum`'s split, or from black.

        With the frame before, `previous`, (C, N), ≥ 0 where f is, the weight of the distance to
        it is λ₂ = `l1_weight` λ.
        """
        σ = evidence.mean_noise
        λ = self.regularization * np.sqrt(self.hidden.patches) * σ / 2
        w = (σ / evidence.noise) ** 2
        p, V = np.linalg.eigh((self.mixing.T * w) @ self.mixing)
        to_channels = V.T @ (self.mixing.T * w)
        data = to_channels @ evidence.coefficients
        rest = None if evidence.rest is None else to_channels @ evidence.rest
        ridge = self.basis.combined(data / (p[:, None] * self.basis.curvatures + RIDGE))
        scale = float(np.sqrt(np.mean(ridge**2)))
        if not scale > 0:
            return Minimum(np.zeros(ridge.shape, np.float32), None, 0, 0.0)
        threshold = schedule.penalty * scale
        ρ = λ / threshold
        solve = Solver(self.basis, p[:, None], ρ, data, WEAK, rest)
        V = V.astype(np.float32)
        drawn_to = None
        if previous is not None and l1_weight > 0:
            drawn_to = np.ascontiguousarray(previous, np.float32)
        split = start.scaled(scale, threshold) if start else Splitting.zeros(ridge.shape)
        following = self.hidden.differences.following.astype(np.uintp)
        penalties = Penalties(threshold, self.positive, l1_weight * threshold)
        black = BLACK * scale * float(np.sqrt(split.v.size))
        residual, iteration = np.inf, 0
        while residual > schedule.tolerance and iteration < schedule.max_iterations:
            g = right_hand_side(split, following)
            f = V @ solve(V.T @ g, renew=iteration % RENEWED == 0)
            iteration += 1
            residual = advance(f, split, following, penalties, drawn_to).largest(black)
        return Minimum(split.v, split.scaled(1 / scale, 1 / threshold), iteration, residual)
