"""Standard errors of a penalized-likelihood estimate: noise, and the pull of total variation.

About f̂ the total variation is replaced by the quadratic function that touches it there, its
gradients rounded off: λΣ‖∇f‖ by λΣ‖∇f‖²/(2√(‖∇f̂‖² + ε²)) = fᵀP f, but for a constant, with
ε = 2 `SMOOTHING`/λ. With noise n in the photograph and H = A⊥ᵀA⊥/σ² + P the estimate errs by

    f̂ − f ≈ H⁻¹ (A⊥ᵀn/σ² − P f),

of covariance, where images f have the covariance τ P⁻¹,

    H⁻¹ (A⊥ᵀA⊥/σ² + τP) H⁻¹ = H⁻¹ + (τ − 1) H⁻¹P H⁻¹.

For τ = 1 it is the posterior's (Laplace's approximation), λ being that of the image's prior. But λ
follows the noise, and images do not: those of less contrast than such a prior's are pulled less far
off the photograph. Along the eigenvectors of A⊥P⁻¹A⊥ᵀ, of eigenvalues t_k, the photograph shows the
contrast: its coordinates y_k have variances σ² + τ t_k. The estimate of τ is that of maximum
likelihood in which each coordinate counts by σ²/(σ² + t_k), the fraction of it that the prior fills
in: τ is to hold where the pull acts. The strong coordinates, counted alike, show the contrast of
what needs no prior.

f ≥ 0, edges that f̂ lacks and a scene that errs move f̂ farther off the photograph than that. With
f_LS the least-squares image, X_c = P H_c⁻¹ and Birge's ratio, if above 1, the covariance is times

    R = Σ_c ‖A⊥(f̂_c − f_LS,c)‖²/σ_c² / Σ_c (tr X_c² + τ (tr X_c − tr X_c²)).

Where the scene itself errs, the photograph holds light Σ_k e_k T_k that A f does not, T_k what an
error of one unit does to it and e of covariance Σ (`uncertain_transport`). It moves the estimate by
H⁻¹A⊥ᵀT_k e_k/σ², the same in every channel, and adds to the covariance

    H⁻¹ A⊥ᵀT Σ TᵀA⊥ H⁻¹ / σ⁴,   T = (T_1, T_2, …):

as the inverse of H beside the scene's errors has it, block by block.

With F of full row rank, FᵀF = A⊥ᵀA⊥, and the eigenvectors F P⁻¹Fᵀ = V diag(t) Vᵀ, all of it follows
from Y = P⁻¹FᵀV for any noise, the matrices N x N but for P being diagonal in it, so that fine grids
of few patterns need none: with s = t/(σ² + t), H⁻¹ = P⁻¹ − Y diag(s/t) Yᵀ and X has 1 − s.

With a colour matrix M, Π = Mᵀ diag(1/σ_c²) M replaces 1/σ² and couples the primaries. With
Π = V diag(π) Vᵀ, the channels Vᵀf are independent.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse

from periscopy_sim.hidden import Differences, Hidden, Size
from periscopy_sim.numerics import Array, Image, Mask

SMOOTHING = 0.5
"""Where gradients are rounded off, over the prior's scale: of the values tried (0.5 to 4) the one
whose map agreed best with actual errors, in size and in place."""

LEAST_SHOWN = 1e-3
"""Misfit over the noise that the wall is to show: where it is less, it is rounding."""

CONTRASTS = np.geomspace(1e-6, 1e12, 361)
"""Values of τ that are tried, in steps of 12 %."""


CONSTANT = 10.0
"""Standard error of an image's mean without a photograph, over the largest value. Standard errors
are right to 1e-6 (42 patches); at 1 and at 100, where digits cancel, to 1e-4 and 1e-5."""


def standard_errors(
    factor: Array,
    hidden: Hidden,
    mixing: Array,
    coordinates: Array,
    f: Array,
    weight: float,
    response: Array | None = None,
) -> Array:
    """Return the standard error of each patch, (N, 3), in units of the image.

    They assume that A and B are right but for the errors in `response`, and that the image varies
    alike where the wall hides it and where it shows it: total variation pulls equally on both. They
    ignore that f ≥ 0 excludes images, so they are too large for images with much black.

    `factor` is F, (r, N), of the module, `hidden` the surfaces of images and `f` is f̂, (N, 3). Over
    the σ of the camera's channels, the `mixing` is M and the `coordinates` are those of y⊥, (3, r),
    along the light whose coordinates F f are; the weight is λ > 0. The response, (K, 3, r), is
    (F⁺)ᵀA⊥ᵀT Σ^½ of the scene's own errors, in the primaries; None for a scene that is right.
    """
    P = curvature_of_total_variation(hidden.differences, f, weight)
    # A constant that no pixel shows is not known at all; a little keeps the inverse finite.
    most = CONSTANT * max(float(np.abs(f).max()), 1 / weight)
    P = (P + sparse.eye_array(len(f)) / (len(f) * most**2)).tocsr()
    parts = [*hidden.slices.values()]
    shapes = (surface.shape for surface in hidden.values())
    inverses = [GridInverse(P[p][:, p], s) for p, s in zip(parts, shapes, strict=True)]
    Y = np.vstack([each(factor[:, p].T) for p, each in zip(parts, inverses, strict=True)])
    t, V = np.linalg.eigh(factor @ Y)
    Y, t = Y @ V, np.maximum(t, 0)
    squares = Y**2
    free = np.concatenate([each.diagonal for each in inverses])
    π, U = np.linalg.eigh(mixing.T @ mixing)
    noises, pulls = np.empty((2, len(free), len(π)))
    response = np.zeros((0, len(π), len(t))) if response is None else response
    response = np.einsum("ck,jcr,rs->jks", U, response, V)
    moved = np.zeros((len(response), *noises.shape))
    for channel, weight_of_data in enumerate(π):
        rest = 1 / (1 + weight_of_data * t)  # 1 − s
        gain = weight_of_data * rest  # s/t
        moved[..., channel] = (response[:, channel] * gain) @ Y.T
        # Of H⁻¹ = H⁻¹D H⁻¹ + H⁻¹P H⁻¹ the first is the noise's, the second the pull's.
        noises[:, channel] = squares @ (gain * rest)
        pulls[:, channel] = np.maximum(free - squares @ (gain * (1 + rest)), 0)
    # Along the independent channels Vᵀf of the module, of noise of variance 1.
    axes = mixing @ U / np.sqrt(np.maximum(π, np.finfo(np.float64).tiny))
    y, misfit = (axes.T @ each @ V for each in (coordinates, coordinates - mixing @ (factor @ f).T))
    signals = π[:, None] * t
    τ = contrast(y**2, signals)
    X = 1 / (1 + signals)
    expected = float(np.sum(X**2 + τ * (X - X**2)))
    ratio = max(1.0, float(np.sum(misfit**2)) / expected) if expected > LEAST_SHOWN else 1.0
    variances = ratio * (noises + τ * pulls) @ (U**2).T + np.sum((moved @ U.T) ** 2, axis=0)
    return np.asarray(np.sqrt(variances))


class GridInverse:
    """The inverse of a sparse positive definite matrix that joins neighbours of a grid, (R, C).

    Block elimination along the grid's longer side: blocks of the shorter one are coupled to the
    next by diagonals.
    """

    def __init__(self, matrix: Any, shape: Size) -> None:
        numbers = np.arange(matrix.shape[0]).reshape(shape)
        self._lines = numbers if shape[0] >= shape[1] else numbers.T
        matrix, lines = matrix.tocsr(), self._lines
        pairs = pairwise(lines)
        self._couplings = [matrix[line][:, next_].diagonal()[:, None] for line, next_ in pairs]
        self._inverses = [np.linalg.inv(matrix[lines[0]][:, lines[0]].toarray())]
        for line, e in zip(lines[1:], self._couplings, strict=True):
            block = matrix[line][:, line].toarray() - e * self._inverses[-1] * e.T
            self._inverses.append(np.linalg.inv(block))

    def __call__(self, vectors: Array) -> Array:
        """Return the inverse's product with (N, K)."""
        lines, inverses = self._lines, self._inverses
        x = vectors[lines]
        for n, e in enumerate(self._couplings):
            x[n + 1] -= e * (inverses[n] @ x[n])
        x[-1] = inverses[-1] @ x[-1]
        for n in reversed(range(len(lines) - 1)):
            x[n] = inverses[n] @ (x[n] - self._couplings[n] * x[n + 1])
        result = np.empty_like(vectors)
        result[lines] = x
        return result

    @property
    def diagonal(self) -> Array:
        """(N,) the inverse's diagonal."""
        result = np.empty(self._lines.size)
        block = self._inverses[-1]
        result[self._lines[-1]] = np.diag(block)
        for n in reversed(range(len(self._lines) - 1)):
            e, own = self._couplings[n], self._inverses[n]
            block = own + own @ (e * block * e.T) @ own
            result[self._lines[n]] = np.diag(block)
        return result


