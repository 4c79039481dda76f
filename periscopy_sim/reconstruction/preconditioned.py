"""The paper's method: the preconditioner P = [I 0][A, B]^+ (Eq. 5 to 8), denoising, repair.

While range(A) and range(B) meet only in 0, the top rows of [A, B]^+ are the pseudoinverse of A with
range(B) projected out:

    P = (A⊥ᵀ A⊥)⁻¹ A⊥ᵀ,   A⊥ = A − Q Qᵀ A,   Q an orthonormal basis of range(B).

Then P A = I and P B = 0 hold together, so the minimum of Eq. 7, ‖P B‖² + ω ‖P A − I‖², is 0 for
every weight ω > 0: ω is inert and does not appear.

Algorithm 1 recovers stills. In a video (Sec. 3.2, Algorithm 2) each frame is denoised and repaired
together with the one before it.
"""

import math
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, ndimage

from periscopy_sim.hidden import Hidden
from periscopy_sim.model.fit import residual_noise
from periscopy_sim.model.transport_operator import RANK_TOLERANCE, background_basis
from periscopy_sim.numerics import Array, Image, Mask, precision_of, products, validation
from periscopy_sim.reconstruction import method
from periscopy_sim.reconstruction.total_variation import prox_total_variation, solve_total_variation


@dataclass(frozen=True, eq=False)
class Preconditioner:
    """P in factored form; make one by `form_preconditioner`.

    Attributes
    ----------
    A
        (M, N) light transport matrix, float64.
    Q
        (M, r) orthonormal basis of the backgrounds.
    cholesky
        (N, N) upper triangular R with RᵀR = A⊥ᵀ A⊥, C-contiguous.
    """

    A: Array
    Q: Array
    cholesky: Array

    def __repr__(self) -> str:
        """Return its sizes on one line."""
        M, N = self.A.shape
        return f"Preconditioner({N} patches, {M} pixels, backgrounds of rank {self.Q.shape[1]})"

    def project_out(self, y: Image) -> Array:
        """Return photographs, (M,) or (M, K), with range(B) projected out: y − Q Qᵀ y, float64."""
        return np.asarray(y - self.Q @ (self.Q.T @ y))

    def solve(self, g: Array) -> Array:
        """Apply (A⊥ᵀ A⊥)⁻¹ to (N,) or (N, K)."""
        return np.asarray(linalg.cho_solve((self.cholesky.T, True), g, check_finite=False))

    def apply(self, y: Image) -> Array:
        """Return P y, (N,) or (N, K) float64, of photographs, (M,) or (M, K), without forming P."""
        # One step of iterative refinement: the Gram matrix squares A's condition number.
        y = self.project_out(y)
        f = self.solve(self.A.T @ y)
        residual = self.project_out(y - self.A @ f)
        return np.asarray(f + self.solve(self.A.T @ residual))

    def noise(self, y: Image, f: Image, factor: Image | None = None) -> Array:
        """Return σ of photographs, (K,), from what [A, B] leaves of them; see `residual_noise`.

        y is (K, M) with range(B) projected out, f = P y is (K, N). ‖A⊥ f‖ = ‖R f‖, R the Cholesky
        factor or a copy of it in single precision.
        """
        light = products.times_rows(f, self.cholesky if factor is None else factor)
        energy, explained = (np.einsum("km,km->k", rows, rows) for rows in (y, light))
        M, N = self.A.shape
        return residual_noise(energy, explained, M - N - self.Q.shape[1])

    def matrix(self) -> Array:
        """Form P itself, (N, M) float64."""
        A, Q = self.A, self.Q
        inverse, _ = linalg.lapack.dpotri(self.cholesky.T, lower=True)
        inverse += np.tril(inverse, -1).T
        P: Array = inverse @ A.T
        products.subtract_combinations(P, inverse @ (Q.T @ A).T, np.ascontiguousarray(Q.T))
        return P

    @cached_property
    def noise_gain(self) -> Array:
        """(N,) diagonal of P Pᵀ = (A⊥ᵀ A⊥)⁻¹: each patch's Cramér-Rao bound for unit noise."""
        inverse_factor, _ = linalg.lapack.dtrtri(self.cholesky.T, lower=True)
        return np.asarray(np.sum(inverse_factor**2, axis=0))


