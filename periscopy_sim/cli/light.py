"""The options of the light that a command models: A of the monitor's, B of lamps."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.output import fixable
from periscopy_sim.numerics.words import WAYS, bounces_in_words, bounces_of_words
from periscopy_sim.reconstruction.registry import METHODS

GRID = "grid"
"""Names Eq. 4's point lights on the paper's grid."""


def most_bounces(text: str) -> int | None:
    """Return the most reflections of a path that ``--bounces`` names: None for any number."""
    with fixable("--bounces"):
        return bounces_of_words(text)


@dataclass(frozen=True)
class MonitorLight(options.OptionGroup):
    """The options of A, checked before anything is rendered."""

    samples: options.Samples = None
    model: options.ModelOption = None
    bounces: options.BouncesOption = "direct"

    def __post_init__(self) -> None:
        _ = self.most_bounces

    @property
    def most_bounces(self) -> int | None:
        """The most reflections of a path: 1 of direct light, None of any number."""
        return most_bounces(self.bounces)

    def of(self, scenario: ps.Scenario) -> ps.Light:
        """Return how the light of a scenario is computed."""
        del scenario
        by = None if self.model is None else WAYS[self.model]
        return ps.Light(by, self.samples, self.most_bounces)


@dataclass(frozen=True)
class LightOptions(MonitorLight):
    """The options of A and B, checked before anything is rendered.

    B has the columns of all sources that `light_model` names, in this order.
    """

    light_model: options.LightModelOption = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for source in self.sources:
            if source != GRID and not source.lower().endswith(".npy"):
                raise ps.PeriscopyError(f"--light-model {source}: give {GRID}, or an NPY file")
            if source != GRID and not Path(source).is_file():
                raise ps.PeriscopyError(f"--light-model {source}: there is no such file")

    @property
    def sources(self) -> list[str]:
        """The sources of ambient light."""
        return self.light_model or [GRID]

    @property
    def origin(self) -> dict[str, Any]:
        """The entries of a summary on the light, beside those of its `TransportPlan`."""
        bounces = bounces_in_words(self.most_bounces)
        return {"bounces": bounces, "ambient_prototypes": self.sources}

    def check_methods(self, *names: str) -> None:
        """Reject a light model for a method that takes no B."""
        without = [name for name in names if name in METHODS and not METHODS[name].backgrounds]
        if self.light_model and without:
            raise ps.PeriscopyError(f"--light-model: {without[0]} models no ambient light; drop it")

    def of(self, scenario: ps.Scenario) -> ps.Light:
        """Return how the light of a scenario is computed; B of files has its pixels."""
        from dataclasses import replace

        from periscopy_sim.storage.transport_matrix import read_prototypes

        pixels = scenario.transport_shape[0]
        sources = [None if s == GRID else read_prototypes(Path(s), pixels) for s in self.sources]
        return replace(super().of(scenario), ambient=tuple(sources))
