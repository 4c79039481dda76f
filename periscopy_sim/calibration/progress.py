"""How far a calibration has come, and where it has been."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from periscopy_sim.calibration.explanation.resolution_level import ResolutionLevel, Values, Visit
from periscopy_sim.calibration.result import Visited
from periscopy_sim.calibration.search.global_search import points_visited
from periscopy_sim.calibration.search.ruled_starts import (
    DESCENT_ITERATIONS,
    DESCENTS,
    places_looked_at,
)

LOOK = 3.0
"""What a look of the walks costs, in renderings of the fine level for a difference."""

LOOKS, WALKED = 18, 6
"""Looks that the walks take for each parameter, and how many parameters count, at most."""

COARSE_COST = 0.2
"""What coarse costs, of the same at the fine level."""


class Progress:
    """Keep what a calibration visits, level by level, and report how much is done.

    So many parameters are free, all of them known by a ruler (`ruled`) or not; the descent has so
    many iterations at most. The fraction done is passed to `report`.
    """

    def __init__(
        self,
        parameters: int,
        ruled: bool,
        iterations: int,
        report: Callable[[float], None] | None,
    ) -> None:
        # In units of a rendering of the fine level for a difference; a descent's visits each stand
        # for an iteration, and what precedes it for one more.
        iteration = 2 * parameters + 6
        coarse = (COARSE_COST, points_visited(parameters))
        if ruled:
            looks, descents = places_looked_at(parameters), DESCENTS * (DESCENT_ITERATIONS + 1)
            share = descents / (looks + descents)
            coarse = (COARSE_COST * (1 + share * iteration), looks + descents)
        phases = [coarse, (float(iteration), iterations + 2)]
        self._costs = [cost for cost, _ in phases]
        self._starts = [0.0, *np.cumsum([cost * points for cost, points in phases]).tolist()]
        self._looks = LOOKS * min(parameters, WALKED)
        self._all = self._starts[-1] + LOOK * self._looks
        self._done = 0.0
        self.report = report or (lambda _: None)
        self._visited: list[tuple[ResolutionLevel, list[tuple[Values, float]]]] = []

    def at(self, level: ResolutionLevel) -> Visit:
        """Return what keeps the points that the next level visits."""
        points: list[tuple[Values, float]] = []
        cost = self._costs[len(self._visited)]
        # A level before may have ended early; one that takes longer waits at its end.
        self._done, end = self._starts[len(self._visited) :][:2]
        self._visited.append((level, points))

        def visit(values: Values, evidence: float) -> None:
            points.append((values, evidence))
            # A descent after a walk finds more done than its own level ends with.
            self._done = max(self._done, min(self._done + cost, end))
            self.report(self._done / self._all)

        return visit

    def again(self, per_look: int = 1) -> Visit:
        """Return what keeps the points that the first level visits once more.

        Every `per_look` of them count as one look of the walks.
        """
        _, points = self._visited[0]

        def visit(values: Values, evidence: float) -> None:
            points.append((values, evidence))
            if len(points) % per_look == 0:
                self.looked()

        return visit

    def looked(self) -> None:
        """Count a place that a walk looked at, or a search that begins anew.

        How many it takes, and what descents follow, nobody knows before: each is a part of what is
        left.
        """
        self._done = max(self._done, self._starts[-1])
        self._done += (self._all - self._done) / self._looks
        self.report(self._done / self._all)

    def path(self) -> tuple[Visited, ...]:
        """Return all that was visited."""
        return tuple(
            Visited(
                level.photograph_shape,
                level.hidden_shape,
                np.array([values for values, _ in points]),
                np.array([evidence for _, evidence in points]),
            )
            for level, points in self._visited
        )
