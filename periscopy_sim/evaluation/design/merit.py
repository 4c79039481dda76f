"""How well one scene tells its hidden image: Cramér-Rao bound, and errors of the default method.

The bound of a patch is σ² (A⊥ᵀA⊥)⁻¹, range(B) projected out, σ that of a photograph of a white
screen. Noise of its own that A has, by random rays, looks like information: take an A without, by
``strata="gauss"``, see `render_transport`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from periscopy_sim.evaluation.design.comparison import Comparison, Equal

from periscopy_sim.model.observation import observation_of
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
from periscopy_sim.reconstruction.preconditioned.preconditioner import form_preconditioner
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Merit:
    """What a scene is worth; errors are standard deviations where white is 1.

    Attributes
    ----------
    light
        Mean of the photograph of a white screen, over that of the scene as it stands.
    bound
        Root of the mean Cramér-Rao bound of the patches; infinite where the photograph does not
        tell some of them at all.
    bound_without_ambient
        The same where no ambient light need be projected out.
    exposure_time
        That brings the bound of the scene as it stands, in the same room, over that scene's; None
        if that bound is infinite.
    told_error
        Root mean square of the noise-aware method's standard errors, over the images; None without
        images.
    error
        Root mean square of its actual errors.
    remark
        What the method warned of, and what is doubtful about the scene: that no shadow falls into
        view, or that occluders stand in each other.
    """

    light: float
    bound: float
    bound_without_ambient: float
    exposure_time: float | None
    told_error: float | None = None
    error: float | None = None
    remark: str = ""


NUMBERS = tuple(each.name for each in fields(Merit) if each.name != "remark")
"""The names of what a merit counts."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The scene as it stands, which others are compared with.

    `white` is the mean of a white screen's photograph, `signals` those of the images, `pixels` how
    many there are, `bound` that of equal time.
    """

    white: float
    signals: Mapping[str, float]
    pixels: int
    bound: float


@dataclass(frozen=True, eq=False)
class Assessment:
    """The way to assess scenes: the comparison, the images shown, (R, C, 3) each, and the seed.

    Make one by `assessment_of`, which assesses the scene as it stands.
    """

    comparison: Comparison
    images: Mapping[str, Array] = field(default_factory=dict)
    seed: int = 0
    reference: Reference | None = None

    def merit(self, scenario: Scenario, A: Image, B: Image) -> Merit:
        """Return what a scene is worth, of its A, (M, N), and prototypes of ambient light, (M, L).

        A ValueError says that no pixel is left, or that B explains all of A.
        """
        return self._merit(scenario, A, B)[0]

    def _merit(self, scenario: Scenario, A: Image, B: Image) -> tuple[Merit, Reference]:
        ambient = self.comparison.has_ambient_light
        sizes = scenario.hidden_shape, scenario.channel_gain, None, scenario.photograph_shape
        seen = observation_of(A, *sizes)
        B = B if ambient else np.zeros((len(A), 0))
        used = seen.used_transport(A)
        gain = np.broadcast_to(seen.used_gain, (len(used), 3))
        light = _ambient_light(seen.used(B))[:, None] * gain if ambient else np.zeros_like(gain)
        white = used.sum(axis=1)[:, None] * gain
        whole = _root_noise_gain(used, seen.used(B))
        alone = _root_noise_gain(used, None) if ambient else whole
        level = float(white.mean())
        known = self.reference or Reference(level, {}, len(used), 0.0)
        pixels = len(used) / known.pixels

        def noise(equal: Equal) -> float:
            """Return σ of a white screen's photograph, each channel divided by its gain."""
            comparison = replace(self.comparison, equal=equal)
            _, σ = comparison.measured(white, light, known.white, pixels)
            return σ * float(np.sqrt(np.mean(1 / gain**2)))

        here, timed = noise(self.comparison.equal), noise(Equal.time) * whole
        first = timed if self.reference is None else self.reference.bound
        merit = Merit(
            light=level / known.white,
            bound=here * whole,
            bound_without_ambient=here * alone,
            exposure_time=None if np.isinf(first) else float((timed / first) ** 2),
        )
        told, errors, signals, remarks = [], [], {}, []
        if self.images:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                method = NoiseAware.for_scene(scenario, A, B)
                for number, (name, image) in enumerate(self.images.items()):
                    signal = (used @ image.reshape(-1, 3)) * gain
                    signals[name] = float(signal.mean())
                    reference = known.signals.get(name, signals[name])
                    y, σ = self.comparison.measured(signal, light, reference, pixels)
                    rng = np.random.default_rng([self.seed, number])
                    photograph = np.zeros((len(A), 3))
                    photograph[... if seen.mask is None else seen.mask.ravel()] = rng.normal(y, σ)
                    found = method.solve(photograph.reshape(*scenario.photograph_shape, 3))
                    told.append(np.mean(method.standard_errors(found) ** 2))
                    errors.append(np.mean((found.image - image) ** 2))
            remarks = list(dict.fromkeys(" ".join(str(each.message).split()) for each in caught))
            merit = replace(
                merit,
                told_error=float(np.sqrt(np.mean(told))),
                error=float(np.sqrt(np.mean(errors))),
                remark="; ".join(remarks),
            )
        return merit, Reference(level, signals, len(used), timed)


def assessment_of(
    scenario: Scenario,
    A: Image,
    B: Image,
    comparison: Comparison,
    images: Mapping[str, Array] | None = None,
    seed: int = 0,
) -> tuple[Assessment, Merit]:
    """Return the way to assess scenes beside one as it stands, and what that one is worth.

    Parameters
    ----------
    scenario, A, B
        The scene as it stands, its transport matrix, (M, N), and its prototypes of ambient light,
        (M, L).
    comparison
        Noise and ambient light.
    images
        Hidden images by name, (R, C, 3) in [0, 1], for the errors; none leaves these out.
    seed
        Of the noise, the same for all scenes.
    """
    alone = Assessment(comparison, dict(images or {}), seed)
    merit, reference = alone._merit(scenario, A, B)
    return replace(alone, reference=reference), merit


def _root_noise_gain(A: Image, B: Image | None) -> float:
    """Return the root of the mean bound for unit noise; infinite where A has not full rank."""
    try:
        return float(np.sqrt(form_preconditioner(A, B).noise_gain.mean()))
    except ValueError as error:
        if "full column rank" not in str(error):
            raise
        return float("inf")


def _ambient_light(B: Image) -> Array:
    """Return the light of all prototypes together, each of norm 1, (M,) of mean 1."""
    norms = np.linalg.norm(B, axis=0)
    light = np.asarray(B @ (1 / np.where(norms > 0, norms, np.inf)), np.float64)
    return np.asarray(light / light.mean())
