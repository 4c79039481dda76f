"""Captures of the published data set, read one at a time, each with its noise and what it shows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import periscopy_sim as ps
from experiments.published.layout import captures
from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Photograph
from periscopy_sim.storage.formats.rasters import bayer_colours
from periscopy_sim.storage.pictures import area_average
from periscopy_sim.storage.published import capture_exposure, capture_fields, capture_truth

Array = NDArray[np.float64]

NORMAL_DEVIATION = 1.4826
"""Standard deviation of normal numbers over their median absolute deviation."""


@dataclass(frozen=True, eq=False)
class Capture:
    """A raw capture as a photograph, in counts for each unit of exposure time.

    Attributes
    ----------
    name
        Folder and file, without its suffix.
    photograph
        (rows, columns, 3) linear.
    halves
        (2, rows, columns, 3): the same light seen by the sensor pixels of either colour of a
        chequerboard, so that their noise is independent; the photograph is their mean.
    exposure
        Shutter speed times number of exposures.
    truth
        (R, C, 3) linear, what the monitor showed; None if the file does not tell.
    """

    name: str
    photograph: Array
    halves: Array
    exposure: float
    truth: Array | None

    @property
    def noise(self) -> Array:
        """(3,) standard deviation of the photograph's noise, from the halves alone.

        By medians, so that hot pixels do not count.
        """
        difference = np.abs(self.halves[0] - self.halves[1]) / 2
        return np.asarray(NORMAL_DEVIATION * np.median(difference, axis=(0, 1)))


class DataSet:
    """The captures in a folder, which holds those of the layout or a folder ``Data`` with them.

    Parameters
    ----------
    folder
        The data set as its owners lay it out.
    hidden
        (R, C) of the hidden images.

    Raises
    ------
    PeriscopyError
        If none of its files is there.
    """

    def __init__(self, folder: Path, hidden: tuple[int, int]) -> None:
        roots = [folder, folder / "Data"]
        found = [root for root in roots if any(_file(root, name).is_file() for name in captures())]
        if not found:
            raise ps.PeriscopyError(
                f"{folder}: holds no capture of the data set, such as "
                f"{_file(Path(), captures()[0])}; give the folder 'Data' of the download"
            )
        self.root = found[0]
        self.hidden = hidden
        self.problems: dict[str, str] = {}
        """Why captures could not be read, by name; those that were asked for."""
        self._read: dict[tuple[str, tuple[int, int]], Capture | None] = {}

    def identity(self) -> bytes:
        """Return names, sizes and times of all files, which tell this data set from others."""
        files = (file for file in sorted(self.root.rglob("*.mat")) if file.is_file())
        stats = ((file, file.stat()) for file in files)
        lines = [
            f"{file.relative_to(self.root)} {stat.st_size} {stat.st_mtime_ns}"
            for file, stat in stats
        ]
        return "\n".join([*lines, str(self.hidden)]).encode()

    def unknown(self) -> list[str]:
        """Return files of the folder that the layout does not name."""
        known = {_file(self.root, name) for name in captures()}
        strangers = sorted(file for file in self.root.rglob("*.mat") if file not in known)
        return [file.relative_to(self.root).as_posix() for file in strangers]

    def read(self, name: str, shape: tuple[int, int]) -> Capture | None:
        """Return a capture averaged down to a photograph; None, and a problem, if it is no use."""
        key = (name, shape)
        if key not in self._read:
            try:
                self._read[key] = read_capture(_file(self.root, name), name, shape, self.hidden)
            except PhotographError as error:
                self._read[key] = None
                self.problems[name] = str(error).removeprefix(f"{_file(self.root, name)}: ")
        return self._read[key]

    def problems_of(self, folder: str, names: Sequence[str]) -> list[tuple[str, str]]:
        """Return which captures of a folder could not be read, together, for each reason."""
        by_reason: dict[str, list[str]] = {}
        for name in names:
            if (why := self.problems.get(f"{folder}/{name}")) is not None:
                by_reason.setdefault(why, []).append(name)
        return [(f"{folder}: {', '.join(names)}", why) for why, names in by_reason.items()]

    def readable(self, names: Iterable[str], shape: tuple[int, int]) -> list[Capture]:
        """Return those captures that can be read."""
        found = (self.read(name, shape) for name in names)
        return [capture for capture in found if capture is not None]


def read_capture(path: Path, name: str, shape: tuple[int, int], hidden: tuple[int, int]) -> Capture:
    """Read a raw capture.

    Parameters
    ----------
    path
        A MATLAB file with the fields of the published layout.
    name
        What it is called.
    shape
        (rows, columns) of the photograph.
    hidden
        (R, C) of the hidden image.

    Raises
    ------
    PhotographError
        If it is missing, damaged, of another layout or size.
    """
    fields = capture_fields(path)
    exposure = capture_exposure(fields, path)
    halves = halves_of(bayer_colours(fields["image"]), shape, path) / exposure
    checked = Photograph.of(halves.mean(axis=0), shape, str(path)).values
    sent = capture_truth(fields, path)
    truth = None if sent is None else area_average(sent, hidden)
    return Capture(name, checked, halves, exposure, truth)


def halves_of(colour: Array, shape: tuple[int, int], path: Path) -> Array:
    """Return means over the two colours of a chequerboard of each block: (2, rows, columns, 3).

    The blocks of colour pixels are of even sides, so that both means have the block's centre and
    as many pixels; other blocks are a PhotographError.
    """
    rows, columns = shape
    down, across = colour.shape[0] // rows, colour.shape[1] // columns
    if down % 2 or across % 2 or colour.shape[:2] != (down * rows, across * columns):
        raise PhotographError(
            f"{path}: blocks of {down} x {across} colour pixels cannot be halved; give the "
            "camera's film a size that makes their sides even"
        )
    blocks = colour.reshape(rows, down, columns, across, 3)
    dark = np.indices((down, across)).sum(axis=0) % 2
    weights = np.stack([1 - dark, dark]) / (down * across / 2)
    return np.asarray(np.einsum("kij,ricjd->krcd", weights, blocks, optimize=True))


def _file(root: Path, name: str) -> Path:
    return root / f"{name}.mat"
