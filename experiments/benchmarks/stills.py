"""Speed of one photograph, of batches, and of total variation beside scikit-image's."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.benchmarks.scene import SMALL, compare, photographs_of
from experiments.report import Section
from experiments.setting import Setting, chair
from experiments.timing import median_seconds

Array = NDArray[np.float64]


def stills(_: Setting) -> Section:
    """One reconstruction and batches, against one pass over P's bytes."""
    scene = chair(SMALL)
    periscope, photographs = scene.preconditioned, photographs_of(scene, 32)
    P = periscope.preconditioner.matrix().astype(np.float32)
    once = median_seconds(partial(periscope.reconstruct, photographs[0]), 51)
    many = ps.Video(periscope, coupling="none").frames
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
