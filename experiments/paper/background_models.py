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

import periscopy_sim as ps
from periscopy_sim.model.ambient import background_basis
from periscopy_sim.scenario import Scenario

Array = NDArray[np.float64]

PAPER, NEARER, POLYNOMIAL, RENDERED = (
    "paper's grid, 75 cm steps",
    "nearer: from 0.25 m",
    "polynomials of degree 10",
    "other rendered backgrounds",
)
FINER, AREA = "37.5 cm steps", "area lights of 0.5 m, 75 cm steps"
EVEN = np.arange(-3, 3, 0.75)
"""Metres across and up of the paper's grid."""


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
    grids = {
        PAPER: ps.paper_grid(),
        FINER: ps.paper_grid(0.375),
        NEARER: grid_of(EVEN, np.geomspace(0.25, 7, 8), EVEN),
    }
    for name, grid in grids.items():
        B = ps.point_light_backgrounds(scenario, grid)
        yield Choice(name, B.shape[1], [(background_basis(B), names)])
    B = area_lights(scenario)
    yield Choice(AREA, B.shape[1], [(background_basis(B), names)])
    polynomial = polynomials(scenario.photograph_shape, 10)
    yield Choice(POLYNOMIAL, polynomial.shape[1], [(polynomial, names)])
    rendered = {
        name: photographed([backgrounds[other] for other in library if other != name])
        for name in names
    }
    bases = [(background_basis(B), (name,)) for name, B in rendered.items()]
    yield Choice(RENDERED, rendered[names[0]].shape[1], bases)


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
