"""Choices of B, the model of ambient light: point lights, area lights, polynomials, photographs.

The paper takes a grid of point lights, and leaves open whether more, nearer or larger lights do
better (Sec. 3.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy import linalg

import periscopy_sim as ps
from periscopy_sim.reconstruction.background_subspace import RANK_TOLERANCE, background_basis
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]

PAPER, NEARER, POLYNOMIAL, RENDERED = (
    "paper's grid, 75 cm steps",
    "nearer: from 0.25 m",
    "polynomials of degree 10",
    "other rendered backgrounds",
)
FINER, COARSER, AREA = "37.5 cm steps", "150 cm steps", "area lights of 0.5 m, 75 cm steps"


@dataclass(frozen=True, eq=False)
class Choice:
    """One choice of B.

    Attributes
    ----------
    name
        What its columns are.
    columns
        Their number.
    bases
        Orthonormal bases (M, r) of what is kept of it, and the conditions each is tried on.
    """

    name: str
    columns: int
    bases: Sequence[tuple[Array, Sequence[str]]]


def choices(
    scenario: Scenario, backgrounds: Mapping[str, Array], library: Sequence[str]
) -> Iterator[Choice]:
    """Form every choice of B, one after another.

    Parameters
    ----------
    scenario
        The scene whose wall is lit.
    backgrounds
        (rows, columns, 3) photographs of ambient light, by condition, that shall be tried.
    library
        Those of them that may serve as columns of B where another is tried.
    """
    names = tuple(backgrounds)
    lights, columns = {}, {}
    for name, grid in grids().items():
        B = ps.point_light_backgrounds(scenario, grid)
        lights[name], columns[name] = sketched_basis(B), B.shape[1]
        yield Choice(name, B.shape[1], [(lights[name], names)])
        if name == PAPER:
            close = sketched_basis(B, rank_tolerance=1e-13)
            yield Choice("the same, tolerance 1e-13", B.shape[1], [(close, names)])
    B = area_lights(scenario)
    lights[AREA], columns[AREA] = sketched_basis(B), B.shape[1]
    yield Choice(AREA, B.shape[1], [(lights[AREA], names)])
    for degree in (2, 4, 6, 8, 10):
        Q = polynomials(scenario.photograph_shape, degree)
        yield Choice(f"polynomials of degree {degree}", Q.shape[1], [(Q, names)])
    rendered = {
        name: photographed([backgrounds[other] for other in library if other != name])
        for name in names
    }
    every = background_basis(np.hstack(list(lights.values())))
    for title, start, count in (
        (RENDERED, np.zeros((len(every), 0)), 0),
        ("paper's grid and other backgrounds", lights[PAPER], columns[PAPER]),
        ("all lights and other backgrounds", every, sum(columns.values())),
    ):
        bases = [(background_basis(np.hstack([start, rendered[n]])), (n,)) for n in names]
        yield Choice(title, count + rendered[names[0]].shape[1], bases)


def grids() -> dict[str, Array]:
    """Grids of point lights: the paper's, other steps, and 512 lights placed otherwise."""
    even, away = np.arange(-3, 3, 0.75), np.arange(1, 7, 0.75)
    above = np.array([-3, -1, 0, 0.6, 1.2, 1.8, 2.4, 3])
    near, far = np.geomspace(0.25, 7, 8), np.geomspace(1, 30, 8)

    def both_sides(least: float, most: float) -> Array:
        side = np.geomspace(least, most, 4)
        return np.concatenate([-side[::-1], side])

    return {
        PAPER: ps.paper_grid(),
        COARSER: ps.paper_grid(1.5),
        FINER: ps.paper_grid(0.375),
        NEARER: grid_of(even, near, even),
        "nearer, denser across": grid_of(both_sides(0.2, 3), near, both_sides(0.2, 3)),
        "denser above": grid_of(even, away, above),
        "nearer, denser above": grid_of(even, near, above),
        "further: to 30 m": grid_of(both_sides(0.75, 30), far, both_sides(0.75, 30)),
        "nearer and further": grid_of(
            both_sides(0.25, 30), np.geomspace(0.25, 30, 8), both_sides(0.25, 30)
        ),
    }


def grid_of(across: Array, away: Array, up: Array) -> Array:
    """Lights at every combination, (L, 3), in metres about the centre of the field of view."""
    axes = np.meshgrid(across, away, up, indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)


def area_lights(scenario: Scenario, side: float = 0.5) -> Array:
    """Square lights parallel to the wall on the paper's grid, by 3 x 3 Gauss-Legendre points."""
    nodes, weights = legendre.leggauss(3)
    offsets = grid_of(nodes, np.zeros(1), nodes) * side / 2
    return np.asarray(
        sum(
            weight * ps.point_light_backgrounds(scenario, ps.paper_grid() + offset)
            for offset, weight in zip(offsets, np.outer(weights, weights).ravel(), strict=True)
        )
    )


def polynomials(shape: tuple[int, int], degree: int) -> Array:
    """Orthonormal polynomials over the wall up to a total degree d: (M, (d + 1)(d + 2) / 2)."""
    rows, columns = (legendre.legvander(np.linspace(-1, 1, n), degree) for n in shape)
    terms = sorted(
        ((i, j) for i in range(degree + 1) for j in range(degree + 1 - i)), key=lambda t: sum(t)
    )
    B = np.stack([np.outer(rows[:, i], columns[:, j]).ravel() for i, j in terms], axis=1)
    return np.asarray(np.linalg.qr(B)[0])


def photographed(backgrounds: Sequence[Array]) -> Array:
    """Channels of backgrounds and of their flips about each axis, as columns of norm 1."""
    flips = [f for b in backgrounds for f in (b, b[::-1], b[:, ::-1], b[::-1, ::-1])]
    B = np.hstack([flip.reshape(-1, 3) for flip in flips])
    return np.asarray(B / np.linalg.norm(B, axis=0))


def sketched_basis(B: Array, *, width: int = 160, rank_tolerance: float = RANK_TOLERANCE) -> Array:
    """`background_basis` of many columns, by way of the range of `width` random mixtures of them.

    The singular values fall so fast that the mixtures span B to rounding (Halko, Martinsson and
    Tropp, SIAM Review 53(2), 2011, Sec. 4).
    """
    scaled = B / np.linalg.norm(B, axis=0)
    mixtures = scaled @ np.random.default_rng(0).normal(size=(B.shape[1], width))
    Q = linalg.qr(mixtures, mode="economic", check_finite=False)[0]
    U, σ, _ = linalg.svd(Q.T @ scaled, full_matrices=False, check_finite=False)
    return np.asarray(Q @ U[:, σ > rank_tolerance * σ[0]])
