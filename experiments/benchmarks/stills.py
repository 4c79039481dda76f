"""Speed of one photograph, of batches, and of total variation beside scikit-image's."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.benchmarks.scene import SMALL, compare, photographs_of, seconds_text
from experiments.report import Claim, Section, Table, Verdict
from experiments.setting import Setting, chair
from experiments.timing import median_seconds
from periscopy_sim.reconstruction.preconditioned.still import repaired
from periscopy_sim.reconstruction.total_variation.prox import solve_total_variation

Array = NDArray[np.float64]


def stills(_: Setting) -> Section:
    """One reconstruction and batches, against one pass over P's bytes."""
    scene = chair(SMALL)
    periscope, photographs = scene.preconditioned, photographs_of(scene, 32)
    P = periscope.preconditioner.matrix().astype(np.float32)
    y = photographs[0]
    once = median_seconds(partial(periscope.reconstruct, y), 51)
    many = ps.Video(periscope, coupling="none").frames
    estimate = periscope.estimate(y[None])
    denoise = partial(
        solve_total_variation, estimate.preconditioned[0], estimate.weight[0], periscope.hidden
    )
    stages = {
        "P y and the noise": partial(periscope.estimate, y[None]),
        "total variation": denoise,
        "repair": partial(repaired, periscope.hidden, denoise().image, 0.1),
    }
    seconds = {name: median_seconds(stage, 51) for name, stage in stages.items()} | {"all": once}
    exact = ps.Periscope.for_scene(scene.scenario, scene.A, scene.B, explicit=False)
    differences = [relative(periscope.reconstruct(y), exact.reconstruct(y)) for y in photographs]
    return Section(
        "stills",
        "One photograph, 36 x 29 patches, 126 x 126 pixels",
        claims=[
            compare(
                "one reconstruction against P.sum() of the float32 P",
                once,
                median_seconds(P.sum, 51),
                "at most 1.5 times as long",
                1 / 1.5,
            ),
            compare(
                "in batches of 32, against one at a time",
                median_seconds(partial(many, photographs), 7) / 32,
                once,
            ),
            Claim(
                "single precision against double, images of 32 photographs",
                "",
                f"largest relative difference {max(differences):.1e}",
                Verdict.MEASURED,
            ),
        ],
        tables=[
            Table(
                "Where the time goes",
                ("stage", "time"),
                [(name, seconds_text(took)) for name, took in seconds.items()],
            )
        ],
    )


def denoising(_: Setting) -> Section:
    """Total variation against scikit-image's, to the same accuracy, its iterations to an eighth."""
    scene = chair(SMALL)
    estimate = scene.preconditioned.estimate(photographs_of(scene, 1))
    g = estimate.preconditioned[0].reshape(*SMALL, 3).astype(np.float64)
    weight, single = estimate.weight[0], g.astype(np.float32)
    exact = ps.prox_total_variation(g, weight, tolerance=1e-8)
    ours = relative(ps.prox_total_variation(single, weight), exact)
    iterations = 8
    while (theirs := relative(scikit_image_tv(g, weight, iterations), exact)) > ours:
        iterations += iterations // 8
    return Section(
        "denoising",
        "Total variation",
        claims=[
            compare(
                "total variation, three channels, against scikit-image",
                median_seconds(partial(ps.prox_total_variation, single, weight), 51),
                median_seconds(partial(scikit_image_tv, g, weight, iterations), 5),
                how=f"To a relative distance of {ours:.1e} from the minimizer (scikit-image: "
                f"{theirs:.1e}, {iterations} iterations).",
            )
        ],
    )


def scikit_image_tv(image: Array, weight: Array, iterations: int) -> Array:
    """Denoise each channel with its weight by scikit-image, with a number of iterations."""
    from skimage.restoration import denoise_tv_chambolle

    # It minimizes ½‖f − g‖² + w TV.
    channels = [
        denoise_tv_chambolle(image[..., c], weight=weight[c] / 2, eps=0, max_num_iter=iterations)
        for c in range(image.shape[-1])
    ]
    return np.stack(channels, axis=-1)


def relative(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> float:
    """Return the distance of a from b over the norm of b."""
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))
