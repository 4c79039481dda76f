"""Checks of the solver against oracles, and its times; run by `experiments.validation`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.timing import median_seconds
from periscopy_sim.evaluation.diagnostics import residual_background
from periscopy_sim.hidden import Hidden

Array = NDArray[np.float64]
HIDDEN = (29, 36)


def within(value: float, limit: float) -> dict[str, Any]:
    """State a value beside the largest it may be."""
    return {"value": value, "limit": limit, "ok": bool(value <= limit)}


def check_preconditioner() -> dict[str, Any]:
    """Compare P at tolerance 1e-10 with pseudoinverses of [A, s Q] and of [A, B]."""
    scene = ps.load_scenario(ps.find_scene("chair"), HIDDEN)
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


def check_prox() -> dict[str, Any]:
    """Compare the prox of total variation with brute force and scikit-image."""
    from scipy import optimize
    from skimage.restoration import denoise_tv_chambolle

    rng = np.random.default_rng(0)
    small = rng.random((5, 6))
    weight = 0.4
    rows, columns = (np.vstack([np.diff(np.eye(n), axis=0), np.zeros(n)]) for n in small.shape)
    down, across = np.kron(rows, np.eye(len(columns))), np.kron(np.eye(len(rows)), columns)

    def smoothed(x: Array, ε: float) -> tuple[float, Array]:
        misfit, dx, dy = x - small.ravel(), down @ x, across @ x
        length = np.sqrt(dx**2 + dy**2 + ε**2)
        slope = 2 * misfit + weight * (down.T @ (dx / length) + across.T @ (dy / length))
        return float((misfit**2).sum() + weight * length.sum()), slope

    x = small.ravel()
    for ε in 10.0 ** -np.arange(1, 9):
        x = optimize.minimize(
            smoothed, x, (ε,), "L-BFGS-B", jac=True, options={"maxiter": 20000, "ftol": 1e-16}
        ).x
    exact = ps.prox_total_variation(small, weight, tolerance=1e-10)

    differences = Hidden.of(small.shape).differences

    def objective(image: Array) -> float:
        variation = differences.norms(image.ravel()).sum()
        return float(((image - small) ** 2).sum() + weight * variation)

    large = rng.random((29, 36))
    ours = ps.prox_total_variation(large, weight, tolerance=1e-8)
    # scikit-image minimizes ½‖f − g‖² + w TV.
    theirs = denoise_tv_chambolle(large, weight=weight / 2, eps=1e-15, max_num_iter=100_000)
    return {
        "objective above the brute-force minimum, relative": within(
            objective(exact) / objective(x.reshape(small.shape)) - 1, 1e-8
        ),
        "largest difference from brute force": within(float(np.abs(exact.ravel() - x).max()), 1e-5),
        "largest difference from scikit-image": within(float(np.abs(ours - theirs).max()), 1e-3),
    }


def check_times(runs: int = 7) -> dict[str, Any]:
    """Time A, forming P against pinv, one reconstruction against P.sum(); medians of one run."""
    scene = ps.load_scenario(ps.find_scene("chair"), HIDDEN)
    render = median_seconds(lambda: ps.render_transport(scene, samples=36), runs)
    A = ps.render_transport(scene, samples=36).astype(np.float64)
    B = ps.point_light_backgrounds(scene)
    form = median_seconds(lambda: ps.form_preconditioner(A, B), runs)
    explicit = median_seconds(lambda: ps.form_preconditioner(A, B).matrix(), 3)
    pseudoinverse = median_seconds(lambda: np.linalg.pinv(np.hstack([A, B])), 3)
    periscope = ps.Periscope(A, B, hidden=HIDDEN)
    f = ps.read_hidden_image(ps.find_image("mushroom"), HIDDEN)
    y = ps.add_noise((A @ f.reshape(-1, 3)).reshape(*scene.photograph_shape, 3), 60, 0)
    reconstruct = median_seconds(lambda: periscope.reconstruct(y), 10 * runs)
    P = periscope.preconditioner.matrix().astype(np.float32)
    bytes_pass = median_seconds(lambda: P.sum(), 10 * runs)
    return {
        "A at 36 samples a patch, seconds": render,
        "shadow rays per second": A.size * 36 / render,
        "forming P factored, seconds": form,
        "forming P explicitly, seconds": explicit,
        "numpy.linalg.pinv([A, B]), seconds": pseudoinverse,
        "factored over pinv": within(form / pseudoinverse, 1 / 4),
        "pinv over explicit": pseudoinverse / explicit,
        "one reconstruction, seconds": reconstruct,
        "P.sum() of the float32 P, seconds": bytes_pass,
        "reconstruction over P.sum()": reconstruct / bytes_pass,
    }


def _relative(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))
