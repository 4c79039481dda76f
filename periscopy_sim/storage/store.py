"""A Zarr v3 store that no crash can spoil, filled block by block over many runs.

Each block has files of its own. It counts as done once its record stands in ``making/finished``,
which holds the checksum of each of these files; a block whose files are not what its record says is
made again. Files appear whole, the record last, and nothing right is ever removed: those who write
the same block at once do no harm. Chunks carry a checksum of their own, so that a damaged one is an
error to any reader, not a result. Nothing measured, such as times, lies in the store: the same
attributes give the same bytes, however often the work was stopped, and by whomever.
"""

import asyncio
import hashlib
import json
import math
import platform
import time
from collections.abc import Awaitable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError
from periscopy_sim.storage import outputs, places
from periscopy_sim.storage.provenance import check_settings

Block = tuple[int, ...]
"""Place of a block among the blocks, along each dimension that is cut."""

DAY = 86400.0
"""Seconds after which nobody writes a file any more that has its temporary name."""

MAKING = "making"
"""Folder (and empty Zarr group) of what belongs to the making of a store alone."""


@dataclass(frozen=True)
class StoreLayout:
    """The variables of a store, and how it is cut into blocks; the last may be cut short."""

    what: str  # name of the store in messages: a sweep
    variables: Mapping[str, Mapping[str, Any]]  # arguments of `zarr.AsyncGroup.create_array`
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
        files = [
            file.partition(".json") for file in places.names_in(self.path / MAKING / "finished")
        ]
        stems = [stem.split("-") for stem, is_record, rest in files if is_record and not rest]
        names = [name for name in stems if all(map(str.isdecimal, name))]
        return sorted(tuple(map(int, name)) for name in names if len(name) == len(self.layout.cuts))

    def read(self, block: Block) -> dict[str, Any]:
        """Read the record of a block; empty if it is missing or damaged."""
        record = places.document(self.file(block))
        return record if isinstance(record, dict) else {}

    def has(self, block: Block) -> bool:
        """Return whether a block has a record, of this store and as large as the layout's."""
        record = self.read(block) if self.layout.has(block) else {}
        held = record.get("of"), record.get("samples")
        return held == (self.of, self.layout.size(block))

    def held(self) -> list[Block]:
        """Return the blocks that have a record, by a list of their names.

        The last one's is read: before its store grew, it was smaller.
        """
        blocks = self.blocks()
        return blocks if not blocks or self.has(blocks[-1]) else blocks[:-1]

    def verify(self, block: Block) -> bool:
        """Return whether a block has a record, and each of its files is what that says."""
        if not (record := self.read(block)):
            return False
        files = self.layout.files(block)
        found = places.answers(
            self.path, _checksum_of, [self.path / file for file in files.values()]
        )
        return record == self._of(block, dict(zip(files, found, strict=True)))

    def verified(self, blocks: Iterable[Block]) -> Iterator[tuple[Block, bool]]:
        """Yield blocks, and whether each is whole."""
        blocks, held = [*blocks], {*self.blocks()}
        with outputs.out_of_space_reported(self.path):
            whole = places.answers(
                self.path, lambda each: each in held and self.verify(each), blocks
            )
            yield from zip(blocks, whole, strict=True)

    def write(self, block: Block, checksums: Mapping[str, str | None]) -> None:
        """Record that a block is complete, with the checksum of each variable's file, if any."""
        with outputs.staged_file(self.file(block)) as staged:
            staged.write_text(json.dumps(self._of(block, checksums)) + "\n", "utf-8")

    def _of(self, block: Block, checksums: Mapping[str, str | None]) -> dict[str, Any]:
        """Return the record of a block."""
        kept = {name: each for name, each in sorted(checksums.items()) if each is not None}
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
        blocks = self.records.blocks()
        self._check_held(blocks, attributes)
        with outputs.out_of_space_reported(path):
            age = DAY if places.is_shared(path) else 0.0  # workers elsewhere may be at work
            for leftover in () if places.is_remote(path) else path.rglob("*.partial*"):
                with suppress(OSError):  # of a process that was killed
                    if leftover.is_file() and time.time() - leftover.stat().st_mtime >= age:
                        leftover.unlink()
            if blocks and not self.records.has(blocks[-1]):  # before the head lists more
                places.clear(self.records.file(blocks.pop()))
            with outputs.staged_folder(
                path
            ) as head:  # its `zarr.json` comes last, behind all other names
                self._lay_out(head, attributes, labels)
                others = () if blocks else path.glob("[!.]*/zarr.json")
                for variable in others:  # begun with other axes, perhaps
                    laid_out = head / variable.parent.name / variable.name
                    if variable.parent.name == MAKING:
                        continue
                    if not laid_out.is_file() or places.content(variable) != laid_out.read_bytes():
                        outputs.remove(variable.parent)

    @cached_property
    def _memory(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The variables without entries, in memory, and the files of what is written to them."""
        from zarr.storage import MemoryStore

        files: dict[str, Any] = {}
        return _created(MemoryStore(files), self.layout.variables), files

    def __getstate__(self) -> dict[str, Any]:
        """Leave the memory behind."""
        return {name: each for name, each in self.__dict__.items() if name != "_memory"}

    def check_seen(self) -> None:
        """Raise an `OutputError` if this machine, a worker perhaps, does not see the store."""
        if not attributes_of(self.path):
            raise OutputError(
                f"{self.path}: {platform.node()} sees no {self.layout.what} there; give a folder "
                "that all machines have there"
            )

    def missing(self) -> Iterator[Block]:
        """Yield the blocks that are missing, smaller, or not what was written."""
        verified = self.records.verified(self.layout.blocks)
        return (block for block, is_whole in verified if not is_whole)

    def write(self, block: Block, values: Mapping[str, NDArray[Any]]) -> None:
        """Keep a block, and record that it is complete; the last may be cut short."""
        cut, (arrays, written) = self.layout.place(block), self._memory
        files, entries = self.layout.files(block), list[Awaitable[None]]()
        for name, each in values.items():
            place = [cut.get(d, slice(0, None)) for d in arrays[name].metadata.dimension_names]
            lengths = [slice(part.stop and part.stop - part.start) for part in place]
            entries.append(arrays[name].setitem(tuple(place), each[tuple(lengths)]))
        _awaited(entries)

        def keep(file: str) -> str | None:
            chunk = written.pop(file, None)
            if chunk is None:  # Zarr writes none of values that are all the fill value
                places.clear(self.path / file)
                return None
            places.put(self.path / file, data := chunk.to_bytes())
            return checksum(data)

        with outputs.out_of_space_reported(self.path):
            kept = places.answers(self.path, keep, files.values())
            self.records.write(block, dict(zip(files, kept, strict=True)))

    def _check_held(self, blocks: Sequence[Block], wanted: Mapping[str, Any]) -> None:
        """Raise if blocks are of other attributes, or more than the layout has."""
        if not blocks:
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
        arrays = {
            name: {
                "data": np.array(
                    values, np.dtypes.StringDType() if isinstance(values[0], str) else None
                ),
                "dimension_names": (dimension,),
                "attributes": dict(notes),
            }
            for name, (dimension, values, notes) in labels.items()
        }
        _created(head, {**self.layout.variables, **arrays}, attributes)
        about = {"description": "marks of the blocks that are finished, and what made them"}
        _created(head / MAKING, {}, about)


def _awaited(steps: Sequence[Awaitable[Any]]) -> list[Any]:
    """Return the results of Zarr's asynchronous functions; its others change threads for each."""

    async def gathered() -> list[Any]:
        return await asyncio.gather(*steps)

    with ThreadPoolExecutor(1) as thread:  # a notebook's own has a loop of events already
        return thread.submit(asyncio.run, gathered()).result()


def _created(
    store: Any, arrays: Mapping[str, Mapping[str, Any]], attributes: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Make a group, and return its arrays by name, made of the arguments of `create_array`."""
    from zarr.api.asynchronous import create_group

    group = create_group(store=store, zarr_format=3, attributes=dict(attributes or {}))
    (made,) = _awaited([group])
    created = _awaited([made.create_array(name, **each) for name, each in arrays.items()])
    return dict(zip(arrays, created, strict=True))


def _fixed(attributes: Mapping[str, Any], layout: StoreLayout) -> dict[str, Any]:
    """Return the attributes that all runs share."""
    return {name: each for name, each in attributes.items() if name not in layout.growing}


def attributes_of(path: Path) -> dict[str, Any]:
    """Return the attributes of a store; none if its head is missing or damaged."""
    head = places.document(path / "zarr.json")
    attributes = head.get("attributes") if isinstance(head, dict) else None
    return attributes if isinstance(attributes, dict) else {}


def check_place(path: Path, what: str) -> None:
    """Raise an `OutputError` if a place holds anything but a store, whole or begun."""
    with outputs.unwritable_reported(path):
        if path.exists() and not path.is_dir():
            raise OutputError(f"cannot write {path}: it is a file; name a folder")
        is_begun = any((path / MAKING / name).is_file() for name in ("zarr.json", outputs.LOCK))
        if not is_begun and any(each.is_file() for each in path.rglob("*")):
            raise OutputError(f"{path} is not empty and no {what}; name another folder")


def checksum(data: bytes) -> str:
    """Return the CRC-32C of data in hexadecimal."""
    import google_crc32c

    return f"{google_crc32c.value(data):08x}"


def _checksum_of(file: Path) -> str | None:
    """Return the checksum of a file; None if there is no file."""
    try:
        return checksum(places.content(file))
    except FileNotFoundError:
        return None
