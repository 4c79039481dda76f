"""A Zarr v3 store that no crash can spoil, filled block by block over many runs.

Each block has files of its own. It counts as done once its record stands in ``making/finished``,
which holds the checksum of each of these files; a block whose files are not what its record says is
made again. Chunks carry a checksum of their own, so that a damaged one is an error to any reader,
not a result. Nothing measured, such as times, lies in the store: the same attributes give the same
bytes, however often the work was stopped, and by whomever.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError
from periscopy_sim.numerics.limits import read_json
from periscopy_sim.storage.outputs.resume import check_settings
from periscopy_sim.storage.outputs.staging import (
    LOCK,
    out_of_space_reported,
    staged_file,
    staged_folder,
    unwritable_reported,
)

MAKING = "making"
"""Folder (and empty Zarr group) of what belongs to the making of a store alone."""


@dataclass(frozen=True)
class StoreLayout:
    """The variables of a store, and how it is cut into blocks; the last may be cut short."""

    what: str  # name of the store in messages: a sweep
    variables: Mapping[str, Mapping[str, Any]]  # arguments of `zarr.Group.create_array`
    cuts: Mapping[str, tuple[int, int]]  # length and block's length of each dimension that is cut
    count: int | None = None  # entries, if they may become more from run to run

    @property
    def blocks(self) -> range:
        """Numbers of the blocks, row-major."""
        return range(math.prod(-(-length // size) for length, size in self.cuts.values()))

    def _index(self, number: int) -> dict[str, int]:
        grid = [-(-length // size) for length, size in self.cuts.values()]
        return dict(zip(self.cuts, map(int, np.unravel_index(number, grid)), strict=True))

    def place(self, number: int) -> dict[str, slice]:
        """Return a block's slice of each dimension that is cut."""
        index = self._index(number)
        return {
            name: slice(index[name] * size, min((index[name] + 1) * size, length))
            for name, (length, size) in self.cuts.items()
        }

    def size(self, number: int) -> int:
        """Return the number of a block's entries, such as samples."""
        return math.prod(each.stop - each.start for each in self.place(number).values())

    def files(self, number: int) -> dict[str, str]:
        """Return each variable's file of a block, as seen from the store."""
        index = self._index(number)
        return {
            name: "/".join([name, "c", *(str(index.get(d, 0)) for d in each["dimension_names"])])
            for name, each in self.variables.items()
        }


class Records:
    """Which blocks of a store are complete, one file each; the store's attributes identify it."""

    def __init__(self, path: Path, layout: StoreLayout, attributes: Mapping[str, Any]) -> None:
        self.path, self.layout = path, layout
        fixed = {name: value for name, value in attributes.items() if name != "count"}
        self.of = hashlib.sha256(json.dumps(fixed, sort_keys=True).encode()).hexdigest()[:16]

    def file(self, number: int) -> Path:
        """Return the file whose presence says that a block is complete."""
        return self.path / MAKING / "finished" / f"{number:08d}.json"

    def numbers(self) -> list[int]:
        """Return the numbers of the blocks that have a record, whole or not."""
        files = self.file(0).parent.glob("*.json")
        return sorted(int(file.stem) for file in files if file.stem.isdecimal())

    def read(self, number: int) -> dict[str, Any]:
        """Read the record of a block; empty if it is missing or damaged."""
        try:
            return dict(read_json(self.file(number)))
        except (OSError, ValueError, TypeError):
            return {}

    def has(self, number: int) -> bool:
        """Return whether a block has a record, of this store and as large as the layout's."""
        record = self.read(number)
        held = record.get("of"), record.get("samples")
        return held == (self.of, self.layout.size(number))

    def verify(self, number: int) -> bool:
        """Return whether a block has a record, and each of its files is what that says."""
        return self.read(number) == self._of_files(number)

    def write(self, number: int) -> None:
        """Record that a block is complete."""
        with staged_file(self.file(number)) as staged:
            staged.write_text(json.dumps(self._of_files(number)) + "\n", "utf-8")

    def _of_files(self, number: int) -> dict[str, Any]:
        """Return the record of a block that was written."""
        files = sorted(self.layout.files(number).items())
        checksums = {name: checksum(self.path / file) for name, file in files}
        return {"of": self.of, "samples": self.layout.size(number), "crc32c": checksums}


