"""What the benchmarks share: photographs of a scene, and times in words."""

import numpy as np
from numpy.typing import NDArray

from experiments.paper import fig7
from experiments.paper.moving_scene import clip
from experiments.setting import FittedScene

SMALL = (29, 36)


def photographs_of(scene: FittedScene, count: int) -> NDArray[np.float64]:
    """Photograph a moving scene at SBR 0.5 and 60 dB: (count, rows, columns, 3)."""
    lights = np.random.default_rng(0).random((scene.B.shape[1], 3))
    background = (scene.B @ lights).reshape(*scene.scenario.photograph_shape, 3)
    (photographs,) = fig7.photographs_of(scene, [clip(scene.hidden, count)], background, (0,))
    return photographs


def seconds_text(value: float) -> str:
    """Write a time with three digits."""
    return f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"
