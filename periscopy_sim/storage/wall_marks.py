"""Lists of marks on the wall, as CSV files: points that were clicked, tags that were hung up."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.marks import WallPoints, WallTags
from periscopy_sim.scenario import Array


def read_wall_points(path: str | Path) -> WallPoints:
    """Read points of the wall from a CSV file with the columns column, row, x, y and z.

    Column and row are in the photograph, whose first pixel's centre is at (0.5, 0.5); x, y and z
    are metres in the scene. Other columns are left out. A file that is missing or malformed is a
    `PhotographError`.
    """
    values, names = _table(Path(path), ("column", "row", "x", "y", "z"))
    return WallPoints(values[:, :2], values[:, 2:], names, str(path))


def read_wall_tags(path: str | Path) -> WallTags:
    """Read tags on the wall from a CSV file with the columns id, x, y, z and size.

    The place of a tag is its middle's, its size the side of its black square, in metres. A file
    that is missing or malformed is a `PhotographError`.
    """
    values, _ = _table(Path(path), ("id", "x", "y", "z", "size"))
    return WallTags(values[:, 0].astype(np.int64), values[:, 1:4], values[:, 4], str(path))


def _table(path: Path, columns: tuple[str, ...]) -> tuple[Array, list[str]]:
    """Return the numbers of some columns, (rows, columns), and the name of each row."""
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is no text"
        raise PhotographError(f"{path}: {reason}; give a CSV file") from None
    reader = csv.DictReader(lines, skipinitialspace=True)
    reader.fieldnames = [name.strip().lower() for name in reader.fieldnames or ()]
    rows: dict[str, list[float]] = {}
    for row in reader:
        place = f"{path}, line {reader.line_num}"
        try:
            rows[place] = [float(row[name]) for name in columns]
        except (KeyError, TypeError, ValueError):
            rows[place] = [np.nan]
        if not np.isfinite(rows[place]).all():
            raise PhotographError(
                f"{place}: needs a number for each of {','.join(columns)}, which the first line of "
                "the file names"
            )
    if not rows:
        raise PhotographError(f"{path}: has no rows; write {','.join(columns)}, then one a mark")
    return np.array(list(rows.values())), list(rows)
