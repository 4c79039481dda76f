"""The prototype backgrounds, B, that a command is asked to take for ambient light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np

from periscopy_sim.cli.arguments import option
from periscopy_sim.cli.output import fixable, progress
from periscopy_sim.errors import PeriscopyError

if TYPE_CHECKING:
    from periscopy_sim.scenario import Array, Scenario

GRID = "grid"
"""Names Eq. 4's point lights on the paper's grid."""

PrototypesOption = Annotated[
    list[str] | None,
    option(
        "grid|FILE.npy|SCENE",
        "What ambient light may be made of: Eq. 4's point lights (grid), the columns of a file, "
        "(pixels, lights), or the emitters of a scene, large ones by panes; repeatable: all of "
        "them. Default: grid.",
        "--backgrounds",
    ),
]


@dataclass(frozen=True)
class AskedPrototypes:
    """How a command was asked to get B: from what, in this order."""

    sources: tuple[str, ...]
    seed: int

    @classmethod
    def of(cls, sources: Sequence[str] | None, seed: int, methods: Sequence[str] = ()) -> Self:
        """Return what ``--backgrounds`` asks for; a PeriscopyError says that it cannot be.

        Nothing is rendered yet. The methods are those that would be told of B.
        """
        from periscopy_sim.reconstruction.registry import METHODS
        from periscopy_sim.shipped import find_scene

        for source in sources or ():
            if list(sources or ()).count(source) > 1:
                raise PeriscopyError(f"--backgrounds {source} is given twice")
            if source != GRID and not _is_file(source):
                find_scene(source)
        untold = [name for name in methods if name in METHODS and not METHODS[name].backgrounds]
        if sources and untold:
            raise PeriscopyError(
                f"--backgrounds: the method {untold[0]} takes no prototypes of ambient light; "
                "leave one of the two out"
            )
        return cls(tuple(sources or (GRID,)), seed)

    @property
    def origin(self) -> dict[str, Any]:
        """What a summary tells of it."""
        return {"ambient_prototypes": list(self.sources)}

    def matrix(self, scenario: Scenario) -> Array:
        """Return B, (M, L): read, or computed with a progress bar."""
        return np.hstack([self._columns(source, scenario) for source in self.sources])

    def _columns(self, source: str, scenario: Scenario) -> Array:
        if source == GRID:
            from periscopy_sim.analytic.point_light import point_light_backgrounds

            return point_light_backgrounds(scenario)
        if _is_file(source):
            from periscopy_sim.storage.transport_matrix import read_prototypes

            return read_prototypes(Path(source), scenario.transport_shape[0])
        from periscopy_sim.rendering.ambient.emitter_backgrounds import emitter_backgrounds

        label = f"rendering the emitters of {Path(source).stem}"
        with fixable(f"--backgrounds {source}"), progress(label) as report:
            return emitter_backgrounds(source, scenario, seed=self.seed, progress=report)


def _is_file(source: str) -> bool:
    return source.lower().endswith(".npy")
