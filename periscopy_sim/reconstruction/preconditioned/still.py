"""Algorithm 1: precondition, denoise, repair. Fit once to a scene, reconstruct many photographs."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.transport_operator import as_array
from periscopy_sim.numerics import Array, Image, Mask
from periscopy_sim.numerics.products import times_rows
from periscopy_sim.numerics.validation import (
    checked_companion,
    checked_image,
    checked_number,
    plain_array,
)
from periscopy_sim.reconstruction.method import Report, Solution, StillMethod, of_all
from periscopy_sim.reconstruction.preconditioned.preconditioner import (
    Preconditioner,
    form_preconditioner,
)
from periscopy_sim.reconstruction.total_variation.prox import prox_total_variation


@dataclass(frozen=True, eq=False)
class Estimate:
    """P applied to photographs, before denoising."""

    preconditioned: Image  # (K, N, channels) P y, float32 where P is explicit
    noise: Array  # (K, channels), as in `Solution`
    weight: Array  # (K, channels)


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Solution[np.floating[Any]]):
    """A hidden image, `image`, and the stages that led to it (Fig. 2); see `Solution`.

    Attributes
    ----------
    preconditioned
        (R, C, channels) the estimate P y.
    denoised
        (R, C, channels) after the proximal operator of total variation; `image` is it repaired.
    threshold
        The repair threshold κ used.
    """

    preconditioned: Image
    denoised: Image
    threshold: float

    def numbers(self) -> dict[str, Any]:
        """Return the noise and the weights that followed from it."""
        return {**super().numbers(), "kappa": self.threshold}

    def stages(self, estimate: str) -> list[tuple[str, Image]]:
        """Return titles and images of the stages, the first under a given title."""
        stages = {estimate: self.preconditioned, "denoised": self.denoised, "repaired": self.image}
        return list(stages.items())


class Periscope(StillMethod[np.floating[Any]]):
    """The method `preconditioned` (the paper's Algorithm 1), fitted to one scene.

    Its weights follow the photograph, so that neither exposure nor albedo nor units need tuning:

    - λ is `tv_weight` times the standard error of P y: the noise σ of the photograph, estimated
      from the part of it that [A, B] cannot explain, times the root mean square of √(P Pᵀ)_jj.
    - κ is `repair_threshold` times the 99th percentile of the denoised magnitudes.

    Parameters
    ----------
    A
        (M, N) light transport matrix; kept, and not copied where it is float64 already. With a
        mask, the `preconditioner` takes vectors of the pixels used.
    tv_weight
        λ in standard errors of P y, as above; 0 denoises nothing.
    repair_threshold
        κ as a part of the 99th percentile, as above; infinity repairs nothing.
    explicit
        Form P in float32 once, for speed; otherwise apply it in factored float64, which takes half
        of the memory. The background is projected out in float64 either way. Of the chair's
        29 x 36 patches the images differ by 2e-5 of their root mean square where the SNR is 60 dB,
        and by 3e-3 at 100 dB, where the rounding adds to the noise. Without B, P is always
        factored.
    B, **scene
        As of `StillMethod`, whose other errors it raises, too.

    Raises
    ------
    ValueError
        If A has not full column rank beside B.
    """

    judges_scene = False

    def __init__(
        self,
        A: Image,
        B: Image | None = None,
        *,
        tv_weight: float = 1.0,
        repair_threshold: float = 0.1,
        explicit: bool = True,
        **scene: Any,
    ) -> None:
        super().__init__(A, B, **scene)
        check_settings(tv_weight, repair_threshold)
        # Without B, single precision would round ambient light to more than the noise.
        self.explicit = explicit and B is not None
        self.precision = np.float32 if self.explicit else np.float64
        self.tv_weight = tv_weight
        self.repair_threshold = repair_threshold

    @cached_property
    def preconditioner(self) -> Preconditioner:
        """P in factored form."""
        return form_preconditioner(as_array(self.fit.rows), self.fit.basis)

    @cached_property
    def _matrix(self) -> Image:
        return self.preconditioner.matrix().astype(np.float32)

    @cached_property
    def _factor(self) -> Image | None:
        # Its roundings are independent: of the energy of R f, a sum, they leave 1e-9.
        return self.preconditioner.cholesky.astype(np.float32) if self.explicit else None

    def prepare(self) -> None:
        """Form P; see `StillMethod`."""
        _ = self.preconditioner.noise_gain, self._factor, self.fit.background
        if self.explicit:
            _ = self._matrix

    @of_all
    def solve(self, photograph: Image) -> Reconstruction:
        """Recover the hidden image and keep the stages; see `reconstruct`."""
        estimate = self.estimate(plain_array(photograph)[None])
        first = estimate.preconditioned[0], estimate.noise[0], estimate.weight[0]
        return denoise_and_repair(self.hidden, *first, self.repair_threshold)

    @of_all
    def report(self, photograph: Image, solution: Reconstruction) -> Report:
        """Return the stages of Algorithm 1 and the rank of B; see `StillMethod`."""
        report = super().report(photograph, solution)
        fitted = {"background_rank": self.preconditioner.Q.shape[1], "explicit": self.explicit}
        numbers, stages = {**fitted, **report.numbers}, solution.stages("preconditioned")
        return replace(report, numbers=numbers, stages=stages)

    def estimate(self, photographs: Image) -> Estimate:
        """Precondition photographs, (K, rows, columns, C) or (K, M, C); estimate their noise."""
        P, planes = self.preconditioner, self.fit.planes(photographs)
        # A row for each channel of each photograph.
        y = self.fit.project_out(planes.reshape(-1, planes.shape[-1]))
        if not self.explicit:
            f = P.apply(y.T).T
        else:
            # Single precision needs numbers near 1, in whatever unit the photograph is.
            scale = np.sqrt(np.mean(y**2, axis=1, keepdims=True))
            scale[scale == 0] = 1
            f = scale * times_rows((y / scale).astype(np.float32), self._matrix)
        noise = P.noise(y, f, self._factor).reshape(planes.shape[:2])
        images = np.moveaxis(f.reshape(*planes.shape[:2], -1), 1, -1)
        weight = self.tv_weight * float(np.sqrt(P.noise_gain.mean())) * noise
        return Estimate(images.astype(self.precision), noise, weight)


def check_settings(tv_weight: float, repair_threshold: float) -> None:
    """Reject settings of total variation and repair that are negative or NaN."""
    checked_number(tv_weight, "tv_weight", 0, math.inf)
    checked_number(repair_threshold, "repair_threshold", 0, math.inf)


def denoise_and_repair(
    hidden: Hidden, estimate: Array, noise: Array, weight: Array, repair_threshold: float
) -> Reconstruction:
    """Lead P y, (N, channels), through total variation and repair (Algorithm 1, lines 6 and 8).

    The noise per channel is for the record; λ is (channels,); κ is a fraction,
    `repair_threshold`, of the 99th percentile of the denoised magnitudes.
    """
    denoised = prox_total_variation(estimate, weight, hidden=hidden)
    image, threshold = repaired(hidden, denoised, repair_threshold)
    image, estimate, denoised = map(hidden.image, (image, estimate, denoised))
    return Reconstruction(image, noise, weight, estimate, denoised, threshold)


def repaired(
    hidden: Hidden, denoised: Image, relative_threshold: float, previous: Image | None = None
) -> tuple[Image, float]:
    """Repair images, (N, channels), by a threshold that follows them (Algorithm 2); return κ too.

    κ is a part of the 99th percentile of the magnitudes; infinity repairs nothing. See `repair` for
    the previous frame of a video.
    """
    threshold = relative_threshold
    if np.isfinite(threshold):  # infinity times a black image's 0 would be NaN
        wide = np.asarray(denoised, np.float64)
        magnitude = np.sqrt(np.einsum("nz,nz->n", wide, wide))
        threshold *= float(np.percentile(magnitude, 99))
    before = {} if previous is None else hidden.split(previous)
    repaired = {n: repair(f, threshold, before.get(n)) for n, f in hidden.split(denoised).items()}
    return hidden.join(repaired), threshold


def repair(image: ArrayLike, threshold: float, previous: ArrayLike | None = None) -> Array:
    """Replace the patches whose magnitude is far from their neighbours' mean (Algorithm 2).

    A patch's magnitude is its Euclidean norm over the channels; μ is the mean magnitude of its
    eight neighbours. Where the two differ by more than κ, each channel of the patch becomes the
    median of that channel over the 3 x 3 window about the patch, itself included. Every decision
    and median is of the image given, so that no repair depends on another.

    In a video the window reaches into the previous frame (3 x 3 x 2, Sec. 3.2): the median is
    taken over the eight neighbours, without the patch itself, and the nine patches of the previous
    frame. μ remains that of the eight neighbours: where a whole region has changed, the previous
    frame would make its every patch stick out, and be put back to what it was.

    At the border only patches within the image count, so that a still's median may be the average
    of the two values in the middle. A single patch has no neighbours and stays.

    Parameters
    ----------
    image
        f̄, (rows, columns, channels), of a floating-point type, finite.
    threshold
        κ ≥ 0 in units of the image; infinity repairs nothing.
    previous
        The previous frame, finite, of the shape of the image; None for a still.

    Returns
    -------
    The repaired image, of the same shape and type, float32 at least and float64 at most.

    Raises
    ------
    TypeError, ValueError
        An argument is not as above.
    """
    values = checked_image(image)
    if values.ndim != 3 or values.size == 0:
        raise ValueError(f"image has shape {values.shape}: give (rows, columns, channels)")
    if not threshold >= 0:
        raise ValueError(f"threshold is {threshold}: give a number that is not negative")
    magnitude = np.linalg.norm(values.astype(np.float64), axis=-1)
    ring = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])
    total, count = (
        ndimage.convolve(each, ring, mode="constant")
        for each in (magnitude, np.ones(magnitude.shape))
    )
    outliers = np.abs(magnitude - total / np.maximum(count, 1)) > threshold
    outliers &= count > 0
    windows = _windows(values, outliers)
    if previous is not None:
        windows[..., 4] = np.nan
        before = checked_companion(previous, "previous", values)
        windows = np.concatenate([windows, _windows(before, outliers)], axis=-1)
    repaired = values.copy()
    repaired[outliers] = np.nanmedian(windows, axis=-1)
    return repaired


def _windows(image: Array, where: Mask) -> Array:
    """Return the 3 x 3 windows about some patches, (n, channels, 9), NaN beyond the border."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))[where]
    return windows.reshape(*windows.shape[:2], 9)
