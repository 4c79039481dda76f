"""The table of a design: a row for each point, kept as it grows, so that a run may go on."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from periscopy_sim.errors import OutputError
from periscopy_sim.evaluation.design.merit import NUMBERS, Merit
from periscopy_sim.storage.outputs.staging import staged_file

AS_IT_STANDS = 0
"""Number of the row of the scene as it stands; those of points follow."""


@dataclass(frozen=True)
class Row:
    """A point: its values, and what it is worth, or why it failed."""

    number: int
    values: Mapping[str, str]
    merit: Merit | None
    failure: str = ""

    def figure(self, name: str) -> float | None:
        """Return a number of the merit; None where there is none."""
        return None if self.merit is None else getattr(self.merit, name)


def write_table(path: Path, names: Iterable[str], rows: Iterable[Row]) -> None:
    """Write rows as CSV, all or none; parameters of the given names."""
    names = list(names)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("point", *names, *NUMBERS, "failure", "remark"))
    for row in rows:
        numbers = (row.figure(name) for name in NUMBERS)
        told = ("" if number is None else f"{number:.9g}" for number in numbers)
        remark = "" if row.merit is None else row.merit.remark
        table.writerow(
            (row.number, *(row.values[name] for name in names), *told, row.failure, remark)
        )
    with staged_file(path) as staged:
        staged.write_text(text.getvalue(), encoding="utf-8", newline="")


def read_table(path: Path, names: Iterable[str]) -> list[Row]:
    """Read what `write_table` wrote; no rows where there is no file.

    An `OutputError` says that it is damaged.
    """
    if not path.is_file():
        return []
    rows = []
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            for number, held in enumerate(csv.DictReader(stream, strict=True)):
                values = {name: str(float(held[name])) and held[name] for name in names}
                numbers = {name: float(held[name]) if held[name] else None for name in NUMBERS}
                merit = Merit(**numbers, remark=held["remark"])  # type: ignore[arg-type]
                failed = held["failure"]
                if int(held["point"]) != number or (not failed and merit.bound is None):
                    raise ValueError
                rows.append(Row(number, values, None if failed else merit, failed))
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        raise OutputError(
            f"{path}: is damaged; remove it, or name another folder, to start anew"
        ) from None
    return rows
