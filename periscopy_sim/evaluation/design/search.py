"""Try the points of a variation, one after the other; those that make no scene fail alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError, SceneError, VariantError
from periscopy_sim.evaluation.design.comparison import By, Comparison
from periscopy_sim.evaluation.design.merit import Merit, assessment_of
from periscopy_sim.evaluation.design.table import AS_IT_STANDS, Row, read_table, write_table
from periscopy_sim.evaluation.design.variation import Variation, as_text
from periscopy_sim.rendering.overlap import overlap_doubt, overlaps
from periscopy_sim.rendering.pierced import pierced
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.shadow_check import shadow_doubt
from periscopy_sim.scenario import Scenario

Image = NDArray[np.floating[Any]]
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Design:
    """A scene file, what of it varies, and how its points are compared.

    Attributes
    ----------
    path
        The scene file.
    hidden
        (R, C) of the hidden image.
    parameters
        Values of its ``<default>``s as it stands.
    variation
        What varies.
    comparison
        Noise and ambient light.
    transport, prototypes
        Return A, (M, N), and B, (M, L), of a scenario.
    images
        Hidden images, (R, C, 3), by name, of which errors are told.
    """

    path: Path
    hidden: tuple[int, int]
    parameters: Mapping[str, str]
    variation: Variation
    comparison: Comparison
    transport: Callable[[Scenario], Image]
    prototypes: Callable[[Scenario], Image]
    images: Mapping[str, Array]

    def scenario(self, values: Mapping[str, str]) -> Scenario:
        """Return the scene of a point; a SceneError says that it is none."""
        scenario = load_scenario(self.path, self.hidden, {**self.parameters, **values})
        standing = pierced(scenario)
        if standing:
            raise SceneError(f"scene '{self.path}': {standing}")
        return scenario

    def as_it_stands(self) -> dict[str, str]:
        """Return the values of what varies in the scene as it stands."""
        declared = read_document(self.path).defaults
        given = {name: self.parameters.get(name, declared[name]) for name in self.variation.names}
        return {name: as_text(float(text)) for name, text in given.items()}


def run_design(
    design: Design, table: Path, progress: Callable[[int, int], None] = lambda *_: None
) -> list[Row]:
    """Assess a scene as it stands and at each point; go on with what a table holds already.

    Parameters
    ----------
    design
        What to do.
    table
        CSV file of a row for each point, renewed after each. It must be of this design.
    progress
        Called with how many points are done, and of how many.

    Returns
    -------
    list of Row
        That of the scene as it stands first.

    Raises
    ------
    SceneError
        If the scene as it stands is none.
    OutputError
        If the table cannot be read or written, or holds more points than are asked for.
    """
    points = [design.as_it_stands(), *design.variation.points()]
    rows = read_table(table, design.variation.names)
    if len(rows) > len(points):
        raise OutputError(
            f"{table} holds {len(rows) - 1} points; ask for as many or more, or name another folder"
        )
    for row, values in zip(rows, points, strict=False):
        if dict(row.values) != values:
            raise OutputError(
                f"{table}: row {row.number} is of another design; name another folder"
            )
    if len(rows) == len(points):
        return rows
    scenario = design.scenario({})
    joined = overlaps(scenario)
    seen = design.transport(scenario), design.prototypes(scenario)
    assessment, merit = assessment_of(scenario, *seen, design.comparison, design.images)
    rows = rows or [Row(AS_IT_STANDS, points[0], _doubted(merit, shadow_doubt(scenario)))]
    progress(len(rows), len(points))
    while len(rows) < len(points):
        values = points[len(rows)]
        found, failure = None, ""
        try:
            scenario = design.scenario(values)
            seen = design.transport(scenario), design.prototypes(scenario)
            doubts = shadow_doubt(scenario), overlap_doubt(scenario, but=joined)
            found = _doubted(assessment.merit(scenario, *seen), *doubts)
        except (OutputError, VariantError):  # no fault of the point's
            raise
        except ValueError as error:  # a SceneError too
            failure = " ".join(str(error).replace(f"scene '{design.path}': ", "").split())
        rows.append(Row(len(rows), values, found, failure))
        write_table(table, design.variation.names, rows)
        progress(len(rows), len(points))
    return read_table(table, design.variation.names)  # the same digits, however often it stopped


def _doubted(merit: Merit, *doubts: str) -> Merit:
    """Return a merit whose remark tells doubts, too."""
    return replace(merit, remark="; ".join(filter(None, (*doubts, merit.remark))))


def ranked(rows: list[Row], by: By) -> list[Row]:
    """Return the rows of finite merit, the best first; among equals, the earlier."""
    return sorted(
        (row for row in rows if _number(row, by) < np.inf), key=lambda row: _number(row, by)
    )


def at_border(variation: Variation, row: Row) -> list[str]:
    """Return the parameters whose value is the first or the last that was tried on a grid."""
    return [
        name
        for name, ends in variation.ranges.items()
        if row.number != AS_IT_STANDS and row.values[name] in map(as_text, ends)
    ]


def _number(row: Row, by: By) -> float:
    number = row.figure(by.number)
    return np.inf if number is None else number
