"""Standard errors of a penalized-likelihood estimate: noise, and the pull of total variation.

About f̂ the total variation is replaced by the quadratic function that touches it there, its
gradients rounded off: λΣ‖∇f‖ by λΣ‖∇f‖²/(2√(‖∇f̂‖² + ε²)) = fᵀP f, but for a constant, with
ε = 2 `SMOOTHING`/λ. With noise n in the photograph and H = A⊥ᵀA⊥/σ² + P the estimate errs by

    f̂ − f ≈ H⁻¹ (A⊥ᵀn/σ² − P f),

of covariance, where images f have the covariance τ P⁻¹,

    H⁻¹ (A⊥ᵀA⊥/σ² + τP) H⁻¹ = H⁻¹ + (τ − 1) H⁻¹P H⁻¹.

For τ = 1 it is the posterior's (Laplace's approximation), λ being that of the image's prior. But λ
follows the noise; images of more contrast than such a prior's are pulled farther off the
photograph, and the photograph shows how far: with f_LS the least-squares image, X_c = P H_c⁻¹,

    E Σ_c ‖A⊥(f̂_c − f_LS,c)‖²/σ_c² = Σ_c tr X_c² + τ Σ_c (tr X_c − tr X_c²).

Where the scene itself errs, the photograph holds light Σ_k e_k T_k that A f does not, T_k what an
error of one unit does to it and e of covariance Σ (`uncertain_transport`). It moves the estimate by
H⁻¹A⊥ᵀT_k e_k/σ², alike in all channels, and adds to the covariance

    H⁻¹ A⊥ᵀT Σ TᵀA⊥ H⁻¹ / σ⁴,   T = (T_1, T_2, …):

as the inverse of H beside the scene's errors has it, block by block.

With a colour matrix M, Π = Mᵀ diag(1/σ_c²) M replaces 1/σ² and couples the primaries. With
Π = V diag(π) Vᵀ, the channels Vᵀf are independent.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, sparse

from periscopy_sim.hidden import Differences, Hidden
from periscopy_sim.numerics import Array, Image, Mask

SMOOTHING = 0.5
"""Where gradients are rounded off, over the prior's scale: of the values tried (0.5 to 4) the one
whose map agreed best with actual errors, in size and in place."""

LEAST_SHOWN = 1e-3
"""Degrees of freedom of the pull that the wall shows: where there are fewer, they are rounding."""


def standard_errors(
    gram: Array,
    differences: Differences,
    precision: Array,
    f: Array,
    weight: float,
    misfit: float,
    rank: int,
    response: Array | None = None,
) -> Array:
    """Return the standard error of each patch, (N, 3), in units of the image.

    They assume that A and B are right but for what `response` counts, and that what the wall hides
    of the image varies like what it shows: the pull of total variation on both is alike. What f ≥ 0
    excludes is left out of account, so errors of images with much black are reported too large.

    `gram` is A⊥ᵀA⊥, (N, N), of the given rank, `differences` are those of images and `f` is f̂,
    (N, 3). The precision is Π = Mᵀ diag(1/σ_c²) M, the weight λ > 0, and the misfit
    Σ_c ‖A⊥(f̂_c − f_LS,c)‖²/σ_c² in the camera's channels. The response, (K, 3, N), is A⊥ᵀT Σ^½ of
    the scene's own errors, in the primaries; None for a scene that is right.
    """
    P = curvature_of_total_variation(differences, f, weight)
    noises, pulls = np.empty((2, len(gram), len(precision)))
    response = np.zeros((0, *noises.T.shape)) if response is None else response
    moved = np.zeros((len(response), *noises.shape))
    pulled = squared = 0.0
    π, V = np.linalg.eigh(precision)
    response = np.einsum("ck,jcn->jkn", V, response)
    for channel, weight_of_data in enumerate(π):
        H = weight_of_data * gram + P.toarray()
        # A constant that no pixel shows is not known at all; a little keeps the factor finite.
        H[np.diag_indices_from(H)] += 1e-12 * np.trace(H) / len(H)
        factor, failed = linalg.lapack.dpotrf(H)
        if failed:
            raise np.linalg.LinAlgError("the curvature of the misfit is not positive definite")
        upper, _ = linalg.lapack.dpotri(factor)
        inverse = np.triu(upper) + np.triu(upper, 1).T
        moved[..., channel] = weight_of_data * response[:, channel] @ inverse
        X = P @ inverse
        pulls[:, channel] = np.sum(inverse * X, axis=0)
        # Of H⁻¹ = H⁻¹D H⁻¹ + H⁻¹P H⁻¹ the first is the noise's, the second the pull's.
        noises[:, channel] = np.diag(inverse) - pulls[:, channel]
        pulled += float(np.trace(X))
        squared += float(np.sum(X * X.T))
    unseen = len(π) * (len(gram) - rank)  # each adds 1 to either trace, and nothing to the misfit
    τ = contrast(misfit, pulled - unseen, squared - unseen)
    variances = (noises + τ * pulls) @ (V**2).T + np.sum((moved @ V.T) ** 2, axis=0)
    return np.asarray(np.sqrt(variances))


def displacement(gram: Array, hidden: Hidden, f: Array, response: Array) -> Array:
    """Return how far the scene's own errors displace each surface's image, (surfaces, 2).

    In patches down and across: the root of Σ s_k² over the directions k. The light of the images,
    each moved by its own s_k, is nearest to the effect of direction k, so that no photograph of
    unknown images shows s_k. The other arguments are those of `standard_errors`.
    """
    of_all = np.moveaxis(hidden.differences.slopes(f), -1, 1)
    slopes = np.zeros((len(hidden), *of_all.shape))  # of each surface alone
    for alone, part in zip(slopes, hidden.slices.values(), strict=True):
        alone[..., part] = of_all[..., part]
    slopes = slopes.reshape(-1, *of_all.shape[1:])
    information = np.einsum("acn,nm,bcm->ab", slopes, gram, slopes, optimize=True)
    shifts = np.einsum("acn,kcn->ka", slopes, response) @ np.linalg.pinv(information)
    return np.asarray(np.sqrt(np.sum(shifts**2, axis=0)).reshape(-1, 2))


def contrast(misfit: float, pulled: float, squared: float) -> float:
    """Return τ, from the misfit and the sums of tr X and tr X².

    A τ below 1, which makes errors smaller than the posterior's, is believed up to the standard
    error that noise gives it; where the wall shows nothing of the pull, τ is 1.
    """
    squared = max(squared, 0.0)  # rounding may leave it below
    shown = pulled - squared
    if shown < LEAST_SHOWN:
        return 1.0
    τ = max((misfit - squared) / shown, 0.0)
    return max(τ, min(1.0, τ + float(np.sqrt(2 * squared)) / shown))


def curvature_of_total_variation(differences: Differences, f: Array, weight: float) -> Any:
    """Return the sparse P of the module, (N, N), of images f, (N, C)."""
    D = differences.matrix
    precision = weight / 2 / np.hypot(differences.norms(f), 2 * SMOOTHING / weight)
    return (D.T @ sparse.diags_array(np.tile(precision, 2)) @ D).tocsr()


@dataclass(frozen=True, eq=False)
class UncertainTransport:
    """A scene's parameters θ ~ N(values, L Lᵀ), and the effect of their errors on light.

    θ = values + L u, u ~ N(0, I): the columns of L, its directions, err independently of each
    other. With A nearly linear, A(u) f ≈ A f + Σ u_k D_k f.

    Attributes
    ----------
    names
        Names of the P parameters.
    directions
        (P, K) L, in the units of the parameters.
    slopes
        Returns the derivatives by the parameters, (P, M, channels), of the light of an image,
        (R, C, channels), or of several surfaces a mapping of such by id.
    """

    names: tuple[str, ...]
    directions: Array
    slopes: Callable[[Image | Mapping[str, Image]], Image]

    def lights(self, image: Image | Mapping[str, Image], mask: Mask | None = None) -> Array:
        """Return D f, (K, 3, M'): what each direction's standard error does to an image's light.

        The image is that of `slopes`; M' counts the pixels used.
        """
        used = slice(None) if mask is None else mask.ravel()
        light = self.slopes(image)[:, used]
        return np.asarray(np.einsum("pk,pmc->kcm", self.directions, light))
