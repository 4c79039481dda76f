"""Raw photographs in the MATLAB layout of Saunders, Murray-Bruce and Goyal, Nature 2019."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import Picture, decoding

_REPEATS = ("averaged_iterations", "iterations")
"""Fields for the number of exposures; the first counts if both are there."""

_FIELDS = ["image", "shutter_speed", *_REPEATS, "ground_truth"]

_LOAD = f"""
import sys, numpy, scipy.io
fields = scipy.io.loadmat(sys.argv[1], variable_names={_FIELDS}).items()
numbers = {{n: v for n, v in fields if isinstance(v, numpy.ndarray) and v.dtype.kind in "iuf"}}
numpy.savez(sys.stdout.buffer, **numbers)
"""


def read_matrices(path: Path) -> dict[str, NDArray[Any]]:
    """Read those fields of a MATLAB file of the layout that hold real numbers.

    Another process runs SciPy's reader, since damaged files can crash it.
    """
    with decoding(path, "MATLAB", "save it again in MATLAB with -v7"):
        command = [sys.executable, "-P", "-c", _LOAD, str(path)]
        done = subprocess.run(command, capture_output=True, check=False)
        if done.returncode:
            raise ValueError((done.stderr.decode().splitlines() or ["damaged"])[-1])
        with np.load(io.BytesIO(done.stdout), allow_pickle=False) as held:
            return dict(held)


def read_matlab_counts(path: Path, *_: object) -> Picture:
    """Read raw sensor counts, as colours of the Bayer cells, from a MATLAB file of version 5 to 7.

    The file holds `image`, the Bayer counts summed over exposures, `shutter_speed`, and
    `iterations` or `averaged_iterations`, the number of exposures.
    """
    return picture_of(read_matrices(path), path)


def picture_of(matrices: Mapping[str, NDArray[Any]], path: Path) -> Picture:
    """Return the raw counts of a MATLAB file's fields, see `read_matlab_counts`."""
    counts = matrices.get("image", np.zeros(0))
    if counts.ndim != 2 or counts.shape[0] % 2 or counts.shape[1] % 2:
        raise PhotographError(f"{path}: 'image' is missing or no Bayer counts, even x even")
    exposure = 1.0
    for name in ("shutter_speed", next((n for n in _REPEATS if n in matrices), _REPEATS[-1])):
        value = matrices.get(name, np.zeros(0))
        if value.size != 1 or not 0 < value.item() < np.inf:
            raise PhotographError(f"{path}: '{name}' is not one positive number; store it as such")
        exposure *= value.item()
    with np.errstate(over="ignore", invalid="ignore"):
        return Picture(bayer_colours(counts.astype(np.float64)), exposure=exposure, cell=2)


def averaged_counts(
    colour: NDArray[np.float64], exposure: float, shape: tuple[int, int], name: str
) -> NDArray[np.float64]:
    """Return the counts of a sensor averaged down to a photograph, for each unit of exposure time.

    Files of one camera share a scale. The counts are (i rows, j columns, channels) with whole
    numbers i and j, exposed for a time `exposure`; the result is (rows, columns, channels) linear
    light. Messages call it `name`.
    """
    height, width, _ = colour.shape
    if height % shape[0] or width % shape[1] or not colour.size:
        raise PhotographError(
            f"{name}: {height} x {width} colour pixels (rows x columns) do not average to "
            f"{shape[0]} x {shape[1]}; give the camera's film a size that divides the former"
        )
    with np.errstate(over="ignore", invalid="ignore"):  # overflows become infinite, and an error
        blocks = colour.reshape(shape[0], height // shape[0], shape[1], width // shape[1], -1)
        return np.asarray(blocks.mean(axis=(1, 3)) / exposure, np.float64)


def bayer_colours(counts: NDArray[Any], places: Sequence[str] = "RGGB") -> NDArray[Any]:
    """Return half-size colours, (rows, columns, 3), of (2 rows, 2 columns) Bayer counts.

    `places` are the colours of a cell, row-major; its two greens are averaged.
    """
    rows, columns = counts.shape[0] // 2, counts.shape[1] // 2
    colours = np.zeros((rows, columns, 3), np.result_type(counts, np.float32))
    for k, letter in enumerate(places):
        cells = counts[k // 2 : 2 * rows : 2, k % 2 : 2 * columns : 2]
        colours[..., "RGB".index(letter)] += cells / places.count(letter)
    return colours
