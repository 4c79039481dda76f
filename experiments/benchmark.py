"""How fast the package is: ratios to what a user would otherwise use, and to the machine's limits.

`python -m experiments.benchmark --out DIR [--only stills,forming]` writes `index.html`,
`claims.json` and the plot of cost against size. Absolute times belong to one machine; the ratios,
measured in one run, carry over. `--only large` alone takes a quarter of an hour and 7 GB of disk.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments import benchmark_peers as peers
from experiments.drawing import styled
from experiments.machine_limits import Limits, measure_limits, median_seconds
from experiments.moving_scene import clip
from experiments.setting import SNR
from periscopy_sim.evaluation.report import Claim, Section, Table, Verdict, write_page
from periscopy_sim.reconstruction.periscope import repaired
from periscopy_sim.reconstruction.preconditioner import form_preconditioner
from periscopy_sim.reconstruction.total_variation import solve_total_variation
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.output import staged_file
from periscopy_sim.storage.provenance import as_text, provenance

Array = NDArray[np.float64]

SMALL = (29, 36)
FILM = (40, 55)
SIZES = ((29, 36), (43, 54), (58, 72), (72, 90))
SBR = 0.5
FRAMES = 48
PINV_LIMIT = 43 * 54
"""Up to so many patches pinv is timed; beyond, its time follows its cubic growth."""


class Scene:
    """The chair scene at one size, with photographs of a moving scene in its light.

    Parameters
    ----------
    hidden
        (R, C) of the hidden image.
    """

    def __init__(self, hidden: tuple[int, int]) -> None:
        self.hidden = hidden
        self.scenario: Scenario = ps.load_scenario(ps.find_scene("chair"), hidden)

    @cached_property
    def A(self) -> NDArray[np.float32]:  # noqa: N802
        """(M, N) light transport matrix."""
        return ps.render_transport(self.scenario)

    @cached_property
    def B(self) -> Array:  # noqa: N802
        """(M, 512) prototype backgrounds."""
        return ps.point_light_backgrounds(self.scenario)

    @cached_property
    def periscope(self) -> ps.Periscope:
        """The paper's method, P explicit."""
        return ps.Periscope.for_scene(self.scenario, self.A, self.B)

    def photographs(self, count: int) -> Array:
        """Photographs at SBR 0.5 and 60 dB: (count, rows, columns, 3)."""
        shape = (*self.scenario.photograph_shape, 3)
        lights = np.random.default_rng(0).random((self.B.shape[1], 3))
        background = (self.B @ lights).reshape(shape)
        frames = clip(self.hidden, count).reshape(count, -1, 3)
        signals = np.stack([(self.A @ f).reshape(shape) for f in frames])
        exposed = ps.composite(signals, np.stack([background] * count), SBR)
        return np.stack([ps.add_noise(y, SNR, seed) for seed, y in enumerate(exposed)])


def compare(what: str, goal: str, ours: float, theirs: float, least: float, how: str = "") -> Claim:
    """State how many times faster than another, and whether that is as asked."""
    ratio = theirs / ours
    return Claim(
        what,
        goal,
        f"{ratio:.3g} times ({_seconds(ours)} against {_seconds(theirs)})",
        Verdict.AGREES if ratio >= least else Verdict.DIFFERS,
        how,
    )


def stills(limits: Limits) -> Section:
    """One reconstruction and batches, against one pass over P's bytes."""
    scene = Scene(SMALL)
    periscope, photographs = scene.periscope, scene.photographs(32)
    P = periscope.preconditioner.matrix().astype(np.float32)
    y = photographs[0]
    bytes_pass = median_seconds(P.sum, 51)
    once = median_seconds(partial(periscope.reconstruct, y), 51)
    batch = median_seconds(partial(periscope.reconstruct_batch, photographs), 7) / 32
    estimate = periscope.estimate(y[None])
    g, weight = estimate.preconditioned[0], estimate.weight[0]
    denoised = solve_total_variation(g, weight).image
    stages = {
        "P y and the noise": median_seconds(partial(periscope.estimate, y[None]), 51),
        "total variation": median_seconds(partial(solve_total_variation, g, weight), 51),
        "repair": median_seconds(partial(repaired, denoised, 0.1), 51),
    }
    exact = ps.Periscope.for_scene(scene.scenario, scene.A, scene.B, explicit=False)
    differences = [_relative(periscope.reconstruct(y), exact.reconstruct(y)) for y in photographs]
    return Section(
        "stills",
        "One photograph, 36 x 29 patches, 126 x 126 pixels",
        claims=[
            compare(
                "one reconstruction against P.sum() of the float32 P",
                "at most 1.5 times as long",
                once,
                bytes_pass,
                1 / 1.5,
                f"Reading P at the machine's copy rate takes {_seconds(P.nbytes / limits.copy)}.",
            ),
            compare("in batches of 32, against one at a time", "", batch, once, 0),
            Claim(
                "single precision against double, images of 32 photographs",
                "",
                f"largest relative difference {max(differences):.1e}",
                Verdict.AGREES if max(differences) < 1e-2 else Verdict.DIFFERS,
            ),
        ],
        tables=[_times("Where the time goes", {**stages, "all": once})],
    )


