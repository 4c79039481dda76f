"""The hidden image that explains the photograph best, given the photograph's own noise.

    f̂ = argmin_{f ≥ 0} Σ_c ‖A⊥ f_c − y⊥_c‖² / σ_c² + λ Σ ‖∇f‖,   A⊥ = A − Q QᵀA

Q is an orthonormal basis of range(B), so that the misfit is that of y on [A, B] with the ambient
light fitted freely: the very information that P keeps. But the paper goes on from P y as if its
noise were white and alike in all patches (Eq. 10), where its covariance is σ² (A⊥ᵀA⊥)⁻¹. Here the
noise is taken where it is white, in the photograph. Total variation is the colour image's: ‖∇f‖ is
the norm over both directions and all three channels, so that the channels share their edges.

`penalized_likelihood` minimizes it, `ambient_prior` finds ambient light beyond range(B),
`wall_gain` a smooth gain over the wall, `common_noise` noise that the channels share, `uncertainty`
has the errors of f̂.

λ is `regularization` ‖A⊥‖_F/σ, and where the noise has more energy than the signal, the root of
their ratio times as much. f ≥ 0 cuts off at zero what noise total variation leaves, which brightens
the image: without the root, natural images at 30 dB and an SBR of 0.5 came out up to 1.2 times too
bright, with 2.5 times the error. Images with much black still come out 1.1 to 1.6 times too bright
there; `make validate` tabulates it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.numerics.validation import check_stopping
from periscopy_sim.reconstruction.background_photographs import Backgrounds
from periscopy_sim.reconstruction.background_subspace import RANK_TOLERANCE
from periscopy_sim.reconstruction.explained import Explained
from periscopy_sim.reconstruction.large_scale.transport_operator import TransportOperator
from periscopy_sim.reconstruction.method import Image
from periscopy_sim.reconstruction.noise_aware.evidence import (
    Evidence,
)
from periscopy_sim.reconstruction.noise_aware.fitted_scene import FittedScene
from periscopy_sim.reconstruction.noise_aware.nuisance.ambient_prior import (
    AmbientEstimate,
    found_beside,
)
from periscopy_sim.reconstruction.noise_aware.nuisance.common_noise import (
    common_noise,
    noise_covariance,
    shared_part,
)
from periscopy_sim.reconstruction.noise_aware.nuisance.wall_gain import WallGain
from periscopy_sim.reconstruction.noise_aware.predicted_error import best_factor, probes_of
from periscopy_sim.reconstruction.noise_aware.solution import NoiseAwareReconstruction
from periscopy_sim.reconstruction.noise_aware.solver.penalized_likelihood import Objective, Schedule
from periscopy_sim.reconstruction.noise_aware.solver.spectral_basis import laplacian
from periscopy_sim.reconstruction.noise_aware.solver.splitting import Splitting
from periscopy_sim.reconstruction.noise_aware.uncertainty import (
    ASSUMPTIONS,
    ASSUMPTIONS_BUT_ERRORS,
    standard_errors,
    weighed_axes,
)
from periscopy_sim.reconstruction.observation import Mask
from periscopy_sim.reconstruction.residual.residual import Residual
from periscopy_sim.reconstruction.uncertain_scene.displacement import Displacement
from periscopy_sim.reconstruction.uncertain_scene.found_scene import FoundScene
from periscopy_sim.reconstruction.uncertain_scene.uncertain_transport import UncertainTransport

Array = NDArray[np.float64]

REGULARIZATION = 0.02
"""The default, see `NoiseAware`."""

PENALTY = 0.2
"""λ/ρ over the image's scale: the step of the splitting that needed the fewest iterations."""

CHECKED = 10
"""Iterations between two looks at the residuals."""

FIRST = 20
"""Iterations for the image that the gain over the wall is found from; more change nothing."""

RELINEARIZED = 2
"""Times, at most, that an uncertain scene is looked for anew about where it was found."""

STEPS = 1.0, 0.5, 0.25
"""Parts of the way there that are tried, the first that explains the photograph better is taken."""


