"""The light that a command models: the transport matrix A and the light model B."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import periscopy_sim as ps
from periscopy_sim.cli import options
from periscopy_sim.cli.messages import sentence
from periscopy_sim.cli.options import Model
from periscopy_sim.cli.output import fixable, progress, say
from periscopy_sim.numerics import machine
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS
from periscopy_sim.rendering.transport.kernel import Strata

if TYPE_CHECKING:
    from periscopy_sim.rendering.transport.plan import By, TransportPlan
    from periscopy_sim.storage.transport_matrix import Transport

GRID = "grid"
"""Names Eq. 4's point lights on the paper's grid."""


def check_memory(
    scenario: ps.Scenario, method: str = "", others: Sequence[ps.Scenario] = ()
) -> None:
    """Reject a scene whose A, and a method fitted to it, need more memory than there is.

    With other views of the scene, it is fitted to each, and to all pixels together. Print the
    memory and time that a fine grid of patches needs.
    """
    from periscopy_sim.model import spectral_basis

    pixels, patches = scenario.transport_shape
    entry = METHODS.get(method, METHODS[DEFAULT])
    rows = pixels + sum(each.transport_shape[0] for each in others)
    pixels = 2 * rows if others else rows
    own, seconds = spectral_basis.cost(pixels, patches) if method and entry.patterns else (0.0, 0.0)
    # As measured: beside A, what is made of it and copies, the renderer and a block of rows.
    needed = 0.6e9 + own + (entry.bytes_per_entry if method else 4) * pixels * patches
    available = machine.available_memory()
    if available is not None and needed > available:
        raise ps.PeriscopyError(
            f"{rows} pixels x {patches} patches need {needed / 1e9:.1f} GB of memory, of "
            f"{available / 1e9:.1f} GB; average pixels (prepare --bin), or take a coarser --hidden"
        )
    if own and patches > spectral_basis.MOST_PATTERNS:
        values = {"patches": patches, "memory": needed / 1e9, "seconds": seconds}
        say(sentence("fine_grid", method=method, **values))


def most_bounces(text: str) -> int | None:
    """Return the most reflections of a path that ``--bounces`` names: None for any number."""
    if text == "direct":
        return 1
    from periscopy_sim.rendering.transport.bounced import bounces_of_words

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

    def plan(
        self, scenario: ps.Scenario, noise: float | None, seed: int = 0, method: str = DEFAULT
    ) -> "TransportPlan":
        """Choose how A is made for a method and photographs of some noise; see `plan_for`."""
        from periscopy_sim.evaluation.methods import plan_for

        ways: dict[Model | None, By] = {Model.analytic: "areas", Model.rendered: "rays"}
        by = ways.get(self.model)
        return plan_for(method, scenario, noise, by=by, samples=self.samples, seed=seed)

    def transport(
        self, scenario: ps.Scenario, plan: "TransportPlan", seed: int, strata: Strata = "jittered"
    ) -> "Transport":
        """Compute A, (M, N), as planned, with a progress bar.

        Bounds need the `strata` ``"gauss"``: the noise of random rays would count as information.
        """
        bounces, verb = self.most_bounces, "computing" if plan.by == "areas" else "rendering"
        with progress(f"{verb} the transport matrix") as report:
            A = plan.transport(scenario, strata=strata, seed=seed, progress=report)
        if bounces == 1:
            return A
        with progress("tracing light that bounces") as report:
            return ps.add_bounces(scenario, A, bounces, seed=seed, progress=report)


@dataclass(frozen=True)
class Light(MonitorLight):
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
        from periscopy_sim.rendering.transport.bounced import bounces_in_words

        bounces = bounces_in_words(self.most_bounces)
        return {"bounces": bounces, "ambient_prototypes": self.sources}

    def check_methods(self, *names: str) -> None:
        """Reject a light model for a method that takes no B."""
        without = [name for name in names if name in METHODS and not METHODS[name].backgrounds]
        if self.light_model and without:
            raise ps.PeriscopyError(f"--light-model: {without[0]} models no ambient light; drop it")

    def backgrounds(self, scenario: ps.Scenario) -> Any:
        """Return B, (M, L): Eq. 4's, or read."""
        from periscopy_sim.storage.transport_matrix import read_prototypes

        pixels = scenario.transport_shape[0]
        made = {GRID: ps.point_light_backgrounds(scenario)} if GRID in self.sources else {}
        files = {each: read_prototypes(Path(each), pixels) for each in self.sources if each != GRID}
        return np.hstack([{**made, **files}[source] for source in self.sources])
