"""Smooth fields over a wall, fitted to noisy replicas at a few pixels, by which they are judged.

A field may vary faster along one side than along the other, as light past the bars of a window
does. So the polynomials tried have a largest power each for row and column.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.stats import qmc

from periscopy_sim.numerics import Array

REPLICAS = 8
"""Independent estimates of a field; their scatter gives its error to a quarter, 1 / sqrt(14)."""

SITES = 256
"""Pixels at which a field is estimated, and whose brightness stands for the photograph's."""

POWERS = (0, 1, 2, 3, 5, 8, 13, 21, 34)
"""Largest powers tried of row and of column: Fibonacci's numbers, each some 1.6 times the last."""

PER_TERM = 1.5
"""Fewest sites for each polynomial. With two, light through a window's bars left a bias of 3.1e-4,
with one and a half of 2.5e-4."""


def chosen_sites(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Choose at most `SITES` pixels that pin polynomials down: row-major indices, ascending.

    They are denser near the edges, and few share a row or a column. In a small photograph they are
    all of its pixels.
    """
    pixels = shape[0] * shape[1]
    if pixels <= SITES:
        return np.arange(pixels)
    sequence = qmc.Sobol(2, scramble=False)
    sites = np.zeros(0, np.intp)
    while len(sites) < SITES:
        # The arcsine distribution, whose points pin polynomials of any degree down.
        place = (1 - np.cos(np.pi * sequence.random(SITES))) / 2
        row, column = (place * shape).astype(np.intp).T
        sites = np.append(sites, row * shape[1] + column)
        sites = sites[np.sort(np.unique(sites, return_index=True)[1])]
    return np.sort(sites[:SITES])


@dataclass(frozen=True, eq=False)
class FieldFit:
    """Fields fitted by polynomials of powers i of row and j of column, i / a + j / b at most 1.

    A power is 0 where its largest is. The polynomials are orthonormal over the photograph's pixels,
    in their mean. Without largest powers each pixel is fitted alone.
    """

    shape: tuple[int, int]
    largest: tuple[int, int] | None  # a and b
    coefficients: Array  # (n, K, C) of K replicas of C fields
    squared_bias: Array  # (C,) which all replicas share, averaged over pixels

    @property
    def squared_error(self) -> Array:
        """Expected squared error of the replicas' mean, (C,), averaged over pixels."""
        n, K, _ = self.coefficients.shape
        variance = self.coefficients.var(axis=1, ddof=1).sum(axis=0) / K
        return np.asarray(variance / (n if self.largest is None else 1) + self.squared_bias)

    @cached_property
    def replicas(self) -> Array:
        """(K, M, C) at all pixels."""
        values = self.coefficients
        if self.largest is not None:
            basis = polynomials(self.shape, self.largest, np.arange(np.prod(self.shape)))
            values = np.tensordot(basis, values, axes=1)
        return values.transpose(1, 0, 2)

    def functions(self, pixels: NDArray[np.intp]) -> Array:
        """Return the functions of the pixel that are fitted, (P, n), at some pixels."""
        if self.largest is None:
            return np.eye(len(self.coefficients))[pixels]
        return polynomials(self.shape, self.largest, pixels)


def best_fit(replicas: Array, sites: NDArray[np.intp], shape: tuple[int, int]) -> FieldFit:
    """Fit K ≥ 2 independent replicas, (K, S, C), at (S,) pixels, by the powers that err least.

    Where every pixel was sampled, the samples themselves compete.
    """
    fits = polynomial_fits(replicas, sites, shape)
    if len(sites) == shape[0] * shape[1]:
        alone = FieldFit(shape, None, replicas.transpose(1, 0, 2), np.zeros(replicas.shape[2]))
        fits = itertools.chain([alone], fits)
    return min(fits, key=lambda fit: float(fit.squared_error.sum()))


def polynomial_fits(
    replicas: Array, sites: NDArray[np.intp], shape: tuple[int, int]
) -> Iterator[FieldFit]:
    """Fit K ≥ 2 independent replicas, (K, S, C), at (S,) pixels, by each pair of largest powers.

    The residuals of two independent replicas share only what the fit cannot follow, so that the
    mean of their products estimates its square without bias. Were that noise of variance s² over
    the pixels, the squared residual at a site of leverage h would be s² (1 - h), and the squared
    error at pixels of mean leverage g, s² (1 + g), which the fit reports. Where sites are dense,
    each stands for fewer pixels; where they are all pixels, the residuals are the errors.
    """
    K, S, C = replicas.shape
    side_by_side = replicas.transpose(1, 0, 2).reshape(S, K * C)
    everywhere = shape[0] * shape[1] == S
    weight = np.ones(S) if everywhere else 1 / _chances(shape, S)[sites]
    weight /= weight.sum()
    down, across = (POWERS if side > 1 else (0,) for side in shape)
    # So many sites take time: powers alike along both sides are tried alone.
    alike = itertools.zip_longest(down, across, fillvalue=0)
    for largest in alike if everywhere else itertools.product(down, across):
        n = _powers(largest, shape).shape[1]
        if n > max(1, int(min(SITES, S) / PER_TERM)):
            continue
        basis = polynomials(shape, largest, sites)
        # Over all pixels they are orthonormal.
        Q, R = (basis / np.sqrt(S), np.sqrt(S) * np.eye(n)) if everywhere else np.linalg.qr(basis)
        seen = Q.T @ side_by_side
        residual = (Q @ seen - side_by_side).reshape(S, K, C)
        products = residual.sum(axis=1) ** 2 - (residual**2).sum(axis=1)
        squared = weight @ products
        if not everywhere:
            free = np.maximum(1 - (Q**2).sum(axis=1), np.finfo(float).eps)
            # The mean of φᵀ (Φᵀ Φ)⁻¹ φ over all pixels is the trace, as the mean of φ φᵀ is I.
            elsewhere = float((np.linalg.inv(R) ** 2).sum())
            squared = (weight / free) @ products * (1 + elsewhere)
        bias = np.maximum(squared / (K * (K - 1)), 0)
        yield FieldFit(shape, largest, np.linalg.solve(R, seen).reshape(n, K, C), bias)


def _chances(shape: tuple[int, int], count: int) -> Array:
    """Return each pixel's chance to be one of so many sites, (M,), by the arcsine distribution."""
    edges = (np.linspace(0, 1, side + 1) for side in shape)
    down, across = (np.diff(np.arccos(1 - 2 * edge)) / np.pi for edge in edges)
    return np.minimum(1, count * np.outer(down, across).ravel())


def polynomials(
    shape: tuple[int, int], largest: tuple[int, int], pixels: NDArray[np.intp]
) -> Array:
    """Return those of a `FieldFit` at some pixels, (P, n)."""
    i, j = _powers(largest, shape)
    row, column = np.divmod(pixels, shape[1])
    down, across = (_along(side, each) for side, each in zip(shape, largest, strict=True))
    values = down[row][:, i]
    values *= across[column][:, j]
    return np.asarray(values)


def _powers(largest: tuple[int, int], shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the powers of row and column in each polynomial, (2, n).

    Along a side of n pixels no power beyond n - 1 is another function.
    """
    i, j = np.indices([min(each + 1, n) for each, n in zip(largest, shape, strict=True)])
    a, b = np.maximum(largest, 1)
    return np.stack([i, j])[:, b * i + a * j <= a * b]


def _along(pixels: int, largest: int) -> Array:
    """Polynomials along a side, (pixels, powers), orthonormal in the mean over it."""
    centers = (2 * np.arange(pixels) + 1) / pixels - 1
    Q, R = np.linalg.qr(legendre.legvander(centers, min(largest, pixels - 1)))
    return np.asarray(np.sqrt(pixels) * Q * np.sign(np.diag(R)))
