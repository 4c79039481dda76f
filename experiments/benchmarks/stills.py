"""Speed of one photograph, of batches and of video, beside other libraries."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.benchmarks.scene import (
    FILM,
    SMALL,
    compare,
    photographs_of,
    relative,
    times_table,
)
from experiments.report import Claim, Section, Verdict
from experiments.setting import Chair, Setting
from experiments.timing import median_seconds
from periscopy_sim.reconstruction.preconditioned.still import repaired
from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation

Array = NDArray[np.float64]

FRAMES = 48


def stills(_: Setting) -> Section:
    """One reconstruction and batches, against one pass over P's bytes."""
    scene = Chair(SMALL)
    periscope, photographs = scene.preconditioned, photographs_of(scene, 32)
    P = periscope.preconditioner.matrix().astype(np.float32)
    y = photographs[0]
    bytes_pass = median_seconds(P.sum, 51)
    once = median_seconds(partial(periscope.reconstruct, y), 51)
    many = ps.Video(periscope, coupling="none").frames
    batch = median_seconds(partial(many, photographs), 7) / 32
    estimate = periscope.estimate(y[None])
    g, weight = estimate.preconditioned[0], estimate.weight[0]
    hidden = periscope.hidden
    denoise = partial(solve_total_variation, g, weight, hidden)
    denoised = denoise().image
    stages = {
        "P y and the noise": median_seconds(partial(periscope.estimate, y[None]), 51),
        "total variation": median_seconds(denoise, 51),
        "repair": median_seconds(partial(repaired, hidden, denoised, 0.1), 51),
    }
    exact = ps.Periscope.for_scene(scene.scenario, scene.A, scene.B, explicit=False)
    differences = [relative(periscope.reconstruct(y), exact.reconstruct(y)) for y in photographs]
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
            ),
            compare("in batches of 32, against one at a time", "", batch, once, None),
            Claim(
                "single precision against double, images of 32 photographs",
                "",
                f"largest relative difference {max(differences):.1e}",
                Verdict.MEASURED,
            ),
        ],
        tables=[times_table("Where the time goes", {**stages, "all": once})],
    )


def denoising(_: Setting) -> Section:
    """Total variation against other libraries, all to the same accuracy."""
    scene = Chair(SMALL)
    estimate = scene.preconditioned.estimate(photographs_of(scene, 1))
    shape = *scene.scenario.hidden_shape, 3
    g = estimate.preconditioned[0].reshape(shape).astype(np.float64)
    weight = estimate.weight[0]
    exact = ps.prox_total_variation(g, weight, tolerance=1e-8)
    ours = relative(ps.prox_total_variation(g.astype(np.float32), weight), exact)

    def enough(prox: Callable[[int], Array]) -> int:
        """Find the fewest iterations that come as near as ours, by bisection."""
        most = 8
        while relative(prox(most), exact) > ours and most < 20_000:
            most *= 2
        few = most // 2
        while most - few > most // 50 + 1:
            middle = (few + most) // 2
            few, most = (few, middle) if relative(prox(middle), exact) <= ours else (middle, most)
        return most

    def scikit(iterations: int) -> Array:
        return scikit_image_tv(g, weight, iterations)

    def pyproximal(iterations: int) -> Array:
        return pyproximal_tv(g, weight, iterations)

    seconds = median_seconds(partial(ps.prox_total_variation, g.astype(np.float32), weight), 51)
    claims = []
    for name, prox in {"scikit-image": scikit, "pyproximal": pyproximal}.items():
        iterations = enough(prox)
        reached = relative(prox(iterations), exact)
        claims.append(
            compare(
                f"total variation, three channels, against {name}",
                "",
                seconds,
                median_seconds(partial(prox, iterations), 5),
                None,
                f"To a relative distance of {ours:.1e} from the minimizer ({name}: {reached:.1e}, "
                f"{iterations} iterations).",
            )
        )
    return Section("denoising", "Total variation", claims=claims)


def video(_: Setting) -> Section:
    """Frames a second, live and in batches."""
    scene = Chair(FILM)
    photographs = photographs_of(scene, FRAMES)
    rows = []
    claims = []
    for coupling in ("l1", "total-variation"):
        film = ps.Video(scene.preconditioned, coupling=coupling)

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
                    Verdict.of(rate >= least),
                )
            )
    return Section("video", "Video, 55 x 40 patches", claims=claims)


def scikit_image_tv(image: Array, weight: Array, iterations: int) -> Array:
    """Denoise each channel with its weight by scikit-image, with a number of iterations."""
    from skimage.restoration import denoise_tv_chambolle

    # It minimizes ½‖f − g‖² + w TV.
    channels = [
        denoise_tv_chambolle(image[..., c], weight=weight[c] / 2, eps=0, max_num_iter=iterations)
        for c in range(image.shape[-1])
    ]
    return np.stack(channels, axis=-1)


def pyproximal_tv(image: Array, weight: Array, iterations: int) -> Array:
    """Apply the prox of isotropic total variation by pyproximal, with a number of iterations."""
    import pyproximal

    channels = []
    for c in range(image.shape[-1]):
        # Its objective has ½‖f − g‖² + σ τ TV, τ the argument of prox.
        tv = pyproximal.TV(dims=image.shape[:2], sigma=weight[c] / 2, niter=iterations, rtol=0)
        channels.append(tv.prox(image[..., c].ravel(), 1.0).reshape(image.shape[:2]))
    return np.stack(channels, axis=-1)
