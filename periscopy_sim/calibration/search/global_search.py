"""From a start that is far off to the neighbourhood of the best: where no slope can be trusted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values, Visit
from periscopy_sim.scenario import Array

ELITE = 10
"""Points of a generation from which the next is drawn."""

FIRST, LATER, GENERATIONS = 256, 64, 4
"""Points of the first generation and of each later one, and how many later ones there are."""

FEW = 3
"""Parameters for which half of the first generation does."""


def first_generation(parameters: int) -> int:
    """Return how many points the first generation has."""
    return FIRST // 2 if parameters <= FEW else FIRST


def points_visited(parameters: int) -> int:
    """Return how many points `explore` visits."""
    return first_generation(parameters) + GENERATIONS * LATER


def explore(
    level: ResolutionLevel,
    start: Values,
    widths: Values,
    seed: int,
    visit: Visit,
) -> Values:
    """Return the best, (P,), of many points, generation by generation; each is passed to `visit`.

    The first generation is spread evenly (Sobol's sequence) over a box about the start, (P,), which
    is one of its points, with half widths `widths`, (P,). Each later one is drawn from the normal
    distribution of the best points so far (the cross-entropy method: Rubinstein, Methodol. Comput.
    Appl. Probab. 1, 1999). Points that are not physical lose.
    """
    from scipy.stats import qmc

    def evidence(point: Values) -> float:
        value = level.evidence(point)
        visit(point, value)
        return value

    random = np.random.default_rng(seed)
    first = first_generation(len(start))
    even = qmc.Sobol(len(start), rng=random).random(first)[1:]
    points: Array = np.concatenate([start[None], start + widths * (2 * even - 1)])
    values: NDArray[np.float64] = np.array([evidence(point) for point in points])
    for _ in range(GENERATIONS):
        best = np.argsort(values)[:ELITE]
        points, values = points[best], values[best]
        # A little width of its own keeps the generations from freezing where they agreed early.
        covariance = np.atleast_2d(np.cov(points.T)) + np.diag((0.01 * widths) ** 2)
        drawn = random.multivariate_normal(points.mean(axis=0), covariance, LATER)
        points = np.concatenate([points, drawn])
        values = np.append(values, [evidence(point) for point in drawn])
    best_point: Values = points[np.argmin(values)]
    return best_point
