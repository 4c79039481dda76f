"""Lists of marks on the wall, as CSV files: points that were clicked, tags that were hung up."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.marks import WallPoints, WallTags

_LONGEST = 1 << 20  # bytes
_POINT = ("column", "row", "x", "y", "z")
_TAG = ("id", "x", "y", "z", "size")


def read_wall_points(path: str | Path) -> WallPoints:
    """Read points of the wall from a CSV file with the columns column, row, x, y and z.

    Column and row are in the photograph, whose first pixel's centre is at (0.5, 0.5); x, y and z
    are metres in the scene. Other columns are left out. A file that is missing or malformed is a
    `PhotographError`.
    """
    rows = _table(Path(path), _POINT)
    values = np.array([numbers for _, numbers in rows])
    names = [f"{path}, line {line}" for line, _ in rows]
    return WallPoints(values[:, :2], values[:, 2:], names, str(path))


def read_wall_tags(path: str | Path) -> WallTags:
    """Read tags on the wall from a CSV file with the columns id, x, y, z and size.

    The place of a tag is its middle's, its size the side of its black square, in metres. A file
    that is missing or malformed is a `PhotographError`.
    """
    rows = _table(Path(path), _TAG)
    for line, numbers in rows:
        if numbers[0] != int(numbers[0]) or numbers[0] < 0:
            raise PhotographError(f"{path}, line {line}: '{numbers[0]:g}' is no id; give a number")
    values = np.array([numbers for _, numbers in rows])
    return WallTags(values[:, 0].astype(np.int64), values[:, 1:4], values[:, 4], str(path))


def _table(path: Path, columns: tuple[str, ...]) -> list[tuple[int, list[float]]]:
    """Return the numbers of some columns of each row, and the lines that these are in."""
    try:
        if path.stat().st_size > _LONGEST:
            raise PhotographError(f"{path}: is longer than {_LONGEST} bytes; is it another file?")
        text = path.read_text("utf-8-sig")
    except FileNotFoundError:
        raise PhotographError(f"{path}: no such file; check the path") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is no text"
        raise PhotographError(f"{path}: {reason}; give a CSV file") from None
    reader = csv.reader(text.splitlines(), skipinitialspace=True)
    rows: list[tuple[int, list[float]]] = []
    places: list[int] = []
    try:
        for words in reader:
            if not any(word.strip() for word in words):
                continue
            if not places:
                places = _places([word.strip().lower() for word in words], columns, path)
                continue
            rows.append((reader.line_num, [_number(words, places[k], name, path, reader.line_num)
                                           for k, name in enumerate(columns)]))  # fmt: skip
    except csv.Error as error:
        raise PhotographError(f"{path}, line {reader.line_num}: {error}; write a CSV") from None
    if not rows:
        raise PhotographError(f"{path}: has no rows; write {','.join(columns)}, then one a mark")
    return rows


def _places(header: list[str], columns: tuple[str, ...], path: Path) -> list[int]:
    """Return where each column is, by the names in the first row."""
    for name in columns:
        if header.count(name) != 1:
            raise PhotographError(
                f"{path}: its first row must name the columns {','.join(columns)}, each once, not "
                f"'{','.join(header)}'"
            )
    return [header.index(name) for name in columns]


def _number(words: list[str], place: int, name: str, path: Path, line: int) -> float:
    text = words[place].strip() if place < len(words) else ""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise PhotographError(f"{path}, line {line}: {name} '{text}' is no number; write one")
    return value
