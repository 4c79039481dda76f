"""One occluder on trial: its bound, and its images from photographs that were rendered apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.design.masks import Candidate, silhouette, write_scene
from periscopy_sim.evaluation.merit import Comparison, Reference, merit_of
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]

SEED = 18
"""Of the rendered light and the noise."""

RAYS = 64, 9
"""To places of a patch, from places of a pixel, for photographs and for the methods' A."""

ROUGH_RAYS = 16, 1
"""The same by default: from a pixel's middle. A is then in error by some tenths of a percent."""


@dataclass(frozen=True)
class Stage:
    """Sizes, light and noise of a trial: what all occluders have in common.

    Attributes
    ----------
    hidden
        (R, C) of the hidden image.
    resolution
        Pixels along each side of the photograph.
    images, places
        Names of shipped images that the monitor shows, the first of which is drawn, and of shipped
        places whose ambient light falls on the wall.
    comparison
        The SNR and the SBR of each photograph.
    bounces
        Most reflections of the monitor's light in photographs; None of any number.
    """

    hidden: tuple[int, int] = (15, 18)
    resolution: int = 63
    images: Sequence[str] = ("mushroom", "letters", "still_life", "digits", "bars")
    places: Sequence[str] = ("overcast", "window_left")
    comparison: Comparison = Comparison()  # noqa: RUF009 (it is frozen)
    bounces: int | None = None

    def load(self, scene: str | Path) -> Scenario:
        """Return the scenario of a scene."""
        return ps.load_scenario(scene, self.hidden, {"resolution": self.resolution})

    def reference(self) -> Reference:
        """Return the reference that occluders are compared with: the shipped plate's."""
        scenario = self.load("plate")
        A, B = placed(scenario), ps.point_light_backgrounds(scenario)
        return merit_of(scenario, A, B, self.comparison, self.shown(), SEED)[1]

    def shown(self) -> dict[str, Array]:
        """Return the images, (R, C, 3), by name."""
        return {n: ps.read_hidden_image(ps.find_image(n), self.hidden) for n in self.images}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a trial found.

    `bound`, `told` and `time` are those of a `Merit`; `errors`, (methods, images, places), mean
    squared errors of the reconstructions, gain-matched; `image`, (R, C, 3), the first image by the
    noise-aware method at the first place; `outline` the silhouette.
    """

    kind: str
    name: str
    bound: float
    told: float
    time: float
    errors: Array
    image: Array
    outline: NDArray[np.bool_]


METHODS = ("noise-aware", "preconditioned", "noise-aware, rough A")
"""Those that reconstruct: the package's default, the paper's, and the default by a rougher A."""


def carried_out(
    candidate: Candidate,
    stage: Stage,
    reference: Reference,
    ambient: Mapping[str, Array],
    folder: Path,
) -> Outcome:
    """Assess an occluder, photograph the images behind it, and recover them.

    The photographs' light is traced anew, by other rays, with what bounces: not by the matrix that
    the methods are given.
    """
    scenario = stage.load(write_scene(candidate, folder))
    B = ps.point_light_backgrounds(scenario)
    truths, placed_A = stage.shown(), placed(scenario)
    merit, _ = merit_of(scenario, placed_A, B, stage.comparison, truths, SEED, reference)
    A = modelled(scenario)
    light = ps.render_transport(
        scenario, samples=RAYS[0], pixel_samples=RAYS[1], bounces=stage.bounces, seed=SEED + 1
    )
    methods = (
        ps.NoiseAware.for_scene(scenario, A, B),
        ps.Periscope.for_scene(scenario, A, B),
        ps.NoiseAware.for_scene(scenario, modelled(scenario, ROUGH_RAYS), B),
    )
    errors = np.empty((len(methods), len(truths), len(ambient)))
    drawn = None
    for i, truth in enumerate(truths.values()):
        signal = np.asarray(light @ truth.reshape(-1, 3)) * scenario.channel_gain
        signal = signal.reshape(*scenario.photograph_shape, 3)
        for j, background in enumerate(ambient.values()):
            exposed = ps.composite(signal, background, stage.comparison.sbr)
            # Of one seed for all occluders.
            y = ps.add_noise(exposed, stage.comparison.snr, SEED + 100 * i + j)
            for k, method in enumerate(methods):
                image = method.reconstruct(y)
                errors[k, i, j] = ps.mean_squared_error(image, truth)
                drawn = ps.gain_matched(image, truth) if drawn is None else drawn
    assert drawn is not None and merit.told_error is not None and merit.exposure_time is not None
    outline, _ = silhouette(candidate.mesh, scenario)
    return Outcome(
        candidate.kind, candidate.name, merit.bound, merit.told_error, merit.exposure_time, errors,
        drawn, outline[::4, ::4],
    )  # fmt: skip


def placed(scenario: Scenario) -> NDArray[np.float32]:
    """Return the A of the bound, by fixed places of patches: noise would count as information."""
    return ps.render_transport(
        scenario, samples=RAYS[0], pixel_samples=RAYS[1], strata="gauss", seed=SEED
    )


def modelled(scenario: Scenario, rays: tuple[int, int] = RAYS) -> NDArray[np.float32]:
    """Return the A of a method, by so many random rays.

    The same places for all pixels err alike in all: the noise-aware method lost 0.4 to 5.7 dB.
    """
    return ps.render_transport(scenario, samples=rays[0], pixel_samples=rays[1], seed=SEED)