def displacement(factor: Array, hidden: Hidden, f: Array, response: Array) -> Array:
    """Return how far the scene's own errors displace each surface's image, (surfaces, 2).

    In patches down and across: the root of Σ s_k² over the directions k. The light of the images,
    each moved by its own s_k, is nearest to the effect of direction k, so that no photograph of
    unknown images shows s_k. The other arguments are those of `standard_errors`.
    """
    of_all = np.moveaxis(hidden.differences.slopes(f), -1, 1)
    slopes = np.zeros((len(hidden), *of_all.shape))  # of each surface alone
    for alone, part in zip(slopes, hidden.slices.values(), strict=True):
        alone[..., part] = of_all[..., part]
    light = slopes.reshape(-1, *of_all.shape[1:]) @ factor.T
    information = np.einsum("acr,bcr->ab", light, light)
    shifts = np.einsum("acr,kcr->ka", light, response) @ np.linalg.pinv(information)
    return np.asarray(np.sqrt(np.sum(shifts**2, axis=0)).reshape(-1, 2))


def contrast(energies: Array, signals: Array) -> float:
    """Return τ, from energies whose means are 1 + τ s for the signals s.

    One energy more, of signal 1, agrees with τ = 1, which is the τ where the wall shows nothing of
    the pull.
    """
    signals, energies = np.append(signals, 1.0), np.append(energies, 2.0)
    weights = 1 / (1 + signals)

    def cost(τ: float) -> float:
        """Return minus the weighted log likelihood, but for a constant."""
        variances = 1 + τ * signals
        return float(np.sum(weights * (np.log(variances) + energies / variances)))

    return float(CONTRASTS[np.argmin([cost(τ) for τ in CONTRASTS])])


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
