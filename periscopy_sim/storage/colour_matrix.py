"""Colour matrices in files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.model.colour_matrix import ColourMatrix


def read_colour_matrix(path: str | Path) -> ColourMatrix:
    """Read a matrix from a monitor's primaries (across) to a camera's channels (down).

    Parameters
    ----------
    path
        An NPY file, a JSON file of three rows, or a text file of three lines of three numbers,
        separated by commas.

    Raises
    ------
    PhotographError
        If the file is missing, of another form, or holds no `ColourMatrix`.
    """
    path = Path(path)
    try:
        if path.suffix == ".npy":
            values = np.load(path, mmap_mode="r", allow_pickle=False)
        elif path.suffix == ".json":
            values = np.array(json.loads(path.read_text("utf-8")))
        else:
            lines = filter(str.strip, path.read_text("utf-8-sig").splitlines())
            values = np.array([line.split(",") for line in lines], np.float64)
        return ColourMatrix(values)
    except (OSError, EOFError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or error
        raise PhotographError(
            f"{path}: {reason}; give three rows of three numbers as NPY, JSON or CSV"
        ) from None
