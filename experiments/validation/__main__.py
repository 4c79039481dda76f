"""Prove the rendering against closed forms and the path tracer, P against pseudoinverses.

`python -m experiments.validation --out DIR [--only photograph,columns,...]` prints one block for
each check and writes `validation.json`. Where two sides must agree the block says how closely, and
the command exits with 1 if any does not.
"""

import json
from collections.abc import Callable, Iterable, Sequence
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
from periscopy_sim.storage.outputs import staged_file

Array = NDArray[np.float64]
SCENES = ("chair", "plate", "plant")
HIDDEN = (29, 36)


def excess(first: Array, second: Array) -> dict[str, float]:
    """Compare two estimates, each (seeds, rows, columns, 3), of the same picture.

    Return ``mean_ratio`` of the two means; ``deviation``, the root mean square difference of the
    two means over the root mean square picture; ``expected``, the same from the scatter of the
    seeds on both sides; ``excess``, the ratio of the two squares, 1 up to ``excess_error`` (its
    standard error over the pixels) where only Monte Carlo error tells them apart.
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


def averaged(scene: Scenario, seeds: int) -> list[Array]:
    """Render A, averaged over 4 x 4 points a pixel, with several seeds."""
    fine = scene.averaged(4)
    matrices = (ps.render_transport(fine, samples=4, seed=seed) for seed in range(seeds))
    return [A.astype(np.float64) for A in matrices]


def against_path_tracer(
    scene: Scenario, f: Array, matrices: Sequence[Array], seeds: range, samples: int = 4096
) -> dict[str, float]:
    """Compare A f, f (R, C, 3), with photographs that Mitsuba's path tracer takes."""
    shape = (*scene.photograph_shape, 3)
    through_A = [(A @ f.reshape(-1, 3) * scene.channel_gain).reshape(shape) for A in matrices]
    traced = [
        ps.render_photograph(scene, f, samples=samples, bounces=1, seed=seed) for seed in seeds
    ]
    return excess(np.stack(through_A), np.stack(traced))


def check_photograph() -> dict[str, Any]:
    """Compare A f, averaged over 4 x 4 points a pixel, with a path-traced photograph."""
    result: dict[str, Any] = {}
    f = ps.read_hidden_image(ps.find_image("sunset"), HIDDEN)
    for name in SCENES:
        scene = ps.load_scenario(name, HIDDEN)
        found = against_path_tracer(scene, f, averaged(scene, 4), range(100, 108))
        # Mitsuba's path tracer lifts its shadow rays 0.2 mm off the wall, A's start on it: that
        # moves the edges of shadows by 0.03 % of the picture.
        allowed = float(np.hypot(1.05 * found["expected"], 5e-4))
        off_scale = abs(found.pop("mean_ratio") - 1)
        result[name] = {
            **found,
            "deviation": within(found["deviation"], allowed),
            "off scale": within(off_scale, 1e-4),
        }
    return result


def check_columns(count: int = 20) -> dict[str, Any]:
    """Compare random columns of A with a path-traced photograph of that patch alone."""
    rng = np.random.default_rng(1)
    result = {}
    for name in SCENES:
        scene = ps.load_scenario(name, HIDDEN)
        matrices, columns = averaged(scene, 3), []
        for patch in rng.choice(scene.transport_shape[1], count, replace=False):
            f = np.zeros((*HIDDEN, 3))
            f[np.unravel_index(patch, HIDDEN)] = 1
            columns.append(against_path_tracer(scene, f, matrices, range(200, 203), 1024))
        excesses = [column["excess"] for column in columns]
        off_scale = max(abs(column["mean_ratio"] - 1) for column in columns)
        result[name] = {
            "columns": count,
            "largest off scale": within(off_scale, 2e-3),
            "excess, median": within(float(np.median(excesses)), 1.5),
            "excess, largest": max(excesses),
        }
    return result


def check_point_light() -> dict[str, Any]:
    """Compare a point emitter on a diffuse wall, seen orthographically, with Eq. 4."""
    view, to = ps.load_scenario("chair", HIDDEN).view, mi.ScalarTransform4f()
    center = view.centers.mean(axis=0)
    lights = center + ps.paper_grid()[np.random.default_rng(2).choice(512, 8)] * [1, -1, 1]
    look = to.look_at((center - [0, 0.05, 0]).tolist(), center.tolist(), [0, 0, 1])
    film = {"type": "hdrfilm", "width": 126, "height": 126, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "camera": {
            "type": "orthographic", "id": "camera", "near_clip": 0.001, "film": film,
            "to_world": look @ to.scale([0.2005, 0.2005, 1]), "sampler": {"type": "multijitter"},
        },
        "wall": {
            "type": "rectangle",
            "to_world": to.translate(center.tolist()) @ to.rotate([1, 0, 0], 90),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
        },
    }  # fmt: skip
    worst = 0.0
    for light in lights:
        intensity = {"type": "rgb", "value": float(np.pi)}
        lamp = {"type": "point", "position": light.tolist(), "intensity": intensity}
        lit = mi.load_dict({**scene, "light": lamp})
        rendered = path_trace(lit, 2, samples=256, seed=0).mean(axis=2).ravel()
        ψ = ps.point_light_response(light[None], view.centers, view.center_normals)[:, 0]
        worst = max(worst, float(np.abs(rendered / ψ - 1).max()))
    return {"lights": len(lights), "largest relative difference": within(worst, 2e-4)}


def check_analytic() -> dict[str, Any]:
    """Compare rendered and analytic A, midpoint rule, 100 samples a patch."""

    def both(name: str, **parameters: float) -> tuple[Array, Array]:
        scene = ps.load_scenario(name, HIDDEN, parameters)
        A = ps.render_transport(scene, samples=100, strata="midpoint")
        return A.astype(np.float64), ps.analytic_transport(scene)

    result = {}
    for name in ("chair", "plate"):
        rendered, analytic = both(name)
        difference = np.linalg.norm(rendered - analytic) / np.linalg.norm(analytic)
        rendered, analytic = both(name, occluder_dz=-5)
        result[name] = {
            "Frobenius, with occluder": within(float(difference), 1e-2),
            "largest relative, occluder away": within(
                float(np.abs(rendered / analytic - 1).max()), 1e-4
            ),
        }
    return result


CHECKS: dict[str, Callable[[], dict[str, Any]]] = {
    "photograph": check_photograph,
    "columns": check_columns,
    "point-light": check_point_light,
    "analytic": check_analytic,
    "preconditioner": solver.check_preconditioner,
    "standard-errors": coverage.check_standard_errors,
}


def main(
    out: Annotated[Path, typer.Option(help="Folder for validation.json.")],
    only: Annotated[str, typer.Option(help=f"Checks, by comma: {', '.join(CHECKS)}.")] = "",
) -> None:
    """Run the checks and print what each found."""
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
