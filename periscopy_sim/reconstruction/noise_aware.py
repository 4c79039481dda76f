"""The hidden image that explains the photograph best, given the photograph's own noise.

    f̂ = argmin_{f ≥ 0} Σ_c ‖A⊥ Σ_k M_ck f_k − y⊥_c‖² / σ_c² + λ Σ ‖∇f‖,   A⊥ = A − Q QᵀA

Q is an orthonormal basis of the ambient light, so that the misfit is that of y on [A, B] with the
ambient light fitted freely: the very information that P keeps. M is the colour matrix from the
monitor's primaries, in which the image is, to the camera's channels, in which the noise is
independent; the identity by default. The paper treats the noise of P y as white and equal in all
patches (Eq. 10), but its covariance is σ² (A⊥ᵀA⊥)⁻¹. This method models the noise in the
photograph, where it is white, couples edges across colours (‖∇f‖ is the norm over both directions
and all primaries), and constrains f ≥ 0.

λ is `regularization` ‖A⊥‖_F ‖M1‖/(√C σ) with C channels, so that grey images are regularized as
without M, and where the noise has more energy than the signal, the root of their ratio times as
much. f ≥ 0 cuts off the remaining noise at zero, which brightens the image: without the root,
natural images at 30 dB and an SBR of 0.5 were up to 1.2 times too bright, with 2.5 times the error.
Images with much black are still 1.1 to 1.6 times too bright there; `make validate` tabulates it.

In a video each frame is drawn towards the one before it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal, Self, get_args

import numpy as np

from periscopy_sim.model.ambient_lines import AmbientLines
from periscopy_sim.model.fit import Correction, Evidence, Fit, FittedPhotograph
from periscopy_sim.model.paint import Paint
from periscopy_sim.model.uncertainty import UncertainTransport, displacement, standard_errors
from periscopy_sim.model.wall_gain import WallGain
from periscopy_sim.numerics import Array, Image, validation
from periscopy_sim.reconstruction import method
from periscopy_sim.reconstruction.penalized_likelihood import Objective, Schedule, Splitting

FIRST = 20
"""Iterations for the image that corrections start from; more change nothing."""

UNCERTAIN_PLACE = 0.5
"""Standard error of the image's place, in patches, above which a report has a note of it."""


@dataclass(frozen=True, eq=False, repr=False)
class NoiseAwareReconstruction(method.Solution[np.float64]):
    """A hidden image and how it came about; see `Solution`. One λ serves all channels.

    Attributes
    ----------
    iterations
        Number of iterations.
    residual
        The larger of the relative primal and dual residuals (Boyd et al., Sec. 3.3) at the end.
    tolerance
        The largest residual that counts as converged.
    evidence
        The photograph's information on the image.
    photograph
        The photograph, corrected.
    corrections
        The corrections' numbers, by name.
    exposures, exposure_errors
        Of several views each one's exposure over the first one's, and its relative standard error;
        by camera. Noise and image are in units of the first photograph.
    views
        Of several views each one's own solution, by camera, with the image of this view alone.
    """

    weight: float
    iterations: int
    residual: float
    tolerance: float
    evidence: Evidence
    photograph: FittedPhotograph | None = None
    corrections: Mapping[str, Any] = field(default_factory=dict)
    exposures: Mapping[str, float] = field(default_factory=dict)
    exposure_errors: Mapping[str, float] = field(default_factory=dict)
    views: Mapping[str, Self] = field(default_factory=dict)

    def numbers(self) -> dict[str, Any]:
        """Return the noise, the weight, the iterations, corrections' numbers and exposures."""
        own = {**self.corrections, **super().numbers(), "iterations": self.iterations}
        of_views = {"exposures": self.exposures, "exposure_errors": self.exposure_errors}
        return own | (of_views if self.views else {})

    def notes(self) -> list[method.Note]:
        """Return notes of exposures, of lines of ambient light and of a gain over the wall."""
        numbers, notes, (first, *others) = (
            self.corrections,
            list[method.Note](),
            [*self.exposures] or [""],
        )
        for camera in others:
            exposure, error = self.exposures[camera], self.exposure_errors[camera]
            number = {"camera": camera, "exposure": exposure, "error": exposure * error}
            notes.append(method.Note("exposure_of", {**number, "first": first}))
        if numbers.get("ambient_lines_found"):
            notes.append(method.Note("ambient_lines"))
        if numbers.get("wall_gain_found"):
            low, high = numbers["wall_gain_range"]
            notes.append(method.Note("wall_gain", {"low": low, "high": high}))
        return notes

    @property
    def converged(self) -> bool:
        """Whether the residual is at most the tolerance."""
        return self.residual <= self.tolerance

    def warn_unless_converged(self) -> None:
        """Warn where the iterations did not suffice."""
        arguments = self.iterations, self.residual, self.tolerance
        validation.warn_unconverged("noise-aware recovery", *arguments, stacklevel=4)


