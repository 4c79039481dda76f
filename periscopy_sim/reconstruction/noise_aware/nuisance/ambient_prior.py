"""Ambient light that no lamps of B make: a prior whose strength the photograph tells.

Lamps that stand free light a wall so smoothly that range(B) holds nearly all of it. The edge of a
table, a sill, a blind or a jamb cuts light off, a lamp stands near: what that leaves beyond
range(B) is a thousandth of the ambient light, and as strong as the penumbrae where that light is 20
times the monitor's. So

    y_c = A f_c + Q c_c + D e_c + n_c,   f_c ~ N(0, s_c² K⁻¹),   n_c ~ N(0, σ_c² I),
    e_c ~ N(0, diag(v_c)),   v_c = (κ_g b_c)² M/r_g  in the group g,

D being polynomials over the wall, range(B) projected out and orthonormal, in groups of r_g:
profiles from top to bottom, constant or linear across (edges that lie level); from side to side
(upright ones); and all others up to `DEGREE`. b_c is the mean of the channel's ambient light, so
that κ_g is the root mean square of the group's light over it.

The κ_g are the likeliest among `STRENGTHS`, which end where realistic places do, with f integrated
out; where they are not decidedly likelier than none, there is none. So the model follows the
ambient light's share: with little of it, no D e is believed that would matter. For that

    Σ_c = σ_c² I + s_c² A⊥ K⁻¹ A⊥ᵀ,   H_c = σ_c² Dᵀ Σ_c⁻¹ D,   q_c = σ_c² Dᵀ Σ_c⁻¹ y⊥_c,

K = ∇ᵀ∇ + I is `spectral_basis`'s, and s_c ten times the likeliest one. φ ≥ 1 is how much more than
noise polynomials of higher degrees explain, where there is neither: a scene that is off by
millimetres leaves structure everywhere, and is no ambient light.

That is a rough prior of images, good enough for strengths. Of light that an image could show as
well it would take a part for ambient, and leave ghosts. So image and light are found together: f as
`penalized_likelihood` has it of y − D ê, and beside it, with the errors of D e's model,

    ê_c = v_c/(v_c + φ σ_c²) Dᵀ(y_c − A⊥ f̂_c).

By turns they come to where neither moves the other, from a black ê, σ_c being what is left of noise
at each turn; Anderson's mixing (J. ACM 12, 1965) makes tens of turns of hundreds. Of e's errors see
`AmbientPrior.response`.

Light with edges as sharp as the penumbrae's own is beyond this model; background photographs show
it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import linalg

from periscopy_sim.numerics.products import rejected, times_rows

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

DEGREE = 12
"""Of the polynomials: half a period is a twelfth of the wall. Beyond range(B), light of windows in
rooms had hardly any finer structure."""

COMPARED_DEGREE = 14
"""Up to which further ones tell how much is explained by chance, or by a scene that is off."""

STRENGTHS = 1e-5, 3e-5, 1e-4, 3e-4, 1e-3
"""κ, of the ambient light's mean. Beside a window it was 8e-4."""

LEFT = 1e-5
"""A polynomial of which less is left than this part is one that range(B) holds."""

ROUNDING = 1e-5
"""Of y⊥: the least noise; and of D's unit vectors: what single precision leaves."""

CONTRAST = 100.0
"""s² over the likeliest one: images are smoother than K⁻¹ has them; smooth light may be theirs."""

DECISIVE = 100.0
"""Log likelihood, over that without D e, above which there is such light. Windows at SBR 0.05 made
120 to 470 of the true scene; scenes off by a ruler's errors up to 140 where there was none, light
that bounces off a bright room 166. To find it there cost 4 to 14 % more error."""

TURNS, SETTLED = 40, 3e-3
"""In which image and light are found together, at most; of what the first changes, what the last
does."""

SCALES = np.geomspace(1e-6, 1e6, 61)
"""Of s² about the one at which the image alone would have the photograph's energy."""


@dataclass(frozen=True, eq=False)
class AmbientEstimate:
    """The ambient light beyond range(B) of a photograph, in its unit."""

    coefficients: Array  # (3, r) e
    rows: Image  # (r, M') D, transposed
    strengths: Array  # (3,) κ of each group
    variances: Array  # (3, r) v
    overdispersion: float  # φ

    @property
    def light(self) -> Array:
        """(3, M') D ê."""
        return np.asarray(self.coefficients @ self.rows)

    def shares(self, noise: Array) -> Array:
        """Return v/(v + φ σ²), (3, r), of noise of standard deviations σ, (3,)."""
        whole = self.variances + self.overdispersion * noise[:, None] ** 2
        return np.divide(self.variances, whole, out=np.zeros_like(whole), where=whole > 0)

    def beside(self, left: Array, noise: Array) -> AmbientEstimate:
        """Return the estimate of what an image leaves, (3, M'), of such noise, (3,)."""
        along = times_rows(left.astype(np.float32), self.rows)
        return replace(self, coefficients=self.shares(noise) * along)

    def scaled(self, unit: float) -> AmbientEstimate:
        """Return the estimate in another unit of light."""
        scaled = unit * self.coefficients, self.rows, self.strengths, unit**2 * self.variances
        return AmbientEstimate(*scaled, self.overdispersion)


