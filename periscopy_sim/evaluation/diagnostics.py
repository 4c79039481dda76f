"""The paper's diagnostics of a scene: condition numbers, angles between subspaces, bounds."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from periscopy_sim.hidden import Hidden, Size
from periscopy_sim.model.ambient import RANK_TOLERANCE
from periscopy_sim.model.fit import Fit
from periscopy_sim.model.transport_operator import as_array
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.numerics.validation import checked_scene
from periscopy_sim.photograph import Photograph
from periscopy_sim.reconstruction.baselines.differencing import neighbour_differences
from periscopy_sim.reconstruction.preconditioned.preconditioner import (
    Preconditioner,
    form_preconditioner,
)
from periscopy_sim.rendering.transport.bounced import channels_mean
from periscopy_sim.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """The paper's figures of a scene (Sec. 2 and 3.3)."""

    condition_A: float  # cond(A)
    condition_DA: float  # cond(D A), D the differences of neighbouring entries of the photograph
    background_rank: int  # dimension kept of range(B)
    # Principal angles between range(A) and the range kept of B, in degrees. The largest is what
    # MATLAB's `subspace` gives; the smallest says how much information the background costs.
    largest_angle: float
    smallest_angle: float
    identity_error: float  # largest entry of |P A − I|
    residual_background: float  # mean over B's columns of 100 ‖P B_i‖ / (‖P‖ ‖B_i‖), in percent
    bound_ratio: float  # summed Cramér-Rao bounds with A alone over those with [A, B]; at most 1
    bounds: Array  # (R, C) Cramér-Rao bound on a patch's standard deviation for unit pixel noise
    bounds_without_background: Array  # (R, C) the same with A alone


def diagnose(
    A: Image,
    B: Image,
    photograph_shape: tuple[int, int],
    hidden: Hidden | Size,
    *,
    photograph: Photograph | None = None,
    rank_tolerance: float = RANK_TOLERANCE,
) -> Diagnostics:
    """Compute the paper's figures for one scene.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds.
    photograph_shape
        (rows, columns) with the product M.
    hidden
        The hidden surfaces of the N patches, or the size (R, C) of one.
    photograph
        A photograph, of which the mask and the photographs with the monitor off count: these are
        further columns of B. None for everywhere and none.
    rank_tolerance
        Relative tolerance on B's singular values.

    Raises
    ------
    ValueError
        If the shapes do not fit, the mask leaves fewer pixels than patches, or A has not full
        column rank beside B.
    """
    surfaces = Hidden.of(hidden)
    fit = Fit(A, B, hidden=surfaces, photograph_shape=photograph_shape, conditions=photograph)
    mask = None if photograph is None else photograph.mask
    used, B = as_array(fit.rows), fit.used(fit.whole_background)
    P = form_preconditioner(used, B, rank_tolerance=rank_tolerance)
    alone = form_preconditioner(used)
    A, matrix = P.A, P.matrix()
    angles = np.rad2deg(linalg.subspace_angles(A, P.Q)) if P.Q.shape[1] else np.array([90.0])
    return Diagnostics(
        condition_A=condition_number(A),
        condition_DA=condition_number(neighbour_differences(A, photograph_shape, mask=mask)),
        background_rank=P.Q.shape[1],
        largest_angle=float(angles.max()),
        smallest_angle=float(angles.min()),
        identity_error=float(np.abs(matrix @ A - np.eye(A.shape[1])).max()),
        residual_background=100 * float(residual_background(P, B).sum() / max(B.shape[1], 1)),
        bound_ratio=float(alone.noise_gain.sum() / P.noise_gain.sum()),
        bounds=surfaces.image(np.sqrt(P.noise_gain)),
        bounds_without_background=surfaces.image(np.sqrt(alone.noise_gain)),
    )


def analyze(
    scenario: Scenario,
    *,
    mask: Mask | None = None,
    monitor_off: Mapping[str, Array] | None = None,
    rank_tolerance: float = RANK_TOLERANCE,
) -> tuple[Diagnostics, Photograph]:
    """Return the paper's figures of a scene, and the photograph of a white screen.

    Rays, where A needs them, are those of a quadrature: the noise of random ones would count as
    information. The pixels of the mask count, and photographs with the monitor off, by name, are
    further columns of B. Errors are those of `diagnose` and of `Scenario.transport`.
    """
    checked_scene(scenario)
    scenario = replace(scenario, light=replace(scenario.light, strata="gauss"))
    A, off = channels_mean(scenario.transport()), monitor_off or {}
    white = A.sum(axis=1).reshape(*scenario.photograph_shape, 1)
    channels = next(iter(off.values()), white)
    wall = Photograph(np.broadcast_to(white, channels.shape), mask, off)
    found = diagnose(
        np.asarray(A), scenario.B, wall.values.shape[:2], scenario.hidden, photograph=wall,
        rank_tolerance=rank_tolerance,
    )  # fmt: skip
    return found, wall


def condition_number(A: Image) -> float:
    """Ratio of the largest to the smallest singular value of an (M, N) matrix."""
    # The triangular factor has the same singular values at N/M of the cost.
    R = linalg.qr(np.asarray(A, np.float64), mode="r", check_finite=False)[0]
    σ = linalg.svdvals(R[: A.shape[1]])
    return float(σ[0] / σ[-1]) if σ[-1] > 0 else float("inf")


def residual_background(P: Preconditioner, B: Image) -> Array:
    """Return the residual of each prototype background: ‖P B_i‖ / (‖P‖ ‖B_i‖), (L,).

    P carries the units of 1/A, its spectral norm too: ‖P‖ = 1 / σ_min(A⊥), from its Cholesky
    factor. A column of zeros gives 0.
    """
    norms = np.linalg.norm(B, axis=0)
    residual = np.linalg.norm(P.apply(B), axis=0) / np.where(norms > 0, norms, 1)
    return np.asarray(residual * linalg.svdvals(P.cholesky)[-1])
