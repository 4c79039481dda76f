"""What every section gets: the captures of a chair and a plate, and the scenes that fit them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

import periscopy_sim as ps
from experiments.report import Table
from experiments.setting import FittedScene
from periscopy_sim.errors import PhotographError
from periscopy_sim.numerics import Array
from periscopy_sim.photograph import Photograph
from periscopy_sim.storage.pictures import area_average
from periscopy_sim.storage.published import (
    PublishedSet,
    capture_exposure,
    capture_fields,
    capture_truth,
    published_sets,
)
from periscopy_sim.storage.rasters import bayer_colours

COLLECTION = "saunders2019-"
"""How the names of the sets begin."""

CHAIR, AMBIENT = f"{COLLECTION}chair", f"{COLLECTION}chair-ambient"
REPEATS, BLOCKS = f"{COLLECTION}chair-repeats", f"{COLLECTION}chair-blocks"
PLATE = f"{COLLECTION}plate"
VIDEOS = f"{COLLECTION}plate-video", f"{COLLECTION}plate-video-mushroom"

HIDDEN = (29, 36)
"""(R, C) of the hidden image."""


@dataclass(frozen=True, eq=False)
class Capture:
    """A raw capture as a photograph, in counts for each unit of exposure time.

    Attributes
    ----------
    name
        Of the file, without what all have in common.
    halves
        (2, rows, columns, 3) linear: the same light seen by the sensor pixels of either colour of a
        chequerboard, so that their noise is independent.
    truth
        (R, C, 3) linear, what the monitor showed; None if the file does not tell.
    """

    name: str
    halves: Array
    truth: Array | None

    @property
    def photograph(self) -> Array:
        """(rows, columns, 3) the mean of the halves."""
        return np.asarray(self.halves.mean(axis=0))


class PublishedSetting:
    """The data set, where its things stood, and the methods fitted to that.

    Parameters
    ----------
    out
        Folder of the run.
    data
        The data set as its owners lay it out, or a folder whose folder ``Data`` is that.
    scenes
        Files of scenes in place of the shipped ones, by the names of sets.

    Raises
    ------
    PeriscopyError
        If the data set is not there, or a scene is for a set that does not exist.
    """

    seed = 0

    def __init__(self, out: Path, data: Path, scenes: Mapping[str, str]) -> None:
        self.out = out
        self.sets = sets_of_captures()
        self.scenes = {name: ps.find_scene(scene) for name, scene in scenes.items()}
        if strange := self.scenes.keys() - self.sets:
            known = ", ".join(self.sets)
            raise ps.PeriscopyError(f"no set '{strange.pop()}' has a scene; there are {known}")
        files = [file for each in self.sets.values() for file in each.files]
        roots = [data, data / "Data"]
        found = [root for root in roots if any((root / file).is_file() for file in files)]
        if not found:
            raise ps.PeriscopyError(
                f"{data}: holds no capture of the data set, such as {files[0]}; give the folder "
                "'Data' of the download"
            )
        self.root = found[0]
        self.problems: dict[str, str] = {}
        """Why captures could not be read, by file."""
        self._fitted: tuple[str, FittedScene] | None = None

    def identity(self) -> bytes:
        """Return names, sizes and times of all files, and scenes, which tell inputs apart."""
        stats = [(file, file.stat()) for file in sorted(self.root.rglob("*.mat"))]
        files = [f"{file} {stat.st_size} {stat.st_mtime_ns}" for file, stat in stats]
        given = [scene.read_text("utf-8") for scene in self.scenes.values()]
        return "\n".join([*self.scenes, *files, *given]).encode()

    def fitted(self, name: str) -> FittedScene:
        """Return the scene of a set; only the latest one is kept."""
        if self._fitted is None or self._fitted[0] != name:
            self._fitted = None  # gigabytes, before the next ones
            self._fitted = (name, self.scene(name))
        return self._fitted[1]

    def scene(self, name: str) -> FittedScene:
        """Return the scene of a set: yours, or the shipped one as its owners measured."""
        scene, values = self.sets[name].scene, self.sets[name].parameters
        if name in self.scenes:
            scene, values = str(self.scenes[name]), {}
        return FittedScene(scene, HIDDEN, self.seed, values)

    def captures(self, name: str, *patterns: str) -> list[Capture]:
        """Return those captures of a set that fit a pattern, or all, by number, and can be read."""
        files = [
            file
            for file in self.sets[name].files
            if not patterns or any(fnmatch(file, f"{pattern}.mat") for pattern in patterns)
        ]
        files.sort(key=lambda file: ([int(number) for number in re.findall(r"\d+", file)], file))
        shape = self.scene(name).scenario.photograph_shape
        found = []
        for file in files:
            try:
                found.append(read_capture(self.root / file, shape, HIDDEN))
            except PhotographError as error:
                self.problems[file] = str(error).removeprefix(f"{self.root / file}: ")
        return found

    def not_read(self, *names: str) -> list[Table]:
        """Return a table of the captures of sets that could not be read, if there are any."""
        by_reason: dict[str, list[str]] = {}
        for file in (file for name in names for file in self.sets[name].files):
            if file in self.problems:
                by_reason.setdefault(self.problems[file], []).append(file)
        rows = [(", ".join(files), why) for why, files in by_reason.items()]
        return [Table("Not read.", ("captures", "why"), rows)] if rows else []


def sets_of_captures() -> dict[str, PublishedSet]:
    """Return the sets of captures by their names."""
    return {name: each for name, each in published_sets().items() if name.startswith(COLLECTION)}


def read_capture(path: Path, shape: tuple[int, int], hidden: tuple[int, int]) -> Capture:
    """Read a raw capture, a MATLAB file with the fields of the published layout.

    A file that is missing, damaged, of another layout or size is a PhotographError.
    """
    fields = capture_fields(path)
    halves = halves_of(bayer_colours(fields["image"]), shape, path) / capture_exposure(fields)
    Photograph.of(halves.mean(axis=0), shape, str(path))  # rejects what is no photograph
    sent = capture_truth(fields)
    name = path.stem.removeprefix("image_test").lstrip("_") or path.stem
    return Capture(name, halves, None if sent is None else area_average(sent, hidden))


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