class NoiseAware(FittedScene):
    """Recover hidden images by penalized likelihood; fit once to a scene.

    λ = `regularization` ‖A⊥‖_F / σ, σ the mean noise of the channels, which follows the
    photograph's noise and units; more where there is more noise than signal, see the module.

    Other parameters and errors are those of `StillMethod`.

    Parameters
    ----------
    regularization
        λ over ‖A⊥‖_F / σ, a number without unit, which fits any grid of patches.
    positive
        Whether f ≥ 0.
    tolerance, max_iterations
        Stop when both relative residuals are at most this, or after so many iterations.
    wall_gain
        Whether stills are searched for a smooth gain over the wall, see `wall_gain`; None where
        the rows and columns of photographs are known, from their shape or the mask's.
    uncertain
        What errors of the scene's parameters do to A. A still is then explained by the scene whose
        parameters it makes most probable, and its standard errors count what is left of theirs; see
        `uncertain_scene`. None where the scene is taken for right.
    ambient_prior
        Whether stills are freed of ambient light beyond range(B), see `ambient_prior`, where their
        rows and columns are known, there is a B, and no background photograph shows that light.

    Raises
    ------
    ValueError
        If B explains all of A, or a gain is asked for and the rows and columns are not known.
    """

    def __init__(
        self,
        A: Image,
        B: Image | None = None,
        *,
        hidden_shape: tuple[int, int],
        channel_gain: Image | None = None,
        rank_tolerance: float = RANK_TOLERANCE,
        regularization: float = REGULARIZATION,
        positive: bool = True,
        tolerance: float = 1e-3,
        max_iterations: int = 1000,
        photograph_shape: tuple[int, int] | None = None,
        mask: Mask | None = None,
        backgrounds: Backgrounds | None = None,
        wall_gain: bool | None = None,
        uncertain: UncertainTransport | None = None,
        ambient_prior: bool = True,
    ) -> None:
        super().__init__(A, hidden_shape, channel_gain, photograph_shape, mask, backgrounds)
        if not 0 < regularization < np.inf:
            raise ValueError(f"regularization is {regularization}: give a positive, finite number")
        check_stopping(tolerance, max_iterations)
        self.regularization = regularization
        self.positive = positive
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        if uncertain is not None:
            uncertain.check(A.shape)
            if self.observation.rows_and_columns is None:
                raise ValueError(
                    "uncertain needs the rows and columns of photographs: give photograph_shape"
                )
        self.uncertain = uncertain
        used = self.observation.used_transport(A)
        self._fit(used, self._ambient_basis(A, B, rank_tolerance), wall_gain, ambient_prior)

    def solve(self, photograph: Image) -> NoiseAwareReconstruction:
        """Return the hidden image and how it came about; see `reconstruct`."""
        found = self._solved(photograph)
        if self.uncertain is not None:
            found = self._relinearized(self.uncertain, photograph, found)
        found.warn_unless_converged()
        return found

    def _solved(self, photograph: Image) -> NoiseAwareReconstruction:
        """Return what the scene that the method is fitted to makes of a photograph."""
        planes, shares, means = self._rejected(np.asarray(photograph)[None])
        (evidence,) = self._evidence(planes, shares)
        ambient = self._ambient_light(evidence, planes[0], means[0])
        light = None if ambient is None else ambient.light
        evidence, y = self._without(evidence, planes[0], light)
        if self._wall_gain is None:
            found, _ = self.recover(self._with_common_noise(evidence, y, light))
        else:
            found = self._recover_with_gain(self._wall_gain, evidence, y, light)
        return replace(found, ambient=ambient)

    def _relinearized(
        self, uncertain: UncertainTransport, photograph: Image, found: NoiseAwareReconstruction
    ) -> NoiseAwareReconstruction:
        """Return the image of the scene that explains a photograph best, from one of it as it is.

        Steps are halved, and end, where they explain it worse, or lead to no scene.
        """
        at, here = self, np.zeros(uncertain.directions.shape[1])
        if uncertain.held:
            return replace(found, scene=FoundScene(uncertain, Displacement.none(len(here)), at))
        left = self.left_of(photograph)
        there = at.displacement(uncertain, left, found, here)
        weights = found.noise[:, None] ** -2 / there.overdispersion
        least = float(np.sum(weights * left**2))
        for _ in range(RELINEARIZED + 1):
            for part in STEPS:
                moved = here + part * (there.moved - here)
                try:
                    tried = self.displaced(uncertain, moved)
                except ValueError:
                    continue
                left = tried.left_of(photograph)
                misfit = float(np.sum(weights * left**2) + moved @ moved)
                if misfit < least:
                    break
            else:
                break
            at, here, least = tried, moved, misfit
            found = at._solved(photograph)
            there = at.displacement(uncertain, left, found, here)
        return replace(found, scene=FoundScene(uncertain, there.reached(here), at))

    def told(self, found: NoiseAwareReconstruction) -> dict[str, Any]:
        """Return the noise, the weight, the iterations and the gain; see `StillMethod`."""
        scene = found.scene
        return {
            **super().told(found),
            "standard_errors_assume": ASSUMPTIONS if scene is None else ASSUMPTIONS_BUT_ERRORS,
            **({} if scene is None else {"uncertain": scene.told()}),
            "wall_gain_found": found.has_gain,
            "wall_gain_range": [float(found.gain.min()), float(found.gain.max())],
            "ambient_light_beyond_lamps": found.ambient_strengths,
        }

    def remark(self, found: NoiseAwareReconstruction) -> str:
        """Return what a gain over the wall and a moved scene mean; see `StillMethod`."""
        moved = "" if found.scene is None else found.scene.remark
        return "; ".join(filter(None, (found.gain_remark, moved)))

    def explained(self, found: NoiseAwareReconstruction) -> Explained:
        """Return how well scene, image and gain explain the photograph; see `StillMethod`."""
        at = self._at(found)
        whole, left = (np.sum(part**2, axis=1) for part in at._explicable(found))
        return Explained(found.evidence.share, whole, left, len(at._curvatures))

    def residual(self, photograph: Image, found: NoiseAwareReconstruction) -> Residual | None:
        """Return what scene, image and gain leave of a photograph; see `StillMethod`."""
        return super(NoiseAware, self._at(found)).residual(photograph, found)

    def _at(self, found: NoiseAwareReconstruction) -> NoiseAware:
        """Return the method fitted to the scene that a solution was found with."""
        if found.scene is None:
            return self
        at: NoiseAware = found.scene.fitted
        return at

    def _signal(self, transport: TransportOperator, found: NoiseAwareReconstruction) -> Array:
        """Return A f̂ + D ê + (g − 1) A f₀ of the gain g, found from a first image f₀.

        D ê is the ambient light beyond range(B).
        """
        light = super()._signal(transport, found)
        if found.ambient is not None:
            light = light + found.ambient.light.T
        if found.first_image is None:
            return light
        gain, mask = found.gain.ravel(), self.observation.mask
        added = (gain if mask is None else gain[mask.ravel()]) - 1
        return light + added[:, None] * transport.light(found.first_image.reshape(-1, 3))

    def _ambient_light(self, evidence: Evidence, y: Array, means: Array) -> AmbientEstimate | None:
        """Return the ambient light beyond range(B) of the y of an evidence, if there is any.

        Light and image are found by turns.
        """
        black = self._ambient_strength(evidence, y, means)
        if black is None:
            return None
        split = None

        def left_beside(light: Array) -> tuple[Array, Array]:
            nonlocal split
            rest, _ = self._without(evidence, y, evidence.level * light)
            found, split = self.recover(rest, start=split)
            left = y - self._light_of(found.image / evidence.level)
            return left, found.noise / evidence.level

        return found_beside(black, left_beside).scaled(evidence.level)

    def recover(
        self,
        evidence: Evidence,
        schedule: Schedule | None = None,
        start: Splitting | None = None,
        previous: Image | None = None,
        l1_weight: float = 0.0,
    ) -> tuple[NoiseAwareReconstruction, Splitting | None]:
        """Return the hidden image of a photograph's evidence, and what was split off.

        The minimum is found by the schedule, or as in `solve`, from what was split off from an
        image nearby, `start`, or from black. In a video λ₂ = `l1_weight` λ is the weight of the
        distance to the frame before, `previous`, (R, C, 3).
        """
        if schedule is None:
            schedule = self._schedule(self.max_iterations)
        unit = evidence.level / self._unit
        before = None if previous is None else np.moveaxis(previous, -1, 0) / unit
        objective = self._objective(evidence, self.regularization)
        minimum = objective.minimize(evidence, schedule, start, before, l1_weight)
        factor = 1.0 if evidence.common is None else evidence.common.factor
        found = NoiseAwareReconstruction(
            image=np.moveaxis(minimum.image.astype(np.float64), 0, -1) * unit,
            noise=evidence.level * evidence.noise,
            weight=objective.regularization
            * factor
            * self.norm
            / (evidence.level * evidence.mean_noise),
            iterations=minimum.iterations,
            residual=minimum.residual,
            tolerance=schedule.tolerance,
            gain=np.ones(self._wall_shape),
            evidence=evidence,
        )
        return found, minimum.split

    def standard_errors(self, found: NoiseAwareReconstruction) -> Array:
        """Return the standard error of each patch of a recovered image, see `uncertainty`.

        They are (R, C, 3), in units of the image, and assume that A and B are right but for the
        errors of uncertain parameters, that a gain over the wall is known, and that what the wall
        hides of the image varies like what it shows. What is not known of ambient light beyond
        range(B) is counted.
        """
        return self._at(found)._standard_errors(found)

    def _standard_errors(self, found: NoiseAwareReconstruction) -> Array:
        evidence, left = found.evidence, self._explicable(found)[1]
        response = self._error_response(found)
        noise, weighed = evidence.level * evidence.noise, None
        if evidence.common is not None:
            σ, common = evidence.mean_noise, evidence.common
            weights = common.weights(σ)
            left = np.sqrt(weights) * (common.axes @ (left * evidence.noise[:, None])) / σ
            noise = np.full(3, evidence.level * σ)
            K = self._unit * laplacian(self.hidden_shape) @ self._basis.rows[self._seen].T
            weighed = weighed_axes(common, σ, K, self._curvatures)
            if response is not None:  # along the axes, each pattern by its weight
                seen = (common.axes @ response) @ self._basis.rows[self._seen].T
                response = (weights * seen) @ (K / self._unit).T
        numbers = found.weight, float(np.sum(left**2)), len(self._curvatures)
        return standard_errors(self._gram, noise, found.image, *numbers, weighed, response)

    def _recover_with_gain(
        self, wall_gain: WallGain, evidence: Evidence, y: Array, light: Array | None
    ) -> NoiseAwareReconstruction:
        """Return the image found from a first one, less what the gain adds to its light.

        The ambient light that was subtracted from y is `_with_common_noise`'s.
        """
        tried = min(FIRST, self.max_iterations // 2)
        first, split = self.recover(evidence, self._schedule(tried))
        image = first.image.reshape(-1, 3).T / evidence.level
        gain = wall_gain.estimate(y, self._coordinates(evidence), evidence.noise, image)
        if gain.accepted:
            evidence, y = self._without(evidence, y, gain.added * evidence.level)
        rest = self._schedule(self.max_iterations - first.iterations)
        found, _ = self.recover(self._with_common_noise(evidence, y, light), rest, split)
        found = replace(found, iterations=first.iterations + found.iterations)
        if not gain.accepted:
            return found
        return replace(found, gain=gain.field, first_image=first.image)

    def _with_common_noise(self, evidence: Evidence, y: Array, light: Array | None) -> Evidence:
        """Return evidence with the noise that the channels share, if they do, and its factor on λ.

        y, (3, M'), is what it is of, of the evidence's level. The ambient light that was subtracted
        from it, (3, M') in the photograph's unit, took noise along: the spectrum is told with it.
        """
        seen, rank = evidence.coefficients[:, self._seen], len(self._background)
        covariance = noise_covariance(y, seen, self._curvatures, rank)
        part = shared_part(covariance)
        if self.observation.rows_and_columns is None or not part:
            return evidence
        whole = y if light is None else y + light / evidence.level
        noise = common_noise(covariance, part, self._unexplained(whole), self._spectrum)
        evidence = replace(evidence, common=noise)
        roots, schedule = np.sqrt(self._curvatures), self._schedule(self.max_iterations)

        def estimate(z: Array, factor: float) -> Array:
            coefficients = evidence.coefficients.copy()
            coefficients[:, self._seen] = noise.axes.T @ (roots * z)
            common = replace(noise, factor=factor)
            tried = replace(evidence, coefficients=coefficients, common=common)
            # At the default weight: another goes with what is found.
            objective = self._objective(tried, REGULARIZATION)
            image = objective.minimize(tried, schedule).image.reshape(3, -1)
            return noise.axes @ self._shown_of(image / self._unit**2) / roots

        z, weights = noise.axes @ (seen / roots), noise.weights(evidence.mean_noise)
        # Drawn in the channels: axes may turn round, or take each other's place.
        probes = noise.axes @ probes_of(seen.shape)
        factor = best_factor(estimate, z, noise.variances, weights, probes) ** part
        return replace(evidence, common=replace(noise, factor=factor))

    def _objective(self, evidence: Evidence, regularization: float) -> Objective:
        regularization *= max(1.0, np.sqrt(evidence.noise_to_signal))
        return Objective(self._basis, self.hidden_shape, regularization, self.positive)

    def _schedule(self, max_iterations: int) -> Schedule:
        return Schedule(PENALTY, self.tolerance, max_iterations, CHECKED)

    def _explicable(self, found: NoiseAwareReconstruction) -> tuple[Array, Array]:
        """Return what A⊥ can explain of y, (3, N'), and what of it the image leaves, over σ."""
        evidence = found.evidence
        shown = self._shown_of(found.image.reshape(-1, 3).T / (evidence.level * self._unit))
        scales = np.sqrt(self._curvatures) * evidence.noise[:, None]
        whole = evidence.coefficients[:, self._seen] / scales
        return whole, whole - shown / scales
