"""Smooth fields over a wall, fitted to noisy replicas at a few pixels, by which they are judged.

A field may vary faster along one side than along the other, as light past the bars of a window
does. So the polynomials tried have a largest power each for row and column.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import optimize
from scipy.stats import qmc

from periscopy_sim.scenario import Array

LARGEST = (0, 1, 2, 3, 5, 8, 13, 21, 34)
"""Largest powers tried of row and of column."""

MOST, PER_TERM = 170, 1.5
"""Most polynomials of a fit, for time, and fewest sites for each of them. With two sites for each,
light through a window's bars left a bias of 3.1e-4, with one and a half of 2.5e-4."""


def chosen_sites(shape: tuple[int, int], count: int) -> NDArray[np.intp]:
    """Choose at most so many pixels that pin polynomials down: (S,) row-major indices, ascending.

    They are denser near the edges, and few share a row or a column. In a small photograph they are
    all of its pixels.
    """
    pixels = shape[0] * shape[1]
    if pixels <= count:
        return np.arange(pixels)
    sequence = qmc.Sobol(2, scramble=False)
    sites = np.zeros(0, np.intp)
    while len(sites) < count:
        # `_share_before` of a place is uniform.
        place = (1 - np.cos(np.pi * sequence.random(count))) / 2
        row, column = (place * shape).astype(np.intp).T
        sites = np.append(sites, row * shape[1] + column)
        sites = sites[np.sort(np.unique(sites, return_index=True)[1])]
    return np.sort(sites[:count])


def _share_before(place: Array) -> Array:
    """Return the share of sites before a place from 0 to 1 along a side, in the mean.

    It is the arcsine distribution, whose points pin polynomials of any degree down.
    """
    return np.asarray(np.arccos(1 - 2 * place) / np.pi)


@dataclass(frozen=True, eq=False)
class PolynomialFit:
    """Fields fitted by polynomials of powers i of row and j of column, i / a + j / b at most 1.

    A power is 0 where its largest is. The polynomials are orthonormal over the photograph's pixels,
    in their mean.
    """

    shape: tuple[int, int]
    largest: tuple[int, int]  # a and b
    coefficients: Array  # (n, K, C) of K replicas of C fields
    squared_bias: Array  # (C,) which all replicas share, averaged over pixels

    @property
    def squared_error(self) -> Array:
        """Expected squared error of the replicas' mean, (C,), averaged over pixels."""
        K = self.coefficients.shape[1]
        variance = self.coefficients.var(axis=1, ddof=1).sum(axis=0) / K
        return np.asarray(variance + self.squared_bias)

    @property
    def fields(self) -> Array:
        """(M, K, C) at all pixels."""
        basis = polynomials(self.shape, self.largest, np.arange(self.shape[0] * self.shape[1]))
        return np.tensordot(basis, self.coefficients, axes=1)


def polynomial_fits(
    replicas: Array, sites: NDArray[np.intp], shape: tuple[int, int]
) -> Iterator[PolynomialFit]:
    """Fit K ≥ 2 independent replicas, (K, S, C), at (S,) pixels, by each pair of largest powers.

    The residuals of two independent replicas share only what the fit cannot follow, so that the
    mean of their products estimates its square without bias. Were that noise of variance s² over
    the pixels, the squared residual at a site of leverage h would be s² (1 - h), and the squared
    error at pixels of mean leverage g, s² (1 + g): so large it is told. Where sites are dense, each
    stands for fewer pixels; where they are all pixels, the residuals are the errors.
    """
    K, S, C = replicas.shape
    side_by_side = replicas.transpose(1, 0, 2).reshape(S, K * C)
    everywhere = shape[0] * shape[1] == S
    weight = np.ones(S) if everywhere else _pixels_stood_for(sites, shape)
    weight /= weight.sum()
    down, across = (LARGEST if side > 1 else (0,) for side in shape)
    # So many sites take time: powers alike along both sides are tried alone.
    alike = itertools.zip_longest(down, across, fillvalue=0)
    for largest in alike if everywhere else itertools.product(down, across):
        n = _powers(largest, shape).shape[1]
        if n > max(1, min(MOST, int(S / PER_TERM))):
            continue
        basis = polynomials(shape, largest, sites)
        # Over all pixels they are orthonormal.
        Q, R = (basis / np.sqrt(S), np.sqrt(S) * np.eye(n)) if everywhere else np.linalg.qr(basis)
        seen = Q.T @ side_by_side
        residual = (Q @ seen - side_by_side).reshape(S, K, C)
        products = residual.sum(axis=1) ** 2 - (residual**2).sum(axis=1)
        squared = weight @ products
        if not everywhere:
            left = np.maximum(1 - (Q**2).sum(axis=1), np.finfo(float).eps)
            # The mean of φᵀ (Φᵀ Φ)⁻¹ φ over all pixels is the trace, as the mean of φ φᵀ is I.
            elsewhere = float((np.linalg.inv(R) ** 2).sum())
            squared = (weight / left) @ products * (1 + elsewhere)
        bias = np.maximum(squared / (K * (K - 1)), 0)
        yield PolynomialFit(shape, largest, np.linalg.solve(R, seen).reshape(n, K, C), bias)


def _pixels_stood_for(sites: NDArray[np.intp], shape: tuple[int, int]) -> Array:
    """Return how many pixels each of the sites stands for, (S,): 1 over its chance to be one."""
    down, across = (np.diff(_share_before(np.linspace(0, 1, side + 1))) for side in shape)
    share = np.outer(down, across).ravel()

    def found(draws: float) -> Array:
        """Return the chance of each pixel to be among so many points."""
        return np.asarray(-np.expm1(draws * np.log1p(-share)))

    draws = optimize.brentq(lambda n: found(n).sum() - len(sites), 1, 100 / share.min())
    return 1 / found(draws)[sites]


def polynomials(
    shape: tuple[int, int], largest: tuple[int, int], pixels: NDArray[np.intp]
) -> Array:
    """Return those of a `PolynomialFit` at some pixels, (P, n)."""
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
