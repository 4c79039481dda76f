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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.model.fit import Evidence
from periscopy_sim.model.spectral_basis import Solver, SpectralBasis
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.compilation import compiled_reordered

Image = NDArray[Any]

RELAXATION = 1.8

BISECTIONS = 24
"""Halvings after which single precision has no more digits."""


@dataclass(frozen=True, eq=False)
class Splitting:
    """The split variables, which `advance` changes in place."""

    u: Image  # (2, 3, R, C) the gradient, down and across
    p: Image  # (2, 3, R, C) its multiplier over ρ
    v: Image  # (3, R, C) the image
    q: Image  # (3, R, C) its multiplier over ρ

    @classmethod
    def zeros(cls, shape: tuple[int, ...]) -> "Splitting":
        """Return the start from a black image, (3, R, C), in single precision."""
        shapes = [(2, *shape)] * 2 + [shape] * 2
        return cls(*(np.zeros(each, np.float32) for each in shapes))

    def scaled(self, image: float, multiplier: float) -> "Splitting":
        """Return the split with the image's parts and the multipliers over ρ scaled."""
        primal, dual = np.float32(image), np.float32(multiplier)
        return Splitting(primal * self.u, dual * self.p, primal * self.v, dual * self.q)


def advance(
    f: Image,
    split: Splitting,
    threshold: float,
    positive: bool,
    previous: Image | None = None,
    pull: float = 0.0,
    black: float = 0.0,
) -> float:
    """Update u, v, p and q of a split in place from a new f, and return the larger residual.

    f and the frame before, if any, are (3, R, C) in single precision, the latter ≥ 0 where v is.
    The threshold is λ/ρ, `pull` the weight of the distance to that frame over ρ. The residuals are
    the primal ‖(∇f − u, f − v)‖ over the larger of ‖(∇f, f)‖ and ‖(u, v)‖, and the change of (u, v)
    over ‖(u, v)‖, to which the dual one is in proportion. None is over less than `black`, the norm
    of an image that counts as black: one that becomes so would never be told from its own rounding.
    """
    fields = split.u, split.p, split.v, split.q
    sums = _advance(f, *fields, threshold, positive, previous, pull, RELAXATION)
    gap, change, size, split_size = (math.sqrt(value) for value in sums)
    least = max(black, sys.float_info.min)
    return max(gap / max(size, split_size, least), change / max(split_size, least))


@compiled_reordered
def _right_hand_side(u: Image, p: Image, v: Image, q: Image) -> Image:
    """Return ∇ᵀ(u − p) + v − q, (3, R C)."""
    channels, rows, columns = v.shape
    g = np.empty_like(v)
    for c in range(channels):
        for i in range(rows):
            for j in range(columns):
                value = v[c, i, j] - q[c, i, j]
                if i < rows - 1:
                    value -= u[0, c, i, j] - p[0, c, i, j]
                if i > 0:
                    value += u[0, c, i - 1, j] - p[0, c, i - 1, j]
                if j < columns - 1:
                    value -= u[1, c, i, j] - p[1, c, i, j]
                if j > 0:
                    value += u[1, c, i, j - 1] - p[1, c, i, j - 1]
                g[c, i, j] = value
    return g.reshape(channels, -1)