def form_preconditioner(
    A: Image, B: Image | None = None, *, rank_tolerance: float = RANK_TOLERANCE
) -> Preconditioner:
    """Form the optimized preconditioner of Eq. 8.

    Parameters
    ----------
    A
        (M, N) light transport matrix.
    B
        (M, L) prototype backgrounds; None or no columns gives the pseudoinverse of A.
    rank_tolerance
        Relative tolerance on B's singular values, see `background_basis`.

    Raises
    ------
    ValueError
        If A or B is no dense matrix of real numbers, the shapes do not fit, entries are not finite,
        or A with range(B) projected out has not full column rank: some patch looks like the others
        or like background.
    """
    A = validation.checked_matrix(A, "A")
    B = np.zeros((len(A), 0)) if B is None else validation.checked_matrix(B, "B")
    transport: Array = np.asarray(A, np.float64)
    if A.shape[0] < A.shape[1]:
        raise validation.InputError(
            f"A must have at least as many rows as columns, not shape {A.shape}"
        )
    if B.shape[0] != A.shape[0]:
        raise validation.InputError(
            f"B has shape {B.shape}; its rows must match the {A.shape[0]} of A"
        )
    if not np.isfinite(A).all():
        raise validation.InputError("A must be finite")
    Q = background_basis(B, rank_tolerance)
    # NumPy's BLAS all along: the idle threads of a second one, SciPy's, would take the cores.
    gram = transport.T @ transport
    norms = np.sqrt(np.diag(gram))
    C = Q.T @ transport
    gram -= C.T @ C
    try:
        cholesky = np.asarray(np.linalg.cholesky(gram, upper=True), np.float64)
    except np.linalg.LinAlgError:
        cholesky = np.zeros_like(gram)
    # R_jj is the distance of column j from range(B) and the columns before it. Rounding leaves
    # about 1e-7 of the column's norm where it is 0, and the Gram matrix resolves no less.
    if (np.diag(cholesky) <= max(1e-6, precision_of(A)) * norms).any():
        dark = int((norms <= 1e-7 * norms.max()).sum())
        raise validation.InputError(
            f"A with the backgrounds projected out has not full column rank ({A.shape[1]} patches, "
            f"{dark} of them invisible from the wall): use fewer patches or a smaller monitor, or "
            "the noise-aware method, which needs no rank"
        )
    return Preconditioner(transport, Q, cholesky)


@dataclass(frozen=True, eq=False)
class Estimate:
    """P applied to photographs, before denoising."""

    preconditioned: Image  # (K, N, channels) P y, float32 where P is explicit
    noise: Array  # (K, channels), as in `Solution`
    weight: Array  # (K, channels)


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(method.Solution[np.floating[Any]]):
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


class Periscope(method.StillMethod[np.floating[Any]]):
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
        return form_preconditioner(self.fit.rows, self.fit.basis)

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

    @method.of_all
    def solve(self, photograph: Image) -> Reconstruction:
        """Recover the hidden image and keep the stages; see `reconstruct`."""
        estimate = self.estimate(validation.plain_array(photograph)[None])
        first = estimate.preconditioned[0], estimate.noise[0], estimate.weight[0]
        return denoise_and_repair(self.hidden, *first, self.repair_threshold)

    @method.of_all
    def report(self, photograph: Image, solution: Reconstruction) -> method.Report:
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
            f = scale * products.times_rows((y / scale).astype(np.float32), self._matrix)
        noise = P.noise(y, f, self._factor).reshape(planes.shape[:2])
        images = np.moveaxis(f.reshape(*planes.shape[:2], -1), 1, -1)
        weight = self.tv_weight * float(np.sqrt(P.noise_gain.mean())) * noise
        return Estimate(images.astype(self.precision), noise, weight)


