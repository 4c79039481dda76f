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
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs.places import (
    address,
    answers,
    clear,
    content,
    document,
    is_remote,
)
from periscopy_sim.storage.outputs.resume import check_settings
from periscopy_sim.storage.outputs.staging import (
    LOCK,
    out_of_space_reported,
    remove,
    staged_file,
    staged_folder,
    unwritable_reported,
)

if TYPE_CHECKING:
    from zarr import Group

Block = tuple[int, ...]
"""Place of a block among the blocks, along each dimension that is cut."""

MAKING = "making"
"""Folder (and empty Zarr group) of what belongs to the making of a store alone."""


@dataclass(frozen=True)
class StoreLayout:
    """The variables of a store, and how it is cut into blocks; the last may be cut short."""

    what: str  # name of the store in messages: a sweep
    variables: Mapping[str, Mapping[str, Any]]  # arguments of `zarr.Group.create_array`
    cuts: Mapping[str, tuple[int, int]]  # length and block's length of each dimension that is cut
    growing: Collection[str] = ()  # attributes that may differ from run to run

    @property
    def grid(self) -> tuple[int, ...]:
        """How many blocks there are along each dimension that is cut."""
        return tuple(-(-length // size) for length, size in self.cuts.values())

    @property
    def blocks(self) -> Iterator[Block]:
        """The blocks, row-major."""
        return np.ndindex(self.grid)

    def has(self, block: Block) -> bool:
        """Return whether there is such a block."""
        return all(k < count for k, count in zip(block, self.grid, strict=True))

    def place(self, block: Block) -> dict[str, slice]:
        """Return a block's slice of each dimension that is cut."""
        return {
            name: slice(k * size, min((k + 1) * size, length))
            for k, (name, (length, size)) in zip(block, self.cuts.items(), strict=True)
        }

    def size(self, block: Block) -> int:
        """Return the number of a block's entries, such as samples."""
        return math.prod(each.stop - each.start for each in self.place(block).values())

    def files(self, block: Block) -> dict[str, str]:
        """Return each variable's file of a block, as seen from the store."""
        index = dict(zip(self.cuts, block, strict=True))
        return {
            name: "/".join([name, "c", *(str(index.get(d, 0)) for d in each["dimension_names"])])
            for name, each in self.variables.items()
        }


class Label(NamedTuple):
    """A variable of one dimension that is there from the start."""

    dimension: str
    values: Any
    attributes: Mapping[str, Any] = MappingProxyType({})


class Records:
    """Which blocks of a store are complete, one file each; the store's attributes identify it."""

    def __init__(self, path: Path, layout: StoreLayout, attributes: Mapping[str, Any]) -> None:
        self.path, self.layout = path, layout
        fixed = json.dumps(_fixed(attributes, layout), sort_keys=True)
        self.of = hashlib.sha256(fixed.encode()).hexdigest()[:16]

    def file(self, block: Block) -> Path:
        """Return the file whose presence says that a block is complete."""
        name = "-".join(f"{k:08d}" for k in block)
        return self.path / MAKING / "finished" / f"{name}.json"

    def blocks(self) -> list[Block]:
        """Return the blocks that have a record, whole or not."""
        with out_of_space_reported(self.path):
            files = [*(self.path / MAKING / "finished").glob("*.json")]
        names = [name for file in files if all(map(str.isdecimal, name := file.stem.split("-")))]
        return sorted(tuple(map(int, name)) for name in names if len(name) == len(self.layout.cuts))

    def read(self, block: Block) -> dict[str, Any]:
        """Read the record of a block; empty if it is missing or damaged."""
        record = document(self.file(block))
        return record if isinstance(record, dict) else {}

    def has(self, block: Block) -> bool:
        """Return whether a block has a record, of this store and as large as the layout's."""
        record = self.read(block) if self.layout.has(block) else {}
        held = record.get("of"), record.get("samples")
        return held == (self.of, self.layout.size(block))

    def verify(self, block: Block) -> bool:
        """Return whether a block has a record, and each of its files is what that says."""
        record = self.read(block)
        return bool(record) and record == self._of_files(block)

    def asked(
        self, question: Callable[[Block], bool], blocks: Iterable[Block]
    ) -> Iterator[tuple[Block, bool]]:
        """Yield blocks with their answers to `has` or `verify`."""
        blocks = [*blocks]
        with out_of_space_reported(self.path):
            yield from zip(blocks, answers(self.path, question, blocks), strict=True)

    def write(self, block: Block) -> None:
        """Record that a block is complete."""
        with staged_file(self.file(block)) as staged:
            staged.write_text(json.dumps(self._of_files(block)) + "\n", "utf-8")

    def _of_files(self, block: Block) -> dict[str, Any]:
        """Return the record of a block that was written."""
        files = dict(sorted(self.layout.files(block).items()))
        found = answers(self.path, checksum, [self.path / file for file in files.values()])
        checksums = dict(zip(files, found, strict=True))
        kept = {name: each for name, each in checksums.items() if each is not None}
        return {"of": self.of, "samples": self.layout.size(block), "crc32c": kept}


class BlockStore:
    """A store in the making or complete; one process writes to it at a time.

    The folder is made if missing, complete with its labels or not at all. Dimensions that are cut
    may be longer than before. `attributes`, of JSON's types, are all that the entries depend on: a
    folder of others, or of something else, is an `OutputError`.
    """

    def __init__(
        self,
        path: Path,
        layout: StoreLayout,
        attributes: Mapping[str, Any],
        labels: Mapping[str, Label],
    ) -> None:

        self.path, self.layout = path, layout
        self.records = Records(path, layout, attributes)
        check_place(path, layout.what)
        self._check_held(attributes)
        with out_of_space_reported(path):
            for leftover in () if is_remote(path) else path.rglob("*.partial*"):
                if leftover.is_file():  # of a process that was killed
                    leftover.unlink()
            for block, is_good in self.records.asked(self.records.has, self.records.blocks()):
                if not is_good:  # before the head lists more than there is
                    clear(self.records.file(block))
            is_other = attributes_of(path) != json.loads(json.dumps(attributes))
            if is_other and not self.records.blocks():  # begun with other axes, perhaps
                for variable in path.glob("*/zarr.json"):
                    if variable.parent.name != MAKING:
                        remove(variable.parent)
            with staged_folder(path) as head:  # its `zarr.json` comes last, behind all other names
                self._lay_out(head, attributes, labels)
        self._arrays: dict[str, Any] = {}

    def _array(self, name: str) -> Any:
        """Return a variable's array, opened once."""
        if name not in self._arrays:
            self._arrays[name] = opened(self.path, "r+")[name]
        return self._arrays[name]

    def __getstate__(self) -> dict[str, Any]:
        """Leave what is opened behind."""
        return {**self.__dict__, "_arrays": {}}

    def missing(self) -> Iterator[Block]:
        """Yield the blocks that are missing, smaller, or not what was written."""
        asked = self.records.asked(self.records.verify, self.layout.blocks)
        return (block for block, is_whole in asked if not is_whole)

    def write(self, block: Block, values: Mapping[str, NDArray[Any]]) -> None:
        """Keep a block, and record that it is complete; the last may be cut short."""
        places, files = self.layout.place(block), self.layout.files(block)

        def keep(name: str) -> None:
            array = self._array(name)
            place = [places.get(d, slice(0, None)) for d in array.metadata.dimension_names]
            lengths = [slice(cut.stop and cut.stop - cut.start) for cut in place]
            array[tuple(place)] = values[name][tuple(lengths)]

        with out_of_space_reported(self.path):
            clear(self.records.file(block))
            # Zarr would read what is there, whole or not.
            _ = [*answers(self.path, clear, [self.path / file for file in files.values()])]
            _ = [*answers(self.path, keep, values)]
            self.records.write(block)

    def _check_held(self, wanted: Mapping[str, Any]) -> None:
        """Raise if there are entries of other attributes, or more of them than the layout has."""
        if not (blocks := self.records.blocks()):
            return
        recorded = _fixed(attributes_of(self.path), self.layout)
        check_settings(recorded, _fixed(wanted, self.layout), str(self.path), self.layout.what)
        last, samples = blocks[-1], self.records.read(blocks[-1]).get("samples", 0)
        if not self.layout.has(last) or samples > self.layout.size(last):
            raise OutputError(
                f"{self.path} holds more than {wanted.get('count')} samples; ask for more of them"
            )

    def _lay_out(
        self, head: Path, attributes: Mapping[str, Any], labels: Mapping[str, Label]
    ) -> None:
        """Write a store without blocks; xarray reads it."""
        import zarr

        group = zarr.create_group(head, zarr_format=3, attributes=dict(attributes))
        making = zarr.create_group(head / MAKING, zarr_format=3)
        making.attrs["description"] = "marks of the blocks that are finished, and what made them"
        for name, settings in self.layout.variables.items():
            group.create_array(name, **settings)
        for name, (dimension, values, notes) in labels.items():
            is_text = isinstance(values[0], str)
            array = np.array(values, np.dtypes.StringDType() if is_text else None)
            written = group.create_array(name, data=array, dimension_names=(dimension,))
            written.attrs.update(notes)


def _fixed(attributes: Mapping[str, Any], layout: StoreLayout) -> dict[str, Any]:
    """Return the attributes that all runs share."""
    return {name: each for name, each in attributes.items() if name not in layout.growing}


def opened(path: Path, mode: Literal["r", "r+"] = "r") -> "Group":
    """Open a store by Zarr."""
    import zarr

    return zarr.open_group(**address(path), mode=mode, zarr_format=3)


def attributes_of(path: Path) -> dict[str, Any]:
    """Return the attributes of a store; none if its head is missing or damaged."""
    head = document(path / "zarr.json")
    attributes = head.get("attributes") if isinstance(head, dict) else None
    return attributes if isinstance(attributes, dict) else {}


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

    try:
        return f"{google_crc32c.value(content(file)):08x}"
    except FileNotFoundError:
        return None
