"""What the benchmarks share: sizes, photographs of the chair scene, ratios as claims."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.paper.moving_scene import clip
from experiments.report import Claim, Table, Verdict
from experiments.setting import SNR, Chair

Array = NDArray[np.float64]

SMALL = (29, 36)
FILM = (40, 55)
SBR = 0.5


def photographs_of(chair: Chair, count: int) -> Array:
    """Photograph a moving scene at SBR 0.5 and 60 dB: (count, rows, columns, 3)."""
    shape = (*chair.scenario.photograph_shape, 3)
    lights = np.random.default_rng(0).random((chair.B.shape[1], 3))
    background = (chair.B @ lights).reshape(shape)
    frames = clip(chair.hidden, count).reshape(count, -1, 3)
    signals = np.stack([(chair.A @ f).reshape(shape) for f in frames])
    exposed = ps.composite(signals, np.stack([background] * count), SBR)
    return np.stack([ps.add_noise(y, SNR, seed) for seed, y in enumerate(exposed)])


def compare(
    what: str, goal: str, ours: float, theirs: float, least: float | None, how: str = ""
) -> Claim:
    """State how many times faster than another, and whether that is as asked, if it was."""
    ratio = theirs / ours
    met = Verdict.MEASURED
    if least is not None:
        met = Verdict.of(ratio >= least)
    return Claim(
        what,
        goal,
        f"{ratio:.3g} times ({seconds_text(ours)} against {seconds_text(theirs)})",
        met,
        how,
    )


def relative(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> float:
    """Return the distance of a from b over the norm of b."""
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def seconds_text(value: float) -> str:
    """Write a time with three digits."""
    return f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"


def times_table(title: str, seconds: Mapping[str, float]) -> Table:
    """Tabulate times."""
    return Table(
        title, ("stage", "time"), [(name, seconds_text(took)) for name, took in seconds.items()]
    )
