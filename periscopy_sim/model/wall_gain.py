"""A smooth gain over the wall that the scene lacks, estimated from the photograph itself.

A lens darkens corners, a wall is not quite Lambertian, a monitor's fall-off with angle is fitted:
all that multiplies the penumbrae by something smooth,

    y = g (A f) + B c + n,   g = 1 + Σ_k a_k p_k,

p_k the polynomials of degree ≤ 2 over the wall, without the constant, which no photograph
determines. A first image f₀ determines the few a_k, by least squares on the part of y that no
hidden image and no ambient light explain:

    â = argmin_a Σ_channels ‖(I − F Fᵀ)(y − Σ_k a_k p_k A f₀)‖² / σ²,   F a basis of [A, B, S].

S, the polynomials of degree ≤ 5, accounts for the smooth ambient light that B lacks. The correction
subtracts the gain's light, Σ_k â_k p_k A f₀: to divide y by the gain would bend the ambient light,
too, out of range(B).

Is there a gain at all? But for the estimate of σ, f₀ depends on Fᵀ y alone, of which white noise in
(I − F Fᵀ) y is independent. So without a gain, the K terms explain as much, for each term, as other
directions do that have nothing to do with y, and the ratio of the two is of Fisher's distribution.
It is compared with the polynomials of degrees 6 and 7 in all channels rather than with the
whole residual: where light or scene do not fit the model, its smooth part is larger than noise.

A rendered A errs as well, by some δA that pixels and patches do not share. If the residual, r, is
−δA f₀, then δA is also in the terms and in F, which takes from the products of terms and y

    Σ_pixels p_k r² − ‖r‖² ⟨g_k, f₀⟩/‖f₀‖²,   g_k the image that explains p_k A f₀ best.

How much of r that is remains unknown, but it is no more than A's weakest image shows, because
errors give light to every image that the wall sees. So the ratio is the least one over parts of
both up to that, added to the products, which makes a gain by chance no likelier. A by areas has
next to none: they are 1 % of r at most, on a real photograph. If they could be all of r, the last
digits of B would decide on its gain.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from scipy import optimize, special

from periscopy_sim.model.fit import ERROR_RATE, RESOLVED, FirstImage, Fit, FittedPhotograph
from periscopy_sim.model.transport_operator import ROUNDING
from periscopy_sim.numerics import Array, Image
from periscopy_sim.numerics.products import combine_rows, project_out, times_rows

BOUNDS = 0.2, 5.0
"""Least and greatest gain that is accepted."""

LEAST_UNEXPLAINED = 1e-5
"""Norm of a polynomial's part outside [A, B] that counts as zero: single precision's. At 3e-5 the
image of a real photograph changes by 0.9 %, and one of a painted wall by 6.6 %."""


@dataclass(frozen=True, eq=False)
class GainEstimate:
    """The gain, and how likely it is."""

    probability: float  # upper bound on that of as large a ratio without a gain
    field: Array  # (rows, columns) g
    accepted: bool  # probability below `ERROR_RATE` and gain within `BOUNDS`
    added: Array  # (C, M') light that the gain adds to the model's, range(B) projected out


class WallGain:
    """The correction of a smooth gain over the wall; see the module.

    It raises a ValueError if the rows and columns of photographs are unknown.
    """

    def __init__(self, fit: Fit) -> None:
        shape = fit.shape
        if shape is None:
            raise ValueError("a gain over the wall needs photograph_shape, their rows and columns")
        self._fit = fit
        self._background = fit.background.astype(np.float32)
        self._basis = fit.patterns.rows[fit.visible]
        self._scales = (1 / (np.sqrt(fit.curvatures) * fit.unit)).astype(np.float32)
        self._errors = largest_errors(fit)
        self._QtA = np.ascontiguousarray(fit.operator.QtA, np.float32)
        self._shape = shape
        self._terms = polynomials(shape, 1, 2)
        self._used_terms = self._terms[:, fit.kept].astype(np.float32)
        ambient, compared = (
            np.ascontiguousarray(fit.on_wall(polynomials(shape, *ends).T).T)
            for ends in ((0, 5), (6, 7))
        )
        self._ambient = self._unexplained(ambient, np.zeros((0, ambient.shape[1]), np.float32))
        self._compared = self._unexplained(compared, self._ambient)

    def __call__(
        self, photograph: FittedPhotograph, first_image: FirstImage
    ) -> tuple[FittedPhotograph, Mapping[str, Any]]:
        """Return a photograph without the light that its gain adds, and the gain's range."""
        evidence = photograph.evidence
        image = self._fit.mixed(first_image(photograph)).T / evidence.level
        coordinates = self._fit.coordinates(evidence)
        gain = self.estimate(photograph.y, coordinates, evidence.noise, image)
        if gain.accepted:
            planes = photograph.planes - evidence.level * gain.added
            corrected = replace(photograph, planes=planes)
            both = (each.evidence for each in (photograph, corrected))
            before, after = (np.sum((each.level * each.noise) ** 2) for each in both)
            # A gain in the place of wrong geometry leaves more unexplained than it explains.
            if after < before:
                limits = [float(gain.field.min()), float(gain.field.max())]
                return corrected, {"wall_gain_found": True, "wall_gain_range": limits}
        return photograph, {"wall_gain_found": False, "wall_gain_range": [1.0, 1.0]}

    def estimate(self, y: Array, coordinates: Array, noise: Array, image: Image) -> GainEstimate:
        """Return the gain of a photograph, and whether there is one.

        y, (C, M'), has range(B) projected out and is near 1 in size; its coordinates along the
        A⊥ W_k/√λ_k are (C, N'), its noise has standard deviation σ, (C,). The image is the first
        one, f₀, (C, N) in the camera's channels, in units of y over those of A.
        """
        count, σ = len(self._terms), noise[:, None]
        f = image.astype(np.float32)
        lights = self._fit.lights
        both = np.concatenate([self._fit.coordinates_of(f), coordinates.astype(np.float32)])
        signal, explained = combine_rows(both, lights).reshape(2, *y.shape)  # read once
        signal = (signal + combine_rows(times_rows(f, self._QtA), self._background)) / σ
        light = (self._used_terms[:, None] * signal).reshape(-1, y.shape[1])
        terms = project_out(light.astype(np.float32), self._background)
        shown = times_rows(terms, lights)
        whole = products(terms, count)
        H = whole - products(shown, count) - products(times_rows(terms, self._ambient), count)
        # From the residual, not as a difference of sums of squares: single precision suffices.
        rest = ((y - explained) / σ).astype(np.float32)
        r = np.asarray(project_out(rest, self._ambient), np.float64)
        q = terms.reshape(count, -1).astype(np.float64) @ r.ravel()
        sizes = np.sqrt(np.diag(whole)) + 1e-30
        compared = times_rows(r, self._compared)
        a, probability = np.zeros(count), 1.0
        if compared.size and np.linalg.eigvalsh(H / np.outer(sizes, sizes))[0] > RESOLVED**2:
            a = np.asarray(np.linalg.solve(H, q), np.float64)
            scaled = times_rows(f, self._basis) * self._scales / σ
            errors = self._errors_of_transport(r, shown, scaled, f / σ)
            C = np.linalg.cholesky(H)
            white = (np.linalg.solve(C, part) for part in (errors, -q))
            by_errors = float(np.sum((f / σ) ** 2 @ self._errors, dtype=np.float64))
            # Errors need not lie where r does, but no term is larger than 1.
            most = np.array([np.abs(errors[:, 0]).max(), np.sum(r**2)]) + 1e-30
            parts = 0, np.clip(by_errors / most, ROUNDING, 1)
            least = 2 * optimize.lsq_linear(*white, bounds=parts, method="bvls").cost
            ratio = (least / count) / (float(np.mean(compared**2)) + 1e-30)
            probability = float(special.fdtrc(count, compared.size, ratio))
        field = 1 + (a @ self._terms).reshape(self._shape)
        believed = BOUNDS[0] <= field.min() and field.max() <= BOUNDS[1]
        added = np.tensordot(a, terms.reshape(count, *y.shape), 1) * σ
        accepted = bool(believed and probability < ERROR_RATE)
        return GainEstimate(probability, field, accepted, added)

    def _errors_of_transport(self, r: Array, shown: Image, scaled: Image, f: Image) -> Array:
        """Return what errors of A alone would take from the terms' products with y, (K, 2).

        The products of f, (C, N), with the images g_k are those of `shown`, the coordinates of the
        terms, with `scaled`, (C, r), the products of f with the patterns, over their norms.
        """
        own = self._used_terms @ (r**2).sum(axis=0)
        shares = (r**2).sum(axis=1) / ((f**2).sum(axis=1) + 1e-30)
        shared = np.einsum("kcr,cr,c->k", shown.reshape(len(own), *scaled.shape), scaled, shares)
        return np.stack([own, -shared], axis=1).astype(np.float64)

    def _unexplained(self, rows: Image, others: Image) -> Image:
        """Return an orthonormal basis of what [A, B], and other unit vectors, leave of rows."""
        rest, sizes = rows / np.linalg.norm(rows, axis=1, keepdims=True), np.ones((len(rows), 1))
        for _ in range(3):  # each time from what is rest, single precision suffices
            rest = project_out(rest.astype(np.float32), self._background)
            rest = project_out(project_out(rest, self._fit.lights), others)
            norms = np.linalg.norm(rest, axis=1, keepdims=True)
            rest, sizes = rest / (norms + 1e-30), sizes * norms
        kept = rest[sizes[:, 0] > LEAST_UNEXPLAINED]
        _, sines, basis = np.linalg.svd(kept, full_matrices=False)
        return np.ascontiguousarray(basis[sines > RESOLVED], np.float32)