def denoising(_limits: Limits) -> Section:
    """Total variation against other libraries, all to the same accuracy."""
    scene = Scene(SMALL)
    estimate = scene.periscope.estimate(scene.photographs(1))
    g, weight = estimate.preconditioned[0].astype(np.float64), estimate.weight[0]
    exact = ps.prox_total_variation(g, weight, tolerance=1e-11)
    ours = _relative(ps.prox_total_variation(g.astype(np.float32), weight), exact)

    def enough(prox: Callable[[int], Array]) -> int:
        iterations = 8
        while _relative(prox(iterations), exact) > ours and iterations < 20_000:
            iterations = int(1.5 * iterations)
        return iterations

    def scikit(iterations: int) -> Array:
        return peers.scikit_image_tv(g, weight, iterations)

    def pyproximal(iterations: int) -> Array:
        return peers.pyproximal_tv(g, weight, iterations)

    seconds = median_seconds(partial(ps.prox_total_variation, g.astype(np.float32), weight), 51)
    claims = []
    for name, prox in {"scikit-image": scikit, "pyproximal": pyproximal}.items():
        iterations = enough(prox)
        reached = _relative(prox(iterations), exact)
        claims.append(
            compare(
                f"total variation, three channels, against {name}",
                "",
                seconds,
                median_seconds(partial(prox, iterations), 5),
                1,
                f"To a relative distance of {ours:.1e} from the minimizer ({name}: {reached:.1e}, "
                f"{iterations} iterations).",
            )
        )
    return Section("denoising", "Total variation", claims=claims)


def differencing(_limits: Limits) -> Section:
    """Compare the method of [15], converged, with a plain NumPy port."""
    scene = Scene(SMALL)
    scenario = scene.scenario
    method = ps.Differencing(
        scene.A, photograph_shape=scenario.photograph_shape, hidden_shape=SMALL
    )
    y = scene.photographs(1)[0] * [0, 1, 0]
    solution = method.solve(y)
    ours = median_seconds(partial(method.solve, y), 3)
    A = scene.A.astype(np.float64)
    iterations = 100
    start = time.perf_counter()
    peers.numpy_differencing(
        A, y[..., 1].ravel(), scenario.photograph_shape, SMALL, solution.weight[1], iterations
    )
    theirs = time.perf_counter() - start
    return Section(
        "differencing",
        "The method of [15], one channel",
        claims=[
            compare(
                f"converged, against {iterations} iterations of a plain NumPy port",
                "",
                ours,
                theirs,
                1,
                "The port is not converged by then.",
            )
        ],
    )


def forming(limits: Limits) -> Section:
    """Form P at four sizes, against pinv([A, B]); cost against size."""
    factored, explicit, pinv, residuals = {}, {}, {}, {}
    for hidden in SIZES:
        scene = Scene(hidden)
        A, B, N = scene.A, scene.B, hidden[0] * hidden[1]
        runs = 5 if N <= PINV_LIMIT else 1
        factored[N] = median_seconds(partial(form_preconditioner, A, B), runs)
        P = form_preconditioner(A, B)
        explicit[N] = factored[N] + median_seconds(P.matrix, runs)
        probe = np.random.default_rng(0).standard_normal((N, 4))
        matrix = P.matrix()
        residuals[N] = float(np.abs(matrix @ (P.A @ probe) - probe).max())
        if N <= PINV_LIMIT:
            del matrix
            pinv[N] = median_seconds(partial(peers.pinv_preconditioner, A.astype(np.float64), B), 2)
    small, large = min(factored), max(factored)
    last = max(pinv)
    # O((N + 512)² M): every step of pinv works on [A, B].
    beyond = pinv[last] * ((large + 512) / (last + 512)) ** 2
    return Section(
        "forming",
        "Forming P, 126 x 126 pixels",
        claims=[
            compare(
                "factored, 36 x 29, against pinv([A, B])", "at least 8 times faster",
                factored[small], pinv[small], 8,
            ),
            compare(
                "explicit, 36 x 29, against pinv([A, B])", "at least 5 times faster",
                explicit[small], pinv[small], 5,
            ),
            compare(
                "factored, 90 x 72, against pinv([A, B])", "at least 25 times faster",
                factored[large], beyond, 25,
                "pinv's time extrapolated from 54 x 43, as the square of the number of columns.",
            ),
            Claim(
                "explicit P: largest entry of (P A - I) z, z normal, at any size",
                "1e-8",
                f"{max(residuals.values()):.1e}",
                Verdict.AGREES if max(residuals.values()) < 1e-8 else Verdict.DIFFERS,
            ),
        ],
        tables=[
            Table(
                "Seconds, and floating-point rate of the factored form beside the machine's "
                f"{limits.double / 1e9:.0f} GFLOP/s.",
                ("patches", "factored", "explicit", "pinv", "GFLOP/s"),
                [
                    (str(N), f"{factored[N]:.2f}", f"{explicit[N]:.2f}",
                     f"{pinv[N]:.1f}" if N in pinv else "",
                     f"{(15876 * N**2 + N**3 / 3) / factored[N] / 1e9:.0f}")
                    for N in factored
                ],
            )
        ],
    )  # fmt: skip


