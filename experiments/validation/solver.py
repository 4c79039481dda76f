"""Check of the preconditioner against pseudoinverses; run by `experiments.validation`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from periscopy_sim.evaluation.design import residual_background

Array = NDArray[np.float64]
HIDDEN = (29, 36)


def within(value: float, limit: float) -> dict[str, Any]:
    """State a value beside the largest it may be."""
    return {"value": value, "limit": limit, "ok": bool(value <= limit)}


def check_preconditioner() -> dict[str, Any]:
    """Compare P at tolerance 1e-10 with pseudoinverses of [A, s Q] and of [A, B]."""
    scene = ps.load_scenario("chair", HIDDEN)
    A = ps.render_transport(scene, samples=36).astype(np.float64)
    B = ps.point_light_backgrounds(scene)
    P = ps.form_preconditioner(A, B, rank_tolerance=1e-10)
    rng = np.random.default_rng(0)
    f, e = rng.random((A.shape[1], 3)), rng.random((B.shape[1], 3))
    background = B @ e
    y = A @ f / (A @ f).mean() + background / background.mean()
    f = f / (A @ f).mean()
    s = np.linalg.norm(A) / np.sqrt(P.Q.shape[1])
    oracle = np.linalg.pinv(np.hstack([A, s * P.Q]))[: A.shape[1]]
    plain = np.linalg.pinv(np.hstack([A, B]), rcond=1e-12)[: A.shape[1]]
    noisy = ps.add_noise(y, 60, 1)
    identity = np.eye(A.shape[1])
    return {
        "P y against pinv([A, s Q]), noisy photograph": within(
            _relative(P.apply(noisy), oracle @ noisy), 1e-6
        ),
        "f from A f + B e by P": within(_relative(P.apply(y), f), 1e-6),
        "f from A f + B e by pinv([A, B])": within(_relative(plain @ y, f), 1e-6),
        "largest |P B_i| / (|P| |B_i|)": within(float(residual_background(P, B).max()), 1e-10),
        "largest |P A - I|, P explicit": within(
            float(np.abs(P.matrix() @ A - identity).max()), 1e-8
        ),
        "largest |P A - I|, P factored": within(float(np.abs(P.apply(A) - identity).max()), 1e-8),
    }


def _relative(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))
