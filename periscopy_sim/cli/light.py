"""The light that a command models: the transport matrix A and the light model B."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from periscopy_sim.cli.options import Model
from periscopy_sim.cli.output import fixable, progress
from periscopy_sim.errors import PeriscopyError
from periscopy_sim.reconstruction.registry import DEFAULT, METHODS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from periscopy_sim.rendering.transport.kernel import Strata
    from periscopy_sim.scenario import Array, Scenario
    from periscopy_sim.storage.transport_matrix import Transport

SAMPLES = 16
"""Rays to a patch where A has no closed form."""

GRID = "grid"
"""Names Eq. 4's point lights on the paper's grid."""


@dataclass(frozen=True)
class TransportRequest:
    """Where A comes from: a file, a closed form or a rendering.

    Bounds need the `strata` ``"gauss"``: the noise of random rays would count as information.
    Without samples and model, A has its closed form where there is one, unless rays serve the
    method better.
    """

    samples: int | None
    seed: int
    model: Model | None = None
    bounces: int | None = 1
    file: Path | None = None
    strata: Strata = "jittered"
    method: str = DEFAULT

    @property
    def is_direct(self) -> bool:
        """Whether A holds direct light only."""
        return self.bounces == 1

    def model_of(self, scenario: Scenario) -> Model:
        """Return how direct light is computed."""
        from periscopy_sim.analytic.area_transport import has_areas

        if self.model is not None:
            return self.model
        by_rays = self.samples is not None or (self.method in METHODS and METHODS[self.method].rays)
        return Model.rendered if by_rays or not has_areas(scenario) else Model.analytic

    def origin(self, scenario: Scenario) -> dict[str, Any]:
        """Return the entries of a summary."""
        from periscopy_sim.rendering.transport.bounced import bounces_in_words

        model = None if self.file else self.model_of(scenario)
        return {
            "model": model.value if model else "file",
            "transport": self.file,
            "samples": (self.samples or SAMPLES) if model is Model.rendered else None,
            "bounces": bounces_in_words(self.bounces),
        }

    def matrix(self, scenario: Scenario) -> Transport:
        """Read A, or compute it with a progress bar."""
        if self.file is not None:
            from periscopy_sim.storage.transport_matrix import read_transport

            return read_transport(self.file, scenario, self.bounces)
        if self.is_direct:
            return self._direct(scenario)
        from periscopy_sim.rendering.transport.bounced import add_bounces, check_bouncing_wall

        check_bouncing_wall(scenario)
        direct = self._direct(scenario)
        with progress("tracing light that bounces") as report:
            return add_bounces(scenario, direct, self.bounces, seed=self.seed, progress=report)

    def _direct(self, scenario: Scenario) -> NDArray[np.float32]:
        from periscopy_sim.rendering.transport import shadow_rays

        if self.model_of(scenario) is Model.analytic:
            from periscopy_sim.analytic.area_transport import pixel_transport

            A = pixel_transport(scenario)
            shadow_rays.require_light(A, scenario)
            return A

        with progress("rendering the transport matrix") as report:
            return shadow_rays.render_transport(
                scenario,
                samples=self.samples or SAMPLES,
                strata=self.strata,
                seed=self.seed,
                progress=report,
            )


@dataclass(frozen=True)
class LightModel:
    """Where B comes from: the sources of ambient light, in this order."""

    sources: tuple[str, ...]
    seed: int

    @classmethod
    def of(cls, sources: Sequence[str] | None, seed: int, methods: Sequence[str] = ()) -> Self:
        """Check the values of ``--light-model`` for methods, before anything is rendered.

        A PeriscopyError names a source that does not exist, or a method that takes no B.
        """
        from periscopy_sim.shipped import find_scene

        chosen = list(sources or ())
        for source in chosen:
            if chosen.count(source) > 1:
                raise PeriscopyError(f"--light-model {source} is given twice")
            if source != GRID and not _is_file(source):
                find_scene(source)
        for name in methods:
            if chosen and name in METHODS and not METHODS[name].backgrounds:
                raise PeriscopyError(
                    f"--light-model: the method {name} models no ambient light; leave one out"
                )
        return cls(tuple(chosen or (GRID,)), seed)

    @property
    def origin(self) -> dict[str, Any]:
        """The entries of a summary."""
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
        with fixable(f"--light-model {source}"), progress(label) as report:
            return emitter_backgrounds(source, scenario, seed=self.seed, progress=report)


def _is_file(source: str) -> bool:
    return source.lower().endswith(".npy")


def check_memory(scenario: Scenario, method: str | None = None) -> None:
    """Reject a scene whose A and method need more memory than there is."""
    from periscopy_sim.numerics.memory import available_memory, has_memory, transport_memory

    pixels, patches = scenario.transport_shape
    entry = METHODS.get(method or DEFAULT, METHODS[DEFAULT])
    needed = transport_memory(pixels, patches, 4 if method is None else entry.bytes_per_entry)
    if not has_memory(needed):
        raise PeriscopyError(
            f"{pixels} pixels x {patches} patches need {needed / 1e9:.1f} GB of memory, of "
            f"{(available_memory() or 0) / 1e9:.1f} GB; average pixels (prepare --bin) or choose "
            "fewer patches (--hidden)"
        )