@compiled_reordered
def _advance(
    f: Image,
    u: Image,
    p: Image,
    v: Image,
    q: Image,
    threshold: float,
    positive: bool,
    previous: Image | None,
    pull: float,
    relaxation: float,
) -> tuple[float, float, float, float]:
    channels, rows, columns = f.shape
    α, κ = f.dtype.type(relaxation), f.dtype.type(threshold)
    rest = f.dtype.type(1) - α
    moved = np.empty((2, channels), f.dtype)
    target, kept = np.empty(channels, f.dtype), np.empty(channels, f.dtype)
    gap = change = size = split_size = 0.0
    for i in range(rows):
        for j in range(columns):
            squared = f.dtype.type(0)
            for c in range(channels):
                here = f[c, i, j]
                down = f[c, i + 1, j] - here if i < rows - 1 else f.dtype.type(0)
                across = f[c, i, j + 1] - here if j < columns - 1 else f.dtype.type(0)
                size += down * down + across * across + here * here
                gap += (down - u[0, c, i, j]) ** 2 + (across - u[1, c, i, j]) ** 2
                moved[0, c] = α * down + rest * u[0, c, i, j] + p[0, c, i, j]
                moved[1, c] = α * across + rest * u[1, c, i, j] + p[1, c, i, j]
                squared += moved[0, c] ** 2 + moved[1, c] ** 2
            length = math.sqrt(squared)
            shrink = max(length - κ, f.dtype.type(0)) / length if length > 0 else f.dtype.type(0)
            for c in range(channels):
                for axis in range(2):
                    new = shrink * moved[axis, c]
                    change += (new - u[axis, c, i, j]) ** 2
                    split_size += new * new
                    p[axis, c, i, j] = moved[axis, c] - new
                    u[axis, c, i, j] = new
                here = f[c, i, j]
                gap += (here - v[c, i, j]) ** 2
                target[c] = α * here + rest * v[c, i, j] + q[c, i, j]
                kept[c] = max(target[c], f.dtype.type(0)) if positive else target[c]
            if previous is not None:
                _approach(target, previous[:, i, j], f.dtype.type(pull), positive, kept)
            for c in range(channels):
                change += (kept[c] - v[c, i, j]) ** 2
                split_size += kept[c] * kept[c]
                q[c, i, j] = target[c] - kept[c]
                v[c, i, j] = kept[c]
    return gap, change, size, split_size


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
    if positive and _is_cut_off(kept, previous, distance, pull):
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


@compiled_reordered
def _is_cut_off(target: Image, previous: Image, distance: float, pull: float) -> bool:
    least = target.dtype.type(0)
    for c in range(len(target)):
        least = min(least, distance * target[c] + pull * previous[c])
    return bool(least < 0)


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

    image: Image  # (3, R, C) in single precision; of one channel (1, R, C)
    split: Splitting | None  # None of a photograph that shows nothing
    iterations: int
    residual: float  # the larger of the relative primal and dual one


@dataclass(frozen=True, eq=False)
class Objective:
    """The objective of one scene, for any photograph."""

    basis: SpectralBasis  # of A⊥ᵀA⊥, its mean diagonal 1
    hidden_shape: tuple[int, int]  # (R, C)
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

        With the frame before, `previous`, (3, R, C), ≥ 0 where f is, the weight of the distance to
        it is λ₂ = `l1_weight` λ.
        """
        σ = evidence.mean_noise
        λ = self.regularization * np.sqrt(len(self.basis.rows)) * σ / 2
        w = (σ / evidence.noise) ** 2
        p, V = np.linalg.eigh((self.mixing.T * w) @ self.mixing)
        data = V.T @ (self.mixing.T * w) @ evidence.coefficients
        ridge = self.basis.combined(data / (p[:, None] * self.basis.curvatures + RIDGE))
        scale = float(np.sqrt(np.mean(ridge**2)))
        if not scale > 0:
            return Minimum(np.zeros((len(p), *self.hidden_shape), np.float32), None, 0, 0.0)
        threshold = schedule.penalty * scale
        ρ = λ / threshold
        solve = Solver(self.basis, p[:, None], ρ, data, WEAK)
        V = V.astype(np.float32)
        drawn_to = None
        if previous is not None and l1_weight > 0:
            drawn_to = np.ascontiguousarray(previous, np.float32)
        shape = len(p), *self.hidden_shape
        split = start.scaled(scale, threshold) if start else Splitting.zeros(shape)
        pull = l1_weight * threshold
        black = BLACK * scale * float(np.sqrt(split.v.size))
        residual, iteration = np.inf, 0
        while residual > schedule.tolerance and iteration < schedule.max_iterations:
            g = _right_hand_side(split.u, split.p, split.v, split.q)
            f = V @ solve(V.T @ g, renew=iteration % RENEWED == 0)
            iteration += 1
            image = f.reshape(split.v.shape)
            residual = advance(image, split, threshold, self.positive, drawn_to, pull, black)
        return Minimum(split.v, split.scaled(1 / scale, 1 / threshold), iteration, residual)
