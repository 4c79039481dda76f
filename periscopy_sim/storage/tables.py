"""Small tables of numbers in text files: colour matrices, and lists of marks on the wall."""

import io
from pathlib import Path

import numpy as np

from periscopy_sim.errors import PhotographError, require_all
from periscopy_sim.numerics import Array, validation
from periscopy_sim.photograph import ColourMatrix
from periscopy_sim.photographs.wall_view import WallPoints, WallTags
from periscopy_sim.storage import formats, rasters


def read_colour_matrix(path: str | Path) -> ColourMatrix:
    """Read a matrix from a monitor's primaries (across) to a camera's channels (down).

    Parameters
    ----------
    path
        An NPY file, a JSON file of rows or of a calibration, or a text file of numbers separated by
        commas: a row for each channel, a number in it for each primary. Or a camera's raw file,
        which states the matrix for sRGB primaries.

    Raises
    ------
    PhotographError
        If the file is missing, of another form, or holds no `ColourMatrix`.
    """
    path = Path(path)
    require_all(*formats.libraries_of([path]))
    with rasters.decoding(
        path, "a colour matrix", "give a row for each channel of the camera as NPY, JSON or CSV"
    ):
        if path.suffix.lower() in rasters.RAW_SUFFIXES and formats.format_of(path).is_raw:
            return ColourMatrix(rasters.raw_colours(path))
        if path.suffix == ".npy":
            return ColourMatrix(
                np.load(io.BytesIO(validation.read_regular(path)), allow_pickle=False)
            )
        if path.suffix == ".json":
            rows = validation.read_json(path)
            return ColourMatrix(np.array(rows["colour_matrix"] if isinstance(rows, dict) else rows))
        return ColourMatrix(np.loadtxt(_lines(path), delimiter=",", ndmin=2))


def read_wall_points(path: str | Path) -> WallPoints:
    """Read points of the wall from a CSV file with the columns column, row, x, y and z.

    Column and row are in the photograph, whose first pixel's centre is at (0.5, 0.5); x, y and z
    are metres in the scene. Other columns are left out. A file that is missing or malformed is a
    `PhotographError`.
    """
    values = _columns(path, ("column", "row", "x", "y", "z"))
    names = [f"{path}, line {k + 2}" for k in range(len(values))]
    return WallPoints(values[:, :2], values[:, 2:], names, str(path))


def read_wall_tags(path: str | Path) -> WallTags:
    """Read tags on the wall from a CSV file with the columns id, x, y, z and size.

    The place of a tag is its middle's, its size the side of its black square, in metres. A file
    that is missing or malformed is a `PhotographError`.
    """
    values = _columns(path, ("id", "x", "y", "z", "size"))
    return WallTags(values[:, 0].astype(np.int64), values[:, 1:4], values[:, 4], str(path))


def _columns(path: str | Path, names: tuple[str, ...]) -> Array:
    """Return the numbers of named columns, (rows, columns)."""
    with rasters.decoding(path, "CSV", f"write {','.join(names)}, then a line of numbers a mark"):
        table = np.genfromtxt(
            _lines(Path(path)), delimiter=",", names=True, case_sensitive="lower", ndmin=1
        )
        values = np.stack([table[name] for name in names], axis=1)
        if not (broken := ~np.isfinite(values).all(axis=1)).any() and len(values):
            return values
        raise PhotographError(
            f"{path}, line {broken.argmax() + 2}: needs a number for each of {','.join(names)}"
        )


def _lines(path: Path) -> list[str]:
    """Return the lines of a text file, of no more than the megabyte that NumPy reads in 2 s."""
    return validation.read_regular(path, 1 << 20).decode("utf-8-sig").splitlines()