class BlockStore:
    """A store in the making or complete; one process writes to it at a time.

    The folder is made if missing, complete with its labels or not at all. The layout's `count` may
    be larger than before. `attributes`, of JSON's types, are all that the entries depend on: a
    folder of others, or of something else, is an `OutputError`. `labels` are the dimension and the
    values of each variable that is there from the start.
    """

    def __init__(
        self,
        path: Path,
        layout: StoreLayout,
        attributes: Mapping[str, Any],
        labels: Mapping[str, tuple[str, Any]],
    ) -> None:
        import zarr

        self.path, self.layout = path, layout
        self.records = Records(path, layout, attributes)
        check_place(path, layout.what)
        self._check_held(attributes)
        with out_of_space_reported(path):
            for leftover in path.rglob("*.partial*"):  # left by a process that was killed
                if leftover.is_file():
                    leftover.unlink()
            for number in self.records.numbers():  # before the head lists more than there is
                if not (number in layout.blocks and self.records.has(number)):
                    self.records.file(number).unlink()
            with staged_folder(path) as head:  # its `zarr.json` comes last, behind all other names
                self._lay_out(head, attributes, labels)
        self._group: Any = zarr.open_group(path, mode="r+", zarr_format=3)

    def missing(self) -> Iterator[int]:
        """Yield the numbers of the blocks that are missing, smaller, or not what was written."""
        return (n for n in self.layout.blocks if not self.records.verify(n))

    def write(self, number: int, values: Mapping[str, NDArray[Any]]) -> None:
        """Keep a block, and record that it is complete; the last may be cut short."""
        places, files = self.layout.place(number), self.layout.files(number)
        with out_of_space_reported(self.path):
            self.records.file(number).unlink(missing_ok=True)
            for name, each in values.items():
                # Zarr would read what is there, whole or not.
                (self.path / files[name]).unlink(missing_ok=True)
                array = self._group[name]
                place = [places.get(d, slice(0, None)) for d in array.metadata.dimension_names]
                lengths = [slice(cut.stop and cut.stop - cut.start) for cut in place]
                array[tuple(place)] = each[tuple(lengths)]
            self.records.write(number)

    def _check_held(self, wanted: Mapping[str, Any]) -> None:
        """Raise if there are entries of other attributes, or more of them than the layout has."""
        if not (numbers := self.records.numbers()):
            return
        recorded = {n: each for n, each in attributes_of(self.path).items() if n != "count"}
        check_settings(recorded, wanted, str(self.path), self.layout.what)
        last, samples = numbers[-1], self.records.read(numbers[-1]).get("samples", 0)
        if last not in self.layout.blocks or samples > self.layout.size(last):
            raise OutputError(
                f"{self.path} holds more than {self.layout.count} samples; ask for more of them"
            )

    def _lay_out(
        self, head: Path, attributes: Mapping[str, Any], labels: Mapping[str, tuple[str, Any]]
    ) -> None:
        """Write a store without blocks; xarray reads it."""
        import zarr

        count = {} if self.layout.count is None else {"count": self.layout.count}
        group = zarr.create_group(head, zarr_format=3, attributes={**attributes, **count})
        making = zarr.create_group(head / MAKING, zarr_format=3)
        making.attrs["description"] = "marks of the blocks that are finished, and what made them"
        for name, settings in self.layout.variables.items():
            group.create_array(name, **settings)
        for name, (dimension, values) in labels.items():
            is_text = isinstance(values[0], str)
            array = np.array(values, np.dtypes.StringDType() if is_text else None)
            group.create_array(name, data=array, dimension_names=(dimension,))


def attributes_of(path: Path) -> dict[str, Any]:
    """Return the attributes of a store; none if its head is missing or damaged."""
    try:
        return dict(read_json(path / "zarr.json")["attributes"])
    except (ValueError, KeyError, TypeError, OSError):
        return {}


def check_place(path: Path, what: str) -> None:
    """Raise an `OutputError` if a place holds anything but a store, whole or begun."""
    with unwritable_reported(path):
        if path.exists() and not path.is_dir():
            raise OutputError(f"cannot write {path}: it is a file; name a folder")
    is_begun = any((path / MAKING / name).is_file() for name in ("zarr.json", LOCK))
    if not is_begun and any(each.is_file() for each in path.rglob("*")):
        raise OutputError(f"{path} is not empty and no {what}; name another folder")


def checksum(file: Path) -> str | None:
    """Return the CRC-32C of a file in hexadecimal; None if there is no file.

    Zarr writes none of values that are all the fill value.
    """
    import google_crc32c

    return f"{google_crc32c.value(file.read_bytes()):08x}" if file.exists() else None