class NoiseAware(method.StillMethod[np.float64]):
    """Recover hidden images by penalized likelihood; fit once to a scene.

    λ follows the photograph's noise and units, see the module.

    Parameters
    ----------
    regularization
        λ over ‖A⊥‖_F ‖M1‖ / (√C σ), without unit, which fits any grid of patches.
    positive
        Whether f ≥ 0.
    tolerance, max_iterations
        Stop when both relative residuals are at most this, or after so many iterations.
    profiles
        Whether ambient light may vary freely down and across the wall, see `wall_profiles`.
    corrections
        Classes or callables that make a `Correction` of a `Fit`, in order; () for the plain method.
        None for the default: paint where there are background photographs, lines of ambient light,
        and a smooth gain over the wall, all only if the rows and columns of photographs are given.
    uncertain
        Effect of the scene's parameter errors on light, which standard errors then include. None if
        the scene is right.
    A, B, **scene
        As of `StillMethod`, whose other errors it raises, too.

    Raises
    ------
    ValueError
        If B explains all of A, or a correction needs the rows and columns of photographs.
    """

    mixes_colours = True

    def __init__(
        self,
        A: Image,
        B: Image | None = None,
        *,
        regularization: float = 0.02,
        positive: bool = True,
        tolerance: float = 1e-3,
        max_iterations: int = 1000,
        profiles: bool = True,
        corrections: Sequence[Callable[[Fit], Correction]] | None = None,
        uncertain: UncertainTransport | None = None,
        **scene: Any,
    ) -> None:
        super().__init__(A, B, **scene)
        self.fit = replace(self.fit, profiles=profiles, uncertain=uncertain)
        if not 0 < regularization < np.inf:
            raise ValueError(f"regularization is {regularization}: give a positive, finite number")
        validation.check_stopping(tolerance, max_iterations)
        self.regularization = regularization
        self.positive = positive
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self._corrections = corrections

    @cached_property
    def corrections(self) -> list[Correction]:
        """The corrections, made for the fit."""
        chosen = self._corrections
        if chosen is None:
            has_paint = self.fit.monitor_off and self.fit.smooth_rank
            chosen = [*([Paint] if has_paint else []), AmbientLines, WallGain]
            chosen = [] if self.fit.shape is None else chosen
        return [each(self.fit) for each in chosen]

    def prepare(self) -> None:
        """Compute the spectral basis, and what corrections need; see `StillMethod`."""
        _ = self.fit.lights, self.corrections

    @method.of_all
    def solve(self, photograph: Image) -> NoiseAwareReconstruction:
        """Return the hidden image and how it came about; see `reconstruct`."""
        (planes,) = self.fit.planes(validation.plain_array(photograph)[None])
        corrected = FittedPhotograph(planes, self.fit)
        summary, iterations = dict[str, Any](), 0
        split: Splitting | None = None

        def first_image(photograph: FittedPhotograph) -> Array:  # started from the one before
            nonlocal iterations, split
            most = min(FIRST, (self.max_iterations - iterations) // 2)
            schedule = Schedule(self.tolerance, most)
            first, split = self.recover(photograph.evidence, schedule, split)
            iterations += first.iterations
            return first.image

        for correction in self.corrections:
            corrected, numbers = correction(corrected, first_image)
            summary.update(numbers)
        schedule = Schedule(self.tolerance, self.max_iterations - iterations)
        solution, _ = self.recover(corrected.evidence, schedule, split)
        iterations += solution.iterations
        solution = replace(
            solution, iterations=iterations, photograph=corrected, corrections=summary
        )
        solution.warn_unless_converged()
        return solution

    def recover(
        self,
        evidence: Evidence,
        schedule: Schedule | None = None,
        start: Splitting | None = None,
        previous: Image | None = None,
        l1_weight: float = 0.0,
    ) -> tuple[NoiseAwareReconstruction, Splitting | None]:
        """Return the hidden image of a photograph's evidence, and the split variables.

        The schedule, or that of `solve`, runs from the split variables of a nearby image, `start`,
        or from black. In a video λ₂ = `l1_weight` λ is the weight of the
        distance to the frame before, `previous`, (R, C, channels).
        """
        schedule = schedule or Schedule(self.tolerance, self.max_iterations)
        mixing = self._mixing(len(evidence.noise))
        strength = float(np.linalg.norm(mixing.sum(axis=1))) / np.sqrt(len(mixing))  # of grey
        unit = evidence.level / (self.fit.unit * strength)
        before = None if previous is None else self.hidden.vector(previous).T / unit
        regularization = self.regularization * max(1.0, float(np.sqrt(evidence.noise_to_signal)))
        objective = Objective(
            self.fit.patterns, self.hidden, mixing / strength, regularization, self.positive
        )
        minimum = objective.minimize(evidence, schedule, start, before, l1_weight)
        λ = regularization * self.fit.norm * strength / (evidence.level * evidence.mean_noise)
        solution = NoiseAwareReconstruction(
            image=self.hidden.image(minimum.image.T.astype(np.float64) * unit),
            noise=evidence.level * evidence.noise,
            weight=λ,
            iterations=minimum.iterations,
            residual=minimum.residual,
            tolerance=schedule.tolerance,
            evidence=evidence,
        )
        return solution, minimum.split

    def evidence(self, photographs: Image) -> list[Evidence]:
        """Return what the objective needs of each photograph, Aᵀ applied to all in one product.

        They are (K, rows, columns, C) or (K, M, C), linear, each in any unit; nothing is corrected.
        """
        return self.fit.evidence(self.fit.planes(photographs))[0]

    @method.of_all
    def report(self, photograph: Image, solution: NoiseAwareReconstruction) -> method.Report:
        """Return standard errors, residual and corrections beside the image; see `StillMethod`."""
        return self.with_errors(super().report(photograph, solution), solution)

    def with_errors(
        self, report: method.Report, solution: NoiseAwareReconstruction
    ) -> method.Report:
        """Return a report with standard errors, and notes of the place and of the corrections."""
        response, notes = self._response(solution), solution.notes()
        counted = [] if self.fit.uncertain is None else list(self.fit.uncertain.names)
        numbers = {**report.numbers, "standard_errors_count": counted}
        if response is not None:
            f = self.hidden.vector(solution.image)
            places = displacement(self.fit.factor, self.hidden, f, response).tolist()
            by_id = dict(zip(self.hidden, places, strict=True))
            numbers["place_standard_error"] = self.hidden.unwrapped(by_id)
            if (most := max(map(max, places))) > UNCERTAIN_PLACE:
                notes.append(method.Note("place", {"most": most}))
        errors = self.standard_errors(solution)
        return replace(report, numbers=numbers, notes=notes, standard_errors=errors)

    def standard_errors(self, solution: NoiseAwareReconstruction) -> Array:
        """Return the standard error of each patch of a recovered image, see `model.uncertainty`.

        They are (R, C, channels), in units of the image, and assume that A and B are right but for
        the errors of uncertain parameters, that the corrections are, and that what the wall hides
        of the image varies like what it shows.
        """
        evidence = solution.evidence
        noise = evidence.noise[:, None]
        errors = standard_errors(
            self.fit.factor,
            self.hidden,
            self._mixing(len(noise)) / (evidence.level * noise),
            self.fit.coordinates(evidence) / noise,
            self.hidden.vector(solution.image),
            solution.weight,
            self._response(solution),
        )
        image: Array = self.hidden.image(errors)
        return image

    def _response(self, solution: NoiseAwareReconstruction) -> Array | None:
        """Return what the scene's errors do to the image's light; see `Fit.response`."""
        lights = self.fit.motions(solution.image)
        return None if lights is None else self.fit.response(lights)

    def corrected(self, photograph: Image, solution: NoiseAwareReconstruction) -> Array:
        """Return the photograph without the corrections' light; see `StillMethod`."""
        if solution.photograph is None:
            return super().corrected(photograph, solution)
        return np.ascontiguousarray(solution.photograph.planes.T)

    def _mixing(self, channels: int) -> Array:
        """Return the matrix from images to the channels of the evidence, (C, P)."""
        return np.eye(channels) if self.fit.mixing is None else self.fit.mixing


Coupling = Literal["l1", "none"]

PENALTY = 0.4
"""λ/ρ over the image's scale: the step that needed the fewest iterations from a frame nearby."""

LOOSER = 3.0
"""Tolerance over that of a still: with this step, it leaves a frame as near to its minimum."""


class NoiseAwareVideo(method.FrameByFrame[NoiseAwareReconstruction, np.float64]):
    """The noise-aware method for video, fitted to one scene: one frame at a time, or many at once.

    The first frame is a still. Each later one is, by `coupling`:

    - ``"l1"``, Eq. 12 with the misfit taken in the photograph: the minimizer of the still's
      objective plus λ₂ Σ‖f − f_prev‖, the norm over a patch's channels, so that a patch stays as
      it was or changes in all its colours;
    - ``"none"``: a still.

    Each frame starts from the solution of the one before, which saves a sixth of the iterations
    and does not move the minimum: of what was before, a frame depends on the frame before alone.
    Frames are not corrected (`Correction`): a gain over the wall would differ between them.

    Errors are those of `FrameByFrame`.
    """

    still: NoiseAware
    couplings = get_args(Coupling)

    def __init__(
        self, still: NoiseAware, *, coupling: Coupling = "l1", l1_weight: float = 0.8
    ) -> None:
        super().__init__(still, coupling, l1_weight)

    def restart(self) -> None:
        """Forget the latest frame: the next frame starts a video."""
        super().restart()
        self._split: Splitting | None = None

    def recoveries(
        self, photographs: method.Series
    ) -> Iterator[Callable[[], NoiseAwareReconstruction]]:
        """Apply A to many photographs in one product; see `FrameByFrame.recoveries`."""
        for still, part in self.still.batches(photographs):
            for evidence in still.evidence(part):
                yield partial(self.finish, still, evidence)

    def finish(self, still: NoiseAware, evidence: Evidence) -> NoiseAwareReconstruction:
        """Return the next frame from its photograph's evidence by the still that it is for."""
        if self.previous is None:
            solution, split = still.recover(evidence)
        else:
            weight = self.l1_weight if self.coupling == "l1" else 0.0
            tolerance = LOOSER * still.tolerance
            penalty = PENALTY / max(1.0, weight)  # the step follows the larger of λ and λ₂
            schedule = Schedule(tolerance, still.max_iterations, penalty)
            solution, split = still.recover(evidence, schedule, self._split, self.previous, weight)
        solution.warn_unless_converged()
        self._split = split
        self.previous = deepcopy(solution.image)  # the caller may change what is returned
        return solution
