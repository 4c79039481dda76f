"""The opacities of a mask's cells that explain a photograph best, whatever the hidden image.

    J(m) = E(A(m)) / 2 + β Σ_{k~l} |m_k − m_l|,   0 ≤ m ≤ 1,

E the evidence of a photograph with the image integrated out (`evidence`), the sum over cells that
share a side: of two masks that explain a photograph alike, the one with the shorter outline is the
likelier (Ising's model, with opacities between 0 and 1 on the way). Descent is Gauss and Newton's
after Levenberg and Marquardt: the photograph is linear in m for a given image, and what the image
could follow is projected out (variable projection).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from periscopy_sim.calibration.explanation.evidence import Explanation
from periscopy_sim.calibration.explanation.overdispersion import overdispersion
from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel
from periscopy_sim.calibration.silhouette.cell_shadows import CellShadows
from periscopy_sim.calibration.silhouette.mask_plane import MaskPlane
from periscopy_sim.scenario import Array

OUTLINE = 1.0
"""β, of half the evidence: at Ising's critical 0.88 islands of any size are as likely."""

CENTERED = 1.0
"""Of half the evidence."""

ROUNDED = 0.05
"""Differences of opacities below which their penalty is quadratic."""

DAMPING = 1e-3
"""The first: part of the information that is added to it."""

TRIALS = 6
"""Steps tried, each shorter, before a point is called the best."""

NOTHING = np.zeros(0)
"""Values of a level whose scene has no parameters that vary."""


@dataclass(frozen=True, eq=False)
class MaskFit:
    """Opacities of a mask's cells, (rows, columns), and what they explain."""

    opacities: Array
    explanation: Explanation
    objective: float

    @property
    def opaque(self) -> NDArray[np.bool_]:
        """(rows, columns) whether cells are opaque rather than not."""
        return np.asarray(self.opacities > 0.5 * self.opacities.max())


@dataclass(frozen=True, eq=False)
class MaskLevel:
    """A photograph at one resolution, explained by a mask of (rows, columns) of cells.

    The level's scene is without the mask.
    """

    level: ResolutionLevel
    shadows: CellShadows
    cells: tuple[int, int]

    @classmethod
    def of(cls, level: ResolutionLevel, plane: MaskPlane, cells: tuple[int, int]) -> Self:
        """Return that of a mask in a plane."""
        A, scenario = level.matrix(NOTHING), level.scenario(NOTHING)
        return cls(level, CellShadows.of(A, scenario, plane, cells, level.used), cells)

    def explain(self, opacities: Array) -> MaskFit:
        """Explain the photograph by opacities, (rows, columns)."""
        found = self.level.explained_by(self.shadows.matrix(opacities.ravel()), NOTHING)
        return MaskFit(opacities, found, found.evidence / 2 + improbability(opacities)[0])

    def learned(self, found: Explanation) -> Self:
        """Return the same level with what an explanation tells beside the mask.

        That is the wall's unevenness, the gain over it, and how strong its errors are.
        """
        level = self.level.evened(found).gained(found)
        κ = overdispersion(found, level.used, level.seed)
        return replace(self, level=level.overdispersed(κ))


def improbability(opacities: Array) -> tuple[float, Array]:
    """Return how improbable a mask, (rows, columns), is before the photograph, and the gradient."""
    length, gradient = _outline(opacities)
    total = OUTLINE * length
    gradient = OUTLINE * gradient
    off = cost_of_place(opacities.shape)
    total += float(np.sum(off * opacities))
    gradient += off
    S1, S2 = float(opacities.sum()), float(np.sum(opacities**2)) + 1e-9
    ratio = S1 / S2
    return total * ratio, gradient * ratio + total * (1 / S2 - 2 * opacities * S1 / S2**2)


def cost_of_place(shape: tuple[int, ...]) -> Array:
    """Return what an opaque cell costs where it is, (rows, columns): most at the border."""
    y, x = (np.abs((np.arange(n) + 0.5) / n * 2 - 1) for n in shape)
    return np.asarray(CENTERED * np.maximum(y[:, None], x) ** 2)


def _outline(opacities: Array) -> tuple[float, Array]:
    """Return the sum of what neighbours differ by, (rows, columns), rounded, and its gradient."""
    total, gradient = 0.0, np.zeros_like(opacities)
    for axis in (0, 1):
        step = np.diff(opacities, axis=axis)
        size = np.sqrt(step**2 + ROUNDED**2)
        total += float((size - ROUNDED).sum())
        slope = step / size
        after = [(1, 0), (0, 0)] if axis == 0 else [(0, 0), (1, 0)]
        before = [(0, 1), (0, 0)] if axis == 0 else [(0, 0), (0, 1)]
        gradient += np.pad(slope, after) - np.pad(slope, before)
    return total, gradient


def descend(
    level: MaskLevel,
    start: Array,
    iterations: int,
    negligible: float = 0.5,
    visit: Callable[[MaskFit], None] = lambda _: None,
) -> MaskFit:
    """Walk downhill from opacities, (rows, columns), at most so many steps."""
    here, damping = level.explain(start), DAMPING
    for _ in range(iterations):
        visit(here)
        g, H = linearized(level, here)
        gain = 0.0
        for _ in range(TRIALS):
            moved = _step(here.opacities, g, H, damping)
            tried = level.explain(moved / max(moved.max(), 1e-3))
            gain = here.objective - tried.objective
            if gain > 0:
                damping /= 5
                here = tried
                break
            damping *= 10
        if gain < negligible:
            break
    return here


def linearized(level: MaskLevel, here: MaskFit) -> tuple[Array, Array]:
    """Return the gradient, (K,), and the information, (K, K), of half the evidence."""
    found = here.explanation
    g = -level.shadows.along(found.gradient) / 2
    H = found.information(found.moved(level.shadows.held_off(found.images)))
    return g, H


def _step(opacities: Array, g: Array, H: Array, damping: float) -> Array:
    """Return the opacities of least J, its evidence taken as quadratic."""
    shape, m = opacities.shape, opacities.ravel()
    H = H + np.diag(damping * (np.diag(H) + np.diag(H).mean()))

    def objective(tried: Array) -> tuple[float, Array]:
        d = tried - m
        Hd = H @ d
        prior, slope = improbability(tried.reshape(shape))
        return float(g @ d + d @ Hd / 2) + prior, g + Hd + slope.ravel()

    found = minimize(
        objective, m, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(m),
        options={"maxiter": 500, "maxcor": 20},
    )  # fmt: skip
    return np.asarray(found.x).reshape(shape)
