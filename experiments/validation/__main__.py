"""Prove the rendering against closed forms and the path tracer, the solver against oracles.

`python -m experiments.validation --out DIR [--only photograph,columns,...]` prints one block for
each check and writes `validation.json`. Where two sides must agree the block says how closely, and
the command exits with 1 if any does not.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.validation import coverage, solver
from experiments.validation.solver import within
from periscopy_sim.rendering.photograph import path_trace
from periscopy_sim.rendering.variant import mi
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]
SCENES = ("chair", "plate", "plant")
HIDDEN = (29, 36)


def excess(first: Array, second: Array) -> dict[str, float]:
    """Compare two estimates, each (seeds, rows, columns, 3), of the same picture.

    Returns
    -------
    dict
        ``mean_ratio`` of the two means; ``deviation``, the root mean square difference of the two
        means over the root mean square picture; ``expected``, the same from the scatter of the
        seeds on both sides; ``excess``, the ratio of the two squares, 1 up to ``excess_error``
        (its standard error over the pixels) where only Monte Carlo error tells them apart.
    """
    a, b = first.mean(axis=0), second.mean(axis=0)
    variance = first.var(axis=0, ddof=1) / len(first) + second.var(axis=0, ddof=1) / len(second)
    squares = ((a - b) ** 2).mean(axis=2).ravel()
    expected = variance.mean(axis=2).ravel()
    ratio = squares.mean() / expected.mean()
    spread = np.std(squares - ratio * expected) / np.sqrt(squares.size) / expected.mean()
    energy = np.mean(b**2)
    return {
        "mean_ratio": float(a.mean() / b.mean()),
        "deviation": float(np.sqrt(squares.mean() / energy)),
        "expected": float(np.sqrt(expected.mean() / energy)),
        "excess": float(ratio),
        "excess_error": float(spread),
    }


def check_photograph() -> dict[str, Any]:
    """Compare A f, averaged over 4 x 4 points a pixel, with a path-traced photograph."""
    result = {}
    for name in SCENES:
        scene = ps.load_scenario(ps.find_scene(name), HIDDEN)
        f = ps.read_hidden_image(ps.find_image("sunset"), HIDDEN)
        through_A = np.stack(
            [
                _picture(ps.render_transport(scene.averaged(4), samples=4, seed=seed), f, scene)
                for seed in range(4)
            ]
        )
        traced = np.stack(
            [ps.render_photograph(scene, f, bounces=1, seed=seed) for seed in range(100, 108)]
        )
        found = excess(through_A, traced)
        # Mitsuba's path tracer lifts its shadow rays 0.2 mm off the wall, A's start on it: that
        # moves the edges of shadows by 0.03 % of the picture.
        allowed = float(np.hypot(1.05 * found["expected"], 5e-4))
        found["deviation"] = within(found["deviation"], allowed)
        found["off scale"] = within(abs(found.pop("mean_ratio") - 1), 1e-4)
        result[name] = found
    return result


def check_columns(count: int = 20) -> dict[str, Any]:
    """Compare random columns of A with a path-traced photograph of that patch alone."""
    rng = np.random.default_rng(1)
    result = {}
    for name in SCENES:
        scene = ps.load_scenario(ps.find_scene(name), HIDDEN)
        chosen = rng.choice(scene.transport_shape[1], count, replace=False)
        matrices = [
            ps.render_transport(scene.averaged(4), samples=4, seed=seed)[:, chosen]
            for seed in range(3)
        ]
        columns = []
        for k, patch in enumerate(chosen):
            f = np.zeros((scene.transport_shape[1], 3))
            f[patch] = 1
            lit = f.reshape(*HIDDEN, 3)
            traced = np.stack(
                [
                    ps.render_photograph(scene, lit, samples=1024, bounces=1, seed=seed)
                    for seed in range(200, 203)
                ]
            )
            through_A = np.stack([_picture(A[:, [k]], np.ones((1, 1, 3)), scene) for A in matrices])
            columns.append(excess(through_A, traced))
        ratios = [column["mean_ratio"] for column in columns]
        excesses = [column["excess"] for column in columns]
        result[name] = {
            "columns": count,
            "largest off scale": within(max(abs(ratio - 1) for ratio in ratios), 2e-3),
            "excess, median": within(float(np.median(excesses)), 1.5),
            "excess, largest": max(excesses),
        }
    return result


def check_point_light() -> dict[str, Any]:
    """Compare a point emitter on a diffuse wall, seen orthographically, with Eq. 4."""
    scene = ps.load_scenario(ps.find_scene("chair"), HIDDEN)
    center = scene.view.centers.mean(axis=0)
    lights = center + ps.paper_grid()[np.random.default_rng(2).choice(512, 8)] * [1, -1, 1]
    worst = 0.0
    for light in lights:
        look = mi.ScalarTransform4f().look_at(
            (center - [0, 0.05, 0]).tolist(), center.tolist(), [0, 0, 1]
        )
        lit = mi.load_dict(
            {
                "type": "scene",
                "camera": {
                    "type": "orthographic",
                    "id": "camera",
                    "near_clip": 0.001,
                    "to_world": look @ mi.ScalarTransform4f().scale([0.2005, 0.2005, 1]),
                    "film": {
                        "type": "hdrfilm",
                        "width": 126,
                        "height": 126,
                        "rfilter": {"type": "box"},
                    },
                    "sampler": {"type": "multijitter"},
                },
                "wall": {
                    "type": "rectangle",
                    "to_world": mi.ScalarTransform4f().translate(center.tolist())
                    @ mi.ScalarTransform4f().rotate([1, 0, 0], 90),
                    "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
                },
                "light": {
                    "type": "point",
                    "position": light.tolist(),
                    "intensity": {"type": "rgb", "value": float(np.pi)},
                },
            }
        )
        rendered = path_trace(lit, 2, samples=256, seed=0).mean(axis=2).ravel()
        view = scene.view
        ψ = ps.point_light_response(light[None], view.centers, view.center_normals)[:, 0]
        worst = max(worst, float(np.abs(rendered / ψ - 1).max()))
    return {"lights": len(lights), "largest relative difference": within(worst, 2e-4)}


def check_analytic() -> dict[str, Any]:
    """Compare rendered and analytic A, midpoint rule, 100 samples a patch."""
    result = {}
    for name in ("chair", "plate"):
        scene = ps.load_scenario(ps.find_scene(name), HIDDEN)
        rendered = ps.render_transport(scene, samples=100, strata="midpoint")
        analytic = ps.analytic_transport(scene)
        far = ps.load_scenario(ps.find_scene(name), HIDDEN, {"occluder_dz": -5})
        open_rendered = ps.render_transport(far, samples=100, strata="midpoint")
        open_analytic = ps.analytic_transport(far)
        difference = np.linalg.norm(rendered - analytic) / np.linalg.norm(analytic)
        away = float(np.abs(open_rendered / open_analytic - 1).max())
        result[name] = {
            "Frobenius, with occluder": within(float(difference), 1e-2),
            "largest relative, occluder away": within(away, 1e-4),
        }
    return result


def _picture(A: NDArray[np.float32], f: Array, scene: Scenario) -> Array:
    y = A.astype(np.float64) @ f.reshape(-1, 3) * scene.channel_gain
    return y.reshape(*scene.photograph_shape, 3)


CHECKS: dict[str, Callable[[], dict[str, Any]]] = {
    "photograph": check_photograph,
    "columns": check_columns,
    "point-light": check_point_light,
    "analytic": check_analytic,
    "preconditioner": solver.check_preconditioner,
    "prox": solver.check_prox,
    "standard-errors": coverage.check_standard_errors,
    "times": solver.check_times,
}


def main(
    out: Annotated[Path, typer.Option(help="Folder for validation.json.")],
    only: Annotated[str, typer.Option(help=f"Checks, by comma: {', '.join(CHECKS)}.")] = "",
) -> None:
    """Run the checks and print what each found."""
    from periscopy_sim.storage.outputs.staging import staged_file

    chosen: Iterable[str] = only.split(",") if only else CHECKS
    unknown = [name for name in chosen if name not in CHECKS]
    if unknown:
        raise typer.BadParameter(f"no check {unknown}; there are {', '.join(CHECKS)}")
    with staged_file(out / "validation.json") as file:
        found, failed = {}, 0
        for name in chosen:
            found[name] = CHECKS[name]()
            print(f"{name}: {(CHECKS[name].__doc__ or '').strip().splitlines()[0]}")
            failed += _show(found[name], 1)
        file.write_text(json.dumps(found, indent=2) + "\n", "utf-8")
    if failed:
        raise SystemExit(f"{failed} checks failed")


def _show(values: dict[str, Any], depth: int) -> int:
    """Print values, and count those beyond their limits."""
    failed = 0
    for key, value in values.items():
        start = "  " * depth + f"{key:48} "
        if isinstance(value, dict) and "ok" in value:
            verdict = "ok" if value["ok"] else "FAIL"
            print(f"{start}{value['value']:.6g}  (at most {value['limit']:.3g}: {verdict})")
            failed += not value["ok"]
        elif isinstance(value, dict):
            print("  " * depth + key)
            failed += _show(value, depth + 1)
        else:
            print(start + (f"{value:.6g}" if isinstance(value, float) else str(value)))
    return failed


if __name__ == "__main__":
    typer.run(main)
