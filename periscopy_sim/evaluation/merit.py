"""How well one scene determines its hidden image: Cramér-Rao bound, errors of the default method.

The mean bound of the patches is σ² tr (A⊥ᵀA⊥)⁻¹ / N, range(B) projected out, with σ the noise of a
photograph of a white screen. Random rays give A noise that looks like information: take an A
without noise, by ``strata="gauss"``, see `render_transport`.

Scenes differ in how much light they send to the wall, so units alone must win nothing. Two
comparisons are fair. At an equal level each photograph is exposed to the same mean: all scenes have
the same SNR and SBR. In equal time the room and the exposure are those of the scene as it stands:
its ambient light stays, the monitor's light changes, and SBR and SNR with it, by photon noise. In
both the electrons of a whole photograph count, however many pixels share them.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.measurement import noise_level
from periscopy_sim.model.ambient import RANK_TOLERANCE, ROUNDING
from periscopy_sim.model.fit import Fit
from periscopy_sim.model.observation import observation_of
from periscopy_sim.reconstruction.noise_aware.noise_aware import NoiseAware
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Comparison:
    """The noise and the ambient light of photographs.

    Attributes
    ----------
    snr
        Signal-to-noise ratio in dB of a photograph of the scene as it stands.
    sbr
        Its signal-to-background ratio; infinite without ambient light.
    equal_time
        Whether scenes are compared in equal time rather than at an equal level, see the module.

    Raises
    ------
    PeriscopyError
        If the SNR is not finite, or the SBR not positive.
    """

    snr: float = 60.0
    sbr: float = 0.5
    equal_time: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.snr) and self.sbr > 0):
            raise PeriscopyError(
                f"SNR {self.snr}, SBR {self.sbr}: give a finite SNR in dB and a positive SBR (inf: "
                "no ambient light)"
            )

    @property
    def has_ambient_light(self) -> bool:
        """Whether there is any."""
        return bool(np.isfinite(self.sbr))

    def exposed(
        self, signal: Image, light: Image, reference: float, pixels: float
    ) -> tuple[Array, float]:
        """Return a photograph, (M, channels), in the signal's unit, and its noise σ.

        `signal` is the light of the monitor, `light` ambient light of mean 1; `reference` is the
        mean signal of the scene as it stands, `pixels` the ratio of the two scenes' pixels.
        """
        level = reference if self.equal_time else float(signal.mean())
        photograph = np.asarray(signal + light * (level / self.sbr), np.float64)
        electrons = 1.0  # over those of the scene as it stands
        if self.equal_time:
            electrons = float(photograph.mean()) / (reference * (1 + 1 / self.sbr))
        return photograph, noise_level(photograph, self.snr) * float(np.sqrt(pixels / electrons))


@dataclass(frozen=True)
class Merit:
    """How well a scene determines its hidden image; errors are standard deviations, white is 1.

    Attributes
    ----------
    light
        Mean of the photograph of a white screen, over that of the scene as it stands.
    bound
        Root of the patches' mean Cramér-Rao bound; infinite if the photograph does not determine
        all patches.
    bound_without_ambient
        The same without ambient light to project out.
    exposure_time
        Exposure time, relative to the scene as it stands, that brings that scene's bound in the
        same room; None if that bound is infinite.
    told_error
        Root mean square of the noise-aware method's standard errors, over the images; None without
        images.
    error
        Root mean square of its actual errors.
    remark
        Warnings of the method and of the scene's geometry.
    """

    light: float
    bound: float
    bound_without_ambient: float
    exposure_time: float | None
    told_error: float | None = None
    error: float | None = None
    remark: str = ""


NUMBERS = tuple(each.name for each in fields(Merit) if each.name != "remark")
"""Names of a merit's numbers."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Quantities of the scene as it stands, which other scenes are compared with.

    `signals` are the means of the photographs of a white screen, "", and of images, by name;
    `pixels` counts them, `bound` is the bound in equal time.
    """

    signals: Mapping[str, float]
    pixels: int
    bound: float


def merit_of(
    scenario: Scenario,
    A: Image,
    B: Image,
    comparison: Comparison,
    images: Mapping[str, Array] | None = None,
    seed: int = 0,
    reference: Reference | None = None,
) -> tuple[Merit, Reference]:
    """Return the merit of a scene, and what other scenes need to be compared with it.

    Parameters
    ----------
    scenario, A, B
        The scene, its transport matrix, (M, N), and its prototypes of ambient light, (M, L).
    comparison
        Noise and ambient light.
    images
        Hidden images by name, (R, C, 3) in [0, 1], for the errors; none leaves these out.
    seed
        Of the noise, the same for all scenes.
    reference
        That of the scene as it stands, with the same images; None if this scene is that one.

    Raises
    ------
    ValueError
        If no pixel is left, or B explains all of A.
    """
    images = images or {}
    shapes = scenario.hidden_shape, scenario.channel_gain, None, scenario.photograph_shape
    observed = observation_of(A, *shapes)
    B = B if comparison.has_ambient_light else np.zeros((len(A), 0))
    used, gain = observed.used_transport(A), observed.used_gain
    light = _ambient_light(observed.used(B))[:, None] * gain
    shown = {"": np.ones((*scenario.hidden_shape, 3)), **images}
    signals = {name: (used @ f.reshape(-1, 3)) * gain for name, f in shown.items()}
    own = Reference({name: float(y.mean()) for name, y in signals.items()}, len(used), 0.0)
    first = reference or own
    pixels = own.pixels / first.pixels

    def noise(compared: Comparison) -> float:
        """Return σ of a white screen's photograph, each channel divided by its gain."""
        _, σ = compared.exposed(signals[""], light, first.signals[""], pixels)
        return σ * float(np.sqrt(np.mean(1 / np.broadcast_to(gain, light.shape) ** 2)))

    σ, unit_bound = noise(comparison), _unit_bound(Fit(observed, A, B, RANK_TOLERANCE))
    own = replace(own, bound=noise(replace(comparison, equal_time=True)) * unit_bound)
    bound = own.bound if reference is None else reference.bound
    merit = Merit(
        light=own.signals[""] / first.signals[""],
        bound=σ * unit_bound,
        bound_without_ambient=σ * _unit_bound(Fit(observed, A, None, RANK_TOLERANCE)),
        exposure_time=None if np.isinf(bound) else float((own.bound / bound) ** 2),
    )
    if not images:
        return merit, own
    squares = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        method = NoiseAware.for_scene(scenario, A, B)
        for number, (name, image) in enumerate(images.items()):
            y, σ = comparison.exposed(signals[name], light, first.signals[name], pixels)
            photograph = np.zeros((len(A), 3))
            noisy = np.random.default_rng([seed, number]).normal(y, σ)
            photograph[... if observed.mask is None else observed.mask.ravel()] = noisy
            solution = method.solve(photograph.reshape(*scenario.photograph_shape, 3))
            errors = method.standard_errors(solution), solution.image - image
            squares.append([np.mean(each**2) for each in errors])
    told_error, error = np.sqrt(np.mean(squares, axis=0)).tolist()
    remarks = dict.fromkeys(" ".join(str(each.message).split()) for each in caught)
    return replace(merit, told_error=told_error, error=error, remark="; ".join(remarks)), own


def _unit_bound(fit: Fit) -> float:
    """Return the root of the mean bound for unit noise; infinite if the wall hides a pattern."""
    curvatures = np.linalg.eigvalsh(fit.gram)
    light = float(np.vdot(fit.transport, fit.transport)) / len(curvatures)
    return float(np.sqrt(np.mean(1 / curvatures))) if curvatures[0] > ROUNDING * light else np.inf


def _ambient_light(B: Image) -> Array:
    """Return the light of all prototypes together, each of norm 1, (M,) of mean 1; 0 of none."""
    norms = np.linalg.norm(B, axis=0)
    light = np.asarray(B @ (1 / np.where(norms > 0, norms, np.inf)), np.float64)
    return np.asarray(light / (light.mean() or 1.0))
