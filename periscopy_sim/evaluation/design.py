"""Designs: the merit of a scene over ranges of its parameters, point by point.

A point that makes no scene fails alone. A design that was stopped goes on from its table.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from periscopy_sim.errors import OutputError, VariantError
from periscopy_sim.evaluation.merit import NUMBERS, Comparison, Reference, merit_of
from periscopy_sim.rendering.scene.document import read_document
from periscopy_sim.rendering.scene.load import load_scenario
from periscopy_sim.rendering.survey import shadow_doubt
from periscopy_sim.scenario import Scenario
from periscopy_sim.storage.outputs.staging import staged_file

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]

Row = dict[str, Any]
"""A point: its number ``point``, 0 of the scene as it stands; the parameters' ``values`` as text;
the numbers and the ``remark`` of a `Merit`, None where missing; ``failure``, why it is no scene."""


def points_of(
    ranges: Mapping[str, tuple[float, float]], grid: int | None, draws: int, seed: int
) -> list[dict[str, str]]:
    """Return the points of a design in order: the value of each parameter, as text.

    A grid of so many values of each parameter combines all, both ends included; without a grid,
    `draws` points of Halton's sequence, scrambled by the seed, spread over the ranges. A larger
    number of draws begins with the points of a smaller one.
    """
    low, high = np.transpose(list(ranges.values()))
    if grid is None:
        spread = qmc.Halton(len(ranges), scramble=True, rng=seed).random(draws)
    else:
        steps = np.linspace(0, 1, grid) if grid > 1 else np.array([0.5])
        spread = np.array(list(product(steps, repeat=len(ranges))))
    points = low * (1 - spread) + high * spread
    points[np.abs(points) < 1e-12 * np.ptp([low, high], axis=0)] = 0  # rounding
    return [dict(zip(ranges, map(as_text, point), strict=True)) for point in points]


def as_text(value: float) -> str:
    """Return a number as text for a scene file; whole numbers without a point, for pixel counts."""
    return f"{value + 0.0:.9g}"


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as CSV, all or none."""
    with staged_file(path) as staged, staged.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("point", *rows[0]["values"], *NUMBERS, "failure", "remark"))
        for row in rows:
            numbers = ("" if row[name] is None else f"{row[name]:.9g}" for name in NUMBERS)
            values = row["values"].values()
            table.writerow((row["point"], *values, *numbers, row["failure"], row["remark"]))


def read_table(path: Path, names: Iterable[str]) -> list[Row]:
    """Read what `write_table` wrote of these parameters; no rows without a file.

    An `OutputError` says that it is damaged.
    """
    if not path.is_file():
        return []
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            return [
                {
                    "point": int(record["point"]),
                    "values": {name: record[name] for name in names},
                    **{name: float(record[name]) if record[name] else None for name in NUMBERS},
                    "failure": record["failure"],
                    "remark": record["remark"],
                }
                for record in csv.DictReader(stream, strict=True)
            ]
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        raise OutputError(f"{path}: is damaged; remove it to start anew") from None


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
    points
        Values of the parameters that vary, as `points_of` returns them.
    comparison
        Noise and ambient light.
    transport, prototypes
        Return A, (M, N), and B, (M, L), of a scenario.
    images
        Hidden images, (R, C, 3), by name, for the errors.
    """

    path: Path
    hidden: tuple[int, int]
    parameters: Mapping[str, str]
    points: Sequence[Mapping[str, str]]
    comparison: Comparison
    transport: Callable[[Scenario], Image]
    prototypes: Callable[[Scenario], Image]
    images: Mapping[str, Array]

    def row(
        self, number: int, values: Mapping[str, str], reference: Reference | None = None
    ) -> tuple[Row, Reference | None]:
        """Return a point's row, given the reference of the scene as it stands, and its own.

        A point that makes no scene has the reason as its failure, and no reference.
        """
        merit, own, remarks, failure = None, None, "", ""
        try:
            scenario = self.scenario(values)
            light = self.transport(scenario), self.prototypes(scenario)
            merit, own = merit_of(
                scenario, *light, self.comparison, self.images, reference=reference
            )
            remarks = "; ".join(filter(None, (shadow_doubt(scenario), merit.remark)))
        except (OutputError, VariantError):  # not the point's fault
            raise
        except ValueError as error:  # a SceneError too
            if reference is None:
                raise
            failure = " ".join(str(error).replace(f"scene '{self.path}': ", "").split())
        numbers = {name: getattr(merit, name, None) for name in NUMBERS}
        row = {"point": number, "values": values, **numbers, "failure": failure, "remark": remarks}
        return row, own

    def scenario(self, values: Mapping[str, str]) -> Scenario:
        """Return the scene of a point; a SceneError says that it is none."""
        return load_scenario(self.path, self.hidden, {**self.parameters, **values})

    def as_it_stands(self) -> dict[str, str]:
        """Return the values of what varies in the scene as it stands."""
        values = {**read_document(self.path).defaults, **self.parameters}
        return {name: as_text(float(values[name])) for name in self.points[0]}


def run_design(
    design: Design, table: Path, progress: Callable[[int, int], None] = lambda *_: None
) -> list[Row]:
    """Assess a scene as it stands and at each point; go on from the rows that a table holds.

    The table is a CSV file of a row for each point, the scene as it stands first, renewed after
    each; `progress` is called with how many points are done, and of how many.

    Raises
    ------
    SceneError
        If the scene as it stands is none.
    OutputError
        If the table cannot be read or written, or is of other or more points.
    """
    points = [design.as_it_stands(), *design.points]
    rows = read_table(table, points[0])
    if [row["values"] for row in rows] != points[: len(rows)]:
        raise OutputError(
            f"{table} holds {len(rows) - 1} points, which this design does not begin with; ask for "
            "as many or more, or name another folder"
        )
    if len(rows) == len(points):
        return rows
    first, reference = design.row(0, points[0])
    rows = rows or [first]
    for number in range(len(rows), len(points)):
        progress(number, len(points))
        rows.append(design.row(number, points[number], reference)[0])
        write_table(table, rows)
    progress(len(points), len(points))
    return read_table(table, points[0])  # the same digits, however often it stopped


def ranked(rows: Sequence[Row], number: str) -> list[Row]:
    """Return the rows where a number is finite, the least first; among equals, the earlier."""
    finite = [row for row in rows if row[number] is not None and np.isfinite(row[number])]
    return sorted(finite, key=lambda row: row[number])
