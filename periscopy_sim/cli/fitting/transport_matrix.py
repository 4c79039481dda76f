"""The transport matrix that a command is asked for, and its memory."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from periscopy_sim.cli.arguments import option
from periscopy_sim.cli.output import progress
from periscopy_sim.errors import PeriscopyError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from periscopy_sim.rendering.transport.kernel import Strata
    from periscopy_sim.scenario import Scenario
    from periscopy_sim.storage.transport_matrix import Transport

TOLD_MEMORY = 2e9
"""Bytes from which they are told beforehand."""


class Model(StrEnum):
    """How direct light of the transport matrix is computed."""

    rendered = "rendered"
    analytic = "analytic"


ModelOption = Annotated[
    Model, typer.Option(help="A by shadow rays, or in closed form (planar scenes, meshes).")
]
BouncesOption = Annotated[
    str,
    option(
        "direct|all|N",
        "The monitor's light in A: what goes straight to the wall, what all surfaces send on, or "
        "what is reflected at most N times.",
    ),
]


def parse_bounces(text: str) -> int | None:
    """Read ``--bounces``: most reflections of a path, 1 of direct light, None of any number."""
    from periscopy_sim.rendering.transport.bounces import bounces_of_words

    try:
        return bounces_of_words(text)
    except ValueError as error:
        raise PeriscopyError(f"--bounces {error}") from None


@dataclass(frozen=True)
class AskedTransport:
    """How a command was asked to get A: from a file, or how it is rendered.

    Where noise in A would count as information, as in a bound, its `strata` should be ``"gauss"``:
    that of random rays makes patches look told apart.
    """

    samples: int
    seed: int
    model: Model = Model.rendered
    bounces: int | None = 1
    file: Path | None = None
    strata: Strata = "jittered"

    @property
    def is_direct(self) -> bool:
        """Whether it holds the light alone that goes straight to the wall."""
        return self.bounces == 1

    @property
    def is_rendered(self) -> bool:
        """Whether it is what `render_transport` makes of direct light."""
        return self.file is None and self.model is Model.rendered and self.is_direct

    @property
    def origin(self) -> dict[str, Any]:
        """What a summary tells of it."""
        from periscopy_sim.rendering.transport.bounces import bounces_in_words

        made = {"model": "file" if self.file else self.model.value, "transport": self.file}
        samples = None if self.file else self.samples
        return {**made, "samples": samples, "bounces": bounces_in_words(self.bounces)}

    def matrix(self, scenario: Scenario) -> Transport:
        """Read A, or compute it with a progress bar."""
        if self.file is not None:
            from periscopy_sim.storage.transport_matrix import read_transport

            return read_transport(self.file, scenario, self.bounces)
        if self.is_direct:
            return self._direct(scenario)
        from periscopy_sim.rendering.transport.bounced import check_bouncing_wall
        from periscopy_sim.rendering.transport.bounced_transport import add_bounces

        check_bouncing_wall(scenario)
        direct = self._direct(scenario)
        with progress("tracing light that bounces") as report:
            return add_bounces(scenario, direct, self.bounces, seed=self.seed, progress=report)

    def _direct(self, scenario: Scenario) -> NDArray[np.float32]:
        if self.model is Model.analytic:
            from periscopy_sim.analytic.area_transport import analytic_transport

            return analytic_transport(scenario)
        from periscopy_sim.rendering.transport import shadow_rays

        with progress("rendering the transport matrix") as report:
            return shadow_rays.render_transport(
                scenario,
                samples=self.samples,
                strata=self.strata,
                seed=self.seed,
                progress=report,
            )


def check_memory(scenario: Scenario, method: str | None = None) -> None:
    """Tell how much memory A and what is fitted to it need; refuse what cannot be had."""
    from periscopy_sim.numerics.memory import available_memory, has_memory, transport_memory
    from periscopy_sim.reconstruction.registry import DEFAULT, METHODS

    pixels, patches = scenario.transport_shape
    entry = METHODS.get(method or DEFAULT, METHODS[DEFAULT])
    per_entry = 4 if method is None else entry.bytes_per_entry
    needed = transport_memory(pixels, patches, per_entry)
    told = f"{pixels} pixels x {patches} patches need about {needed / 1e9:.1f} GB of memory"
    if not has_memory(needed):
        thrifty = min(METHODS.values(), key=lambda each: each.bytes_per_entry)
        would_do = has_memory(transport_memory(pixels, patches, thrifty.bytes_per_entry))
        other = f", or take --method {thrifty.name}" if method is not None and would_do else ""
        raise PeriscopyError(
            f"{told}, where {(available_memory() or 0) / 1e9:.1f} GB can be had; average pixels by "
            f"periscopy prepare --bin, ask for fewer patches by --hidden{other}"
        )
    if needed > TOLD_MEMORY:
        print(f"periscopy: {told}", file=sys.stderr, flush=True)