def found_beside(
    black: AmbientEstimate, left_beside: Callable[[Array], tuple[Array, Array]]
) -> AmbientEstimate:
    """Return the light of an estimate's strengths and the image beside it, found by turns.

    Given light, (3, M'), `left_beside` returns what the image that is found of y⊥ without it leaves
    of y⊥, the light in it, and the noise, (3,), that is left then. y⊥ is near 1 in size. It begins
    with the estimate's light.
    """
    from scipy.optimize import NoConvergence, anderson

    best, least = black.coefficients, np.inf

    def change(e: Array) -> Array:
        nonlocal best, least
        light = replace(black, coefficients=e).light
        left, noise = left_beside(light)
        changed = black.beside(left, np.maximum(noise, ROUNDING)).coefficients - e
        if (size := float(np.linalg.norm(changed))) < least:
            best, least = e.copy(), size
        return changed

    with suppress(NoConvergence):  # where the minimum is flat, or images are hardly iterated
        anderson(
            change, black.coefficients, alpha=1.0, line_search=None, maxiter=TURNS,
            f_tol=np.inf, f_rtol=SETTLED, tol_norm=np.linalg.norm,
        )  # fmt: skip
    return replace(black, coefficients=best)


class AmbientPrior:
    """Estimate ambient light beyond range(B) before one scene's wall; see the module.

    Parameters are those of `WallGain`: Aᵀ, Qᵀ, the patterns W_k and curvatures λ_k of A⊥ᵀA⊥, the
    photograph's shape and mask.

    Attributes
    ----------
    compared
        (K, M') further orthonormal polynomials, range(B) projected out, that no D e is made of.
    """

    def __init__(
        self,
        transport: Image,
        background: Array,
        patterns: Image,
        curvatures: Array,
        photograph_shape: tuple[int, int],
        mask: NDArray[np.bool_] | None = None,
    ) -> None:
        used = slice(None) if mask is None else mask.ravel()
        found: list[Array] = []
        for group in _groups(photograph_shape):
            found.append(_beyond(group[:, used], background, found))
        *groups, compared = found
        scales = 1 / np.sqrt(curvatures)

        def coordinates(rows: Image) -> Array:
            products = times_rows(rows, transport)
            return np.asarray(times_rows(products, patterns) * scales, np.float64)

        self._sizes = np.array([len(group) for group in groups])
        self._rows: Image = np.concatenate(groups).astype(np.float32)
        self.compared: Image = compared.astype(np.float32)
        self._shown = coordinates(self._rows)
        self._compared_shown = coordinates(self.compared)
        brightness = transport.sum(axis=1, keepdims=True).T / np.float32(transport.shape[1])
        self._brightness = times_rows(brightness, patterns)[0] * scales
        self._curvatures = curvatures

    def estimate(
        self, y: Array, coordinates: Array, noise: Array, means: Array
    ) -> AmbientEstimate | None:
        """Return how much ambient light there is beyond range(B); None where there is none.

        Its strengths are told, its light is black yet, see `found_beside`. y, (3, M'), has range(B)
        projected out and is near 1 in size; its coordinates along the A⊥ W_k/√λ_k are
        (3, N'). The standard deviations of its noise, (3,), and the means of the photograph's
        channels, (3,), range(B) not projected out, are in its unit.
        """
        σ = np.maximum(noise, ROUNDING)
        z, single = coordinates / σ[:, None], y.astype(np.float32)
        shares = np.array([_explained_share(each, self._curvatures) for each in z])
        image = shares * z
        ambient = np.maximum(means - σ * (image @ self._brightness), 0)
        by_chance = _Terms(times_rows(single, self.compared), self._compared_shown, σ, shares, z)
        φ = max(1.0, by_chance.mean_ratio())
        terms = _Terms(times_rows(single, self._rows), self._shown, σ, shares, z)
        # Over φ σ², of κ = 1.
        unit = np.outer((ambient / σ) ** 2 / φ, y.shape[1] / np.maximum(self._sizes, 1))

        strengths, likelihood = np.full(len(self._sizes), STRENGTHS[-1]), -np.inf
        for group in range(len(strengths)):
            tried = np.tile(strengths, (len(STRENGTHS), 1))
            tried[:, group] = STRENGTHS
            variances = np.repeat(unit * tried[:, None] ** 2, self._sizes, axis=2)
            likelihoods = terms.evidence(variances, φ)
            best = int(np.argmax(likelihoods))
            strengths, likelihood, v = tried[best], likelihoods[best], variances[best]
        if not likelihood > DECISIVE:
            return None
        return AmbientEstimate(np.zeros_like(v), self._rows, strengths, φ * σ[:, None] ** 2 * v, φ)

    def response(self, transport: Image, found: AmbientEstimate, noise: Array) -> Array:
        """Return A⊥ᵀ D L, (3 r, 3, N), L Lᵀ the covariance of each channel's e in turn.

        It is e's beside an image of which nothing is known, so that only what no image shows tells
        of e: φ σ_c² (I + φ σ_c² diag(v_c)⁻¹ − Dᵀ A⊥ (A⊥ᵀA⊥)⁻¹ A⊥ᵀ D)⁻¹. The transport is Aᵀ,
        (N, M'), that the prior was fitted to; the noise, (3,), is σ_c, what is left without D ê.
        """
        light = times_rows(self._rows, transport).astype(np.float64)
        responses = np.zeros((3, len(light), 3, len(transport)))
        unshown = _definite(np.eye(len(light)) - self._shown @ self._shown.T)
        for channel, (share, σ) in enumerate(zip(found.shares(noise), noise, strict=True)):
            known = np.linalg.cholesky(unshown + np.diag(1 / np.maximum(share, ROUNDING) - 1))
            half = linalg.solve_triangular(known, light, lower=True)
            responses[channel, :, channel] = σ * np.sqrt(found.overdispersion) * half
        return responses.reshape(-1, 3, len(transport))