def video(limits: Limits) -> Section:
    """Frames a second, live and in batches."""
    scene = Scene(FILM)
    photographs = scene.photographs(FRAMES)
    rows = []
    claims = []
    for coupling in ("l1", "total-variation"):
        film = ps.Video(scene.periscope, coupling=coupling)

        def live(film: ps.Video = film) -> None:
            film.restart()
            for y in photographs:
                film.next_frame(y)

        def at_once(film: ps.Video = film) -> None:
            film.restart()
            film.frames(photographs)

        rates = [FRAMES / median_seconds(task, 5) for task in (live, at_once)]
        rows.append((coupling, *(f"{rate:.0f}" for rate in rates)))
        for kind, rate, least in zip(("live", "in batches"), rates, (150, 400), strict=True):
            claims.append(
                Claim(
                    f"video at 55 x 40, every stage, {kind}, {coupling}",
                    f"at least {least} frames a second",
                    f"{rate:.0f}",
                    Verdict.AGREES if rate >= least else Verdict.DIFFERS,
                    f"Reading P at the machine's copy rate: {limits.copy / _bytes(scene):.0f} "
                    "a second; multiplying by it at its product rate: "
                    f"{limits.single / (6 * _bytes(scene) / 4):.0f} a second.",
                )
            )
    return Section("video", "Video, 55 x 40 patches", claims=claims)


def transport(limits: Limits) -> Section:
    """Render A at 36 samples a patch, against Mitsuba's shadow rays alone."""
    scene = Scene(SMALL)
    seconds, entries = {}, {}
    for hidden in SIZES:
        scenario = ps.load_scenario(ps.find_scene("chair"), hidden)
        N = hidden[0] * hidden[1]
        seconds[N] = median_seconds(partial(ps.render_transport, scenario), 3)
        entries[N] = scenario.transport_shape[0] * N
    took = median_seconds(partial(ps.render_transport, scene.scenario, samples=36), 5)
    rays = 36 * scene.A.size
    return Section(
        "transport",
        "The light transport matrix",
        claims=[
            compare(
                "A at 36 samples a patch, against as many shadow rays of Mitsuba alone",
                "at most 1.5 times as long",
                took,
                rays / limits.rays,
                1 / 1.5,
                f"{rays / took / 1e6:.0f} million rays a second.",
            )
        ],
        tables=[
            Table(
                "A at 16 samples a patch.",
                ("patches", "seconds", "ns a ray"),
                [
                    (str(N), f"{s:.2f}", f"{s / entries[N] / 16 * 1e9:.1f}")
                    for N, s in seconds.items()
                ],
            )
        ],
    )


BENCHMARKS: dict[str, Callable[[Limits], Section]] = {
    "stills": stills,
    "denoising": denoising,
    "differencing": differencing,
    "forming": forming,
    "video": video,
    "transport": transport,
}


def _bytes(scene: Scene) -> int:
    return 4 * scene.A.size


def _relative(a: Array, b: Array) -> float:
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def _seconds(value: float) -> str:
    return f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"


def _times(title: str, seconds: dict[str, float]) -> Table:
    return Table(title, ("stage", "time"), [(name, _seconds(s)) for name, s in seconds.items()])


def main(
    out: Annotated[Path, typer.Option(help="Folder for the page.")],
    only: Annotated[str, typer.Option(help=f"By comma, of {', '.join(BENCHMARKS)}.")] = "",
) -> None:
    """Run the benchmarks and write the page."""
    names = only.split(",") if only else list(BENCHMARKS)
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        print(f"error: no benchmark '{unknown[0]}'; there are {', '.join(BENCHMARKS)}",
              file=sys.stderr)  # fmt: skip
        raise typer.Exit(2)
    variant = ps.use_variant()
    limits = measure_limits(ps.load_scenario(ps.find_scene("chair"), SMALL))
    record = as_text(provenance(ps.find_scene("chair"), variant, 0, sys.argv))
    sections: list[Section] = []
    for name in names:
        start = time.perf_counter()
        with styled():
            section = BENCHMARKS[name](limits)
        sections.append(replace(section, seconds=time.perf_counter() - start))
        for claim in section.claims:
            print(f"{name}: {claim.what}: {claim.measured} [{claim.stated or '-'}] {claim.verdict}",
                  flush=True)  # fmt: skip
    write_page(
        out / "index.html",
        "Speed",
        sections,
        introduction="Medians of several runs, in one run of this machine: "
        f"copies {limits.copy / 1e9:.0f} GB/s, matrix products {limits.single / 1e9:.0f} and "
        f"{limits.double / 1e9:.0f} GFLOP/s in single and double precision, Mitsuba's shadow rays "
        f"{limits.rays / 1e6:.0f} million a second.",
        provenance=record,
    )
    claims: list[dict[str, Any]] = [
        {"section": section.name, **asdict(claim)}
        for section in sections
        for claim in section.claims
    ]
    with staged_file(out / "claims.json") as file:
        file.write_text(json.dumps(claims, indent=2, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    typer.run(main)