def check_settings(tv_weight: float, repair_threshold: float) -> None:
    """Reject settings of total variation and repair that are negative or NaN."""
    validation.checked_number(tv_weight, "tv_weight", 0, math.inf)
    validation.checked_number(repair_threshold, "repair_threshold", 0, math.inf)


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
    values = validation.checked_image(image)
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
        before = validation.checked_companion(previous, "previous", values)
        windows = np.concatenate([windows, _windows(before, outliers)], axis=-1)
    repaired = values.copy()
    repaired[outliers] = np.nanmedian(windows, axis=-1)
    return repaired


def _windows(image: Array, where: Mask) -> Array:
    """Return the 3 x 3 windows about some patches, (n, channels, 9), NaN beyond the border."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(0, 1))[where]
    return windows.reshape(*windows.shape[:2], 9)


Coupling = Literal["total-variation", "l1", "none"]


class Video(method.FrameByFrame[Reconstruction, np.floating[Any]]):
    """The method `preconditioned` for video, fitted to one scene: frames singly, or many at once.

    The first frame is a still. Each later one is, by `coupling`:

    - ``"l1"``, Eq. 12 as written: argmin_f ‖f − P y‖² + λ‖f‖_TV + λ₂‖f − f_prev‖₁;
    - ``"total-variation"``, as the paper does it instead: the new P y and the previous frame are
      stacked and denoised by the proximal operator of three-dimensional total variation;
    - ``"none"``: denoised on its own.

    The first is the default because it had the smaller error where the scene moves, and it is
    the faster one; a scene that changes everywhere from frame to frame is best left uncoupled.

    Repair follows, its window widened to the previous frame (not with ``"none"``). Each frame's
    dual problem starts from the solution of the one before, which saves a third of the iterations.

    Parameters
    ----------
    still
        The method for stills, whose P, λ and κ serve every frame.
    temporal_weight
        Weight of the difference in time within three-dimensional total variation; the paper's is 1.
    coupling, l1_weight
        As of `FrameByFrame`, whose other errors it raises, too.

    Raises
    ------
    ValueError
        If the `tv_weight` for stills is infinite and the frames are coupled.
    """

    still: Periscope
    couplings = get_args(Coupling)

    def __init__(
        self,
        still: Periscope,
        *,
        coupling: Coupling = "l1",
        temporal_weight: float = 1.0,
        l1_weight: float = 0.4,
    ) -> None:
        super().__init__(still, coupling, l1_weight)
        validation.checked_number(temporal_weight, "temporal_weight", 0)
        if np.isinf(still.tv_weight) and coupling != "none":
            raise ValueError("frames of an infinite tv_weight are flat; couple them by 'none'")
        self.temporal_weight = temporal_weight

    def restart(self) -> None:
        """Forget the latest frame: the next one is a first one."""
        super().restart()
        self._dual: Array | None = None

    def recoveries(self, photographs: method.Series) -> Iterator[Callable[[], Reconstruction]]:
        """Apply P to many photographs in one product; see `FrameByFrame.recoveries`."""
        for still, part in self.still.batches(photographs):
            estimate = still.estimate(part)
            for k in range(len(estimate.noise)):
                yield partial(self.finish, estimate, k)

    def finish(self, estimate: Estimate, k: int) -> Reconstruction:
        """Denoise and repair the k-th of the preconditioned photographs as the next frame."""
        hidden = self.still.hidden
        g, weight = estimate.preconditioned[k], estimate.weight[k]
        images, term, previous = g, dict[str, Any](), None
        if self.coupling != "none" and self.previous is not None:
            previous, term = hidden.vector(self.previous), {"start": self._dual}
            if self.coupling == "l1":
                term |= {"previous": previous, "l1_weight": self.l1_weight * weight}
            else:
                images = np.stack([previous, g])
                term["temporal_weight"] = self.temporal_weight
        result = solve_total_variation(images, weight, hidden, **term)
        result.warn_unless_converged()
        self._dual = result.dual
        denoised = result.image[1] if result.image.ndim == 3 else result.image
        image, threshold = repaired(hidden, denoised, self.still.repair_threshold, previous)
        image, g, denoised = map(hidden.image, (image, g, denoised))
        self.previous = deepcopy(image)  # the caller may change what is returned
        return Reconstruction(image, estimate.noise[k], weight, g, denoised, threshold)