class _Terms:
    """H and q of some unit vectors for the three channels, over their noise."""

    def __init__(self, products: Image, shown: Array, σ: Array, shares: Array, z: Array) -> None:
        self._q = np.asarray(products, np.float64) / σ[:, None] - (shares * z) @ shown.T
        eye = np.eye(len(shown))
        self._H = np.array([_definite(eye - (shown * share) @ shown.T) for share in shares])

    def mean_ratio(self) -> float:
        """Return qᵀH⁻¹q for each term, which is 1 of noise; 0 without terms."""
        if not self._q.size:
            return 0.0
        solved = np.linalg.solve(self._H, self._q[..., None])[..., 0]
        return float(np.sum(self._q * solved) / self._q.size)

    def evidence(self, v: Array, φ: float) -> Array:
        """Return the log likelihood of prior variances, (..., 3, r) over φ σ², but for a constant.

        It is ½ qᵀ√v (I + √v H √v)⁻¹ √v q/φ − ½ log |I + √v H √v|.
        """
        roots = np.sqrt(v)
        C = np.linalg.cholesky(
            np.eye(v.shape[-1]) + roots[..., None] * self._H * roots[..., None, :]
        )
        half = np.linalg.solve(C, (roots * self._q)[..., None])[..., 0]
        logarithms = np.log(np.diagonal(C, axis1=-2, axis2=-1))
        return np.asarray(np.sum(0.5 * half**2 / φ - logarithms, axis=(-2, -1)))


def _definite(H: Array) -> Array:
    """Return a symmetric H with eigenvalues that rounding left too small raised to `ROUNDING`."""
    values, vectors = np.linalg.eigh(H)
    return np.asarray((vectors * np.maximum(values, ROUNDING)) @ vectors.T)


def _explained_share(z: Array, curvatures: Array) -> Array:
    """Return s²λ/(s²λ + σ²) of the likeliest s, (N',), of coordinates over their noise."""
    ratios = SCALES[:, None] * (curvatures * max(float(z @ z), 1e-30) / curvatures.sum())
    likelihoods = -np.sum(np.log1p(ratios) + z**2 / (1 + ratios), axis=1)
    best: Array = CONTRAST * ratios[int(np.argmax(likelihoods))]
    return best / (1 + best)


def _groups(shape: tuple[int, int]) -> list[Array]:
    """Return polynomials in groups, (K, rows · columns): level, upright, others, compared."""
    down, across = (legendre.legvander(np.linspace(-1, 1, n), COMPARED_DEGREE).T for n in shape)
    profiles, every = range(DEGREE + 1), range(COMPARED_DEGREE + 1)
    others = [(i, j) for i in every[2:] for j in every[2:] if i + j <= COMPARED_DEGREE]
    degrees = [
        [(i, j) for i in profiles for j in (0, 1)],
        [(i, j) for i in (0, 1) for j in profiles],
        [(i, j) for i, j in others if i + j <= DEGREE],
        [(i, j) for i, j in others if i + j > DEGREE],
    ]
    return [np.array([np.outer(down[i], across[j]).ravel() for i, j in g]) for g in degrees]


def _beyond(rows: Array, background: Array, others: list[Array]) -> Array:
    """Return an orthonormal basis of what range(B) and other unit vectors leave of rows."""
    left = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    for _ in range(2):  # once more for what rounding left
        for basis in (background, *others):
            left = rejected(left, basis)
    _, sizes, basis = np.linalg.svd(left, full_matrices=False)
    return np.ascontiguousarray(basis[sizes > LEFT])
