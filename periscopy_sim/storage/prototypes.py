"""Prototype backgrounds, B, on disk: an NPY file, a column for each."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import check_real
from periscopy_sim.scenario import Array
from periscopy_sim.storage.formats.decoding import decoding
from periscopy_sim.storage.formats.table import format_of


def read_prototypes(path: Path, pixels: int) -> Array:
    """Read B, (M, L), of a photograph of so many pixels, M, row-major.

    A PhotographError says that it is no such file.
    """
    if not path.is_file():
        raise PhotographError(f"{path}: no such file")
    if format_of(path).name != "NPY":
        raise PhotographError(f"{path}: is no NPY file; save prototype backgrounds by numpy.save")
    with decoding(path, "NPY"):
        B = np.load(path, allow_pickle=False)
    check_real(B.dtype, str(path))
    if B.ndim != 2 or B.shape[0] != pixels or not B.shape[1]:
        raise PhotographError(
            f"{path}: holds an array of shape {B.shape}; prototype backgrounds are ({pixels}, "
            "lights), a row for each pixel of the scene's camera"
        )
    if not np.isfinite(B).all():
        raise PhotographError(f"{path}: holds NaN or infinities; save finite numbers")
    return np.asarray(B, np.float64)
