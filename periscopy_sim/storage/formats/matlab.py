"""Raw photographs in the MATLAB layout of Saunders, Murray-Bruce and Goyal, Nature 2019."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import Picture
from periscopy_sim.storage.formats.matfile import Matrix, read_matrices

_REPEATS = ("averaged_iterations", "iterations")
"""Fields for the number of exposures; those averaged count where both are told."""


def read_matlab_counts(path: Path, *_: object) -> Picture:
    """Read raw sensor counts, as colours of the Bayer cells, from a MATLAB file of version 5 to 7.

    The file holds `image`, the Bayer counts summed over exposures, `shutter_speed`, and
    `iterations` or `averaged_iterations`, the number of exposures.
    """
    return picture_of(read_matrices(path), path)


def picture_of(matrices: dict[str, Matrix], path: Path) -> Picture:
    """Return the raw counts of a MATLAB file's variables, see `read_matlab_counts`."""
    counts = _real_field(matrices, "image", path)
    if counts.ndim != 2 or counts.shape[0] % 2 or counts.shape[1] % 2:
        raise PhotographError(
            f"{path}: 'image' has shape {counts.shape}; store Bayer counts, even x even"
        )
    repeats = next((name for name in _REPEATS if name in matrices), _REPEATS[-1])
    exposure = _number(matrices, "shutter_speed", path) * _number(matrices, repeats, path)
    with np.errstate(over="ignore", invalid="ignore"):
        return Picture(bayer_colours(counts), exposure=exposure, cell=2)


def averaged_counts(
    colour: NDArray[np.float64], exposure: float, shape: tuple[int, int], name: str
) -> NDArray[np.float64]:
    """Return the counts of a sensor averaged down to a photograph, for each unit of exposure time.

    So files of one camera share a scale. The counts are (i rows, j columns, channels) with whole
    numbers i and j, exposed for a time `exposure`; the result is (rows, columns, channels) linear
    light. `name` is what messages call it.
    """
    height, width, _ = colour.shape
    if height % shape[0] or width % shape[1] or not colour.size:
        raise PhotographError(
            f"{name}: {height} x {width} colour pixels (rows x columns) do not average to "
            f"{shape[0]} x {shape[1]}; give the camera's film a size that divides the former"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused as infinite
        blocks = colour.reshape(shape[0], height // shape[0], shape[1], width // shape[1], -1)
        return np.asarray(blocks.mean(axis=(1, 3)) / exposure, np.float64)


def bayer_colours(counts: ArrayLike) -> NDArray[np.float64]:
    """Return half-size colours of Bayer counts: red at even and blue at odd rows and columns.

    The counts are (2 rows, 2 columns), the result is (rows, columns, 3); the two greens of each
    cell are averaged.
    """
    counts = np.asarray(counts, dtype=np.float64)
    red, blue = counts[0::2, 0::2], counts[1::2, 1::2]
    green = (counts[0::2, 1::2] + counts[1::2, 0::2]) / 2
    return np.stack([red, green, blue], axis=-1)


def _real_field(matrices: dict[str, Matrix], name: str, path: Path) -> NDArray[Any]:
    """Return the real numbers of a field, or say why there are none."""
    if name not in matrices:
        held = ", ".join(filter(None, matrices)) or "none at all"
        raise PhotographError(
            f"{path}: has no field '{name}', only {held}; "
            "store the raw layout: image, shutter_speed, iterations"
        )
    values = matrices[name].values
    if values is None:
        raise PhotographError(f"{path}: '{name}' is {matrices[name].kind}; store it as double")
    return values


def _number(matrices: dict[str, Matrix], name: str, path: Path) -> float:
    """Return the value of a field that is one positive number."""
    values = _real_field(matrices, name, path)
    if values.size != 1 or not 0 < values.item() < np.inf:
        raise PhotographError(f"{path}: '{name}' is not one positive number; store it as such")
    return float(values.item())