def polynomials(shape: tuple[int, int], lowest: int, highest: int) -> Array:
    """Return Legendre polynomials, (K, rows · columns), of total degrees in a range, ascending."""
    down, across = (legendre.legvander(np.linspace(-1, 1, size), highest).T for size in shape)
    orders = [(i, degree - i) for degree in range(lowest, highest + 1) for i in range(degree + 1)]
    return np.array([np.outer(down[i], across[j]).ravel() for i, j in orders])


def products(vectors: Image, count: int) -> Array:
    """Return the products of so many terms, (K, K), from (C K, M') vectors, C channels a term."""
    terms = vectors.reshape(count, -1).astype(np.float64)
    return np.asarray(np.einsum("km,lm->kl", terms, terms))


def largest_errors(fit: Fit) -> Array:
    """Return the energy of independent errors in each column of A⊥, (N,), at most.

    They are a fraction s² of the columns' energies, the same in every pixel. So the weakest of N
    images has a fraction s² (1 − √(N/K))² of its patches' energies, K the pixels less the
    dimensions of ambient light, by the least singular value of a random matrix; and A⊥ has no
    weaker one.
    """
    images = fit.patterns.rows[fit.visible]
    energies = np.sum(fit.factor**2, axis=0)
    parts = fit.curvatures * fit.unit**2 / (images**2 @ energies)
    left = 1 - np.sqrt(images.shape[1] / max(1, fit.pixels - len(fit.background)))
    return np.asarray(energies * min(1.0, np.min(parts) / max(left, RESOLVED) ** 2))
