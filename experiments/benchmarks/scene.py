"""What the benchmarks share: the chair scene at a size, photographs, ratios told as claims."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.paper.moving_scene import clip
from experiments.setting import SNR
from periscopy_sim.figures.report import Claim, Table, Verdict
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]

SMALL = (29, 36)
FILM = (40, 55)
SIZES = ((29, 36), (43, 54), (58, 72), (72, 90))
SBR = 0.5


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


def compare(
    what: str, goal: str, ours: float, theirs: float, least: float | None, how: str = ""
) -> Claim:
    """State how many times faster than another, and whether that is as asked, if it was."""
    ratio = theirs / ours
    met = Verdict.MEASURED
    if least is not None:
        met = Verdict.AGREES if ratio >= least else Verdict.DIFFERS
    return Claim(
        what,
        goal,
        f"{ratio:.3g} times ({seconds_text(ours)} against {seconds_text(theirs)})",
        met,
        how,
    )


def relative(a: NDArray[np.floating[Any]], b: NDArray[np.floating[Any]]) -> float:
    """Distance of a from b over the norm of b."""
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def seconds_text(value: float) -> str:
    """Write a time with three digits."""
    return f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"


def times_table(title: str, seconds: Mapping[str, float]) -> Table:
    """Tabulate times."""
    return Table(
        title, ("stage", "time"), [(name, seconds_text(took)) for name, took in seconds.items()]
    )
