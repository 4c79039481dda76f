"""The numbers that the paper states in Sec. 2, 3.1 and 3.3, beside what this package finds."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.report import Claim, Section, Verdict
from experiments.setting import FREE_OF_NOISE, SNR, Setting
from periscopy_sim.evaluation.design import Diagnostics, condition_number, residual_background
from periscopy_sim.model.transport_operator import RANK_TOLERANCE

Array = NDArray[np.float64]
Matrix = NDArray[np.float32]

FINE_STEP = 0.375
"""Metres between the lights of a finer grid: half the paper's."""

COMBINATIONS = 256
"""Of the finer grid's responses, several times the dimension of their numerical range."""

SBR = 0.5


def run(setting: Setting) -> Section:
    """Diagnose the chair scene and compare."""
    scenario, B = setting.scenario, setting.B
    A = ps.render_transport(scenario, seed=setting.seed, **FREE_OF_NOISE)
    found = ps.diagnose(A, B, scenario.photograph_shape, scenario.hidden_shape)
    return Section(
        name="numbers",
        title="Numbers of Sec. 2, 3.1 and 3.3",
        text=f"Of range(B), {found.background_rank} dimensions are kept: singular values above "
        f"{RANK_TOLERANCE:.0e} of the largest, B's columns scaled to norm 1. A has "
        f"{FREE_OF_NOISE['samples']} shadow rays an entry at the midpoints of their strata: it is "
        "free of Monte Carlo noise.",
        claims=[
            *_conditioning(setting, A, found),
            *_subspaces(found),
            _residual(A, B, found),
            _finer_grid(setting),
        ],
    )


def _conditioning(setting: Setting, A: Matrix, found: Diagnostics) -> Sequence[Claim]:
    shape = setting.scenario.photograph_shape
    within = condition_number(np.diff(A.reshape(*shape, -1), axis=0).reshape(-1, A.shape[1]))
    noisy = condition_number(setting.A)
    return (
        Claim(
            "cond(A)",
            "about 7960",
            f"{found.condition_A:.0f}",
            Verdict.of(0.9 < found.condition_A / 7960 < 1.1),
            "The published code of [15] applies the monitor's angular falloff upside down, which "
            "conditions A better; here it is the right way up. Random shadow rays, 16 an entry, "
            f"give {noisy:.0f}: their noise lifts the smallest singular values.",
        ),
        Claim(
            "cond(D A)",
            "about 270",
            f"{found.condition_DA:.0f}; {within:.0f} without wrapping",
            Verdict.of(0.9 < found.condition_DA / 270 < 1.1),
            "As for A. The published D also takes differences across the ends of the photograph's "
            "columns; without those D A is better conditioned.",
        ),
    )


def _subspaces(found: Diagnostics) -> Sequence[Claim]:
    worst = float((found.bounds / found.bounds_without_background).max())
    return (
        Claim(
            "angle between range(A) and range(B)",
            "89.989°",
            f"largest {found.largest_angle:.3f}°, smallest {found.smallest_angle:.3f}°",
            Verdict.of(abs(found.largest_angle - 89.989) < 0.005),
            "The stated angle is the largest principal angle, which depends on the rank kept of B. "
            "The smallest tells how nearly some hidden image looks like background: the two ranges "
            "are far from orthogonal.",
        ),
        Claim(
            "P A against I, largest entry of the difference",
            "P A ≈ I",
            f"{found.identity_error:.1e}",
            Verdict.of(found.identity_error < 1e-6),
        ),
        Claim(
            "summed Cramér-Rao bounds, A alone over [A, B]",
            "1.0001, nearly identical",
            f"{found.bound_ratio:.5f}",
            Verdict.of(abs(found.bound_ratio - 1) < 1e-2),
            "At most 1 in exact arithmetic, since further unknowns cannot lower a bound: the "
            "paper's excess is rounding. No patch's standard error grows by more than "
            f"{100 * (worst - 1):.1f} %.",
        ),
    )


def _residual(A: Matrix, B: Array, found: Diagnostics) -> Claim:
    strict = ps.form_preconditioner(A, B, rank_tolerance=1e-14)
    least = 100 * float(residual_background(strict, B).mean())
    return Claim(
        "mean residual background, 100/M Σ ‖P B_i‖ / ‖B_i‖",
        "below 5e-13 %",
        f"{found.residual_background:.1e} % of ‖P‖; {least:.1e} % at tolerance 1e-14",
        Verdict.of(found.residual_background < 5e-13),
        "The residual follows the tolerance on B's singular values. It is divided by ‖P‖, since P "
        "carries the units of 1/A; the paper does not give the unit of its A.",
    )


def _finer_grid(setting: Setting) -> Claim:
    scenario, truth = setting.scenario, setting.measured.truth
    B = ps.point_light_backgrounds(scenario, ps.paper_grid(FINE_STEP))
    B /= np.linalg.norm(B, axis=0)
    outside = np.linalg.norm(setting.preconditioned.preconditioner.project_out(B), axis=0)
    # Random combinations span the same range, which has far fewer dimensions (Halko et al. 2011).
    rng = np.random.default_rng(setting.seed)
    combined = B @ rng.normal(size=(B.shape[1], COMBINATIONS))
    finer = ps.Periscope.for_scene(scenario, setting.A, combined)
    composites = [
        ps.composite(setting.measured.signal, background, SBR)
        for background in setting.backgrounds().values()
    ]
    photographs = [ps.add_noise(y, SNR, setting.seed + k) for k, y in enumerate(composites)]
    coarse_error, fine_error = (
        np.mean([ps.mean_squared_error(method.reconstruct(y), truth) for y in photographs])
        for method in (setting.preconditioned, finer)
    )
    return Claim(
        f"a grid of {100 * FINE_STEP:g} cm: mean squared error",
        "not significantly better",
        f"{fine_error:.5f}, against {coarse_error:.5f} at 75 cm",
        Verdict.of(bool(abs(fine_error / coarse_error - 1) < 0.05)),
        f"Mean over {len(photographs)} realistic backgrounds at SBR {SBR}. At most "
        f"{outside.max():.0e} of the response of any of the {B.shape[1]} lights lies outside the "
        "range kept of the paper's B.",
    )
