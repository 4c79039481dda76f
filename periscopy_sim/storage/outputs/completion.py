"""Completion records: which blocks of a store are there, and what each of their files must be."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MAKING = "making"
"""Folder (and empty Zarr group) of what belongs to the making of a store alone."""


@dataclass(frozen=True)
class Block:
    """What is written at once, with files of its own."""

    number: int  # counts the blocks of a store from 0
    place: Mapping[str, slice]  # its slice of each dimension that is cut into blocks
    files: Mapping[str, str]  # each variable's file, as seen from the store

    @property
    def size(self) -> int:
        """Entries, such as samples."""
        return math.prod(each.stop - each.start for each in self.place.values())


def digest_of(attributes: Mapping[str, Any]) -> str:
    """Return what tells stores apart: all that their entries depend on, but for the `count`."""
    fixed = {name: value for name, value in attributes.items() if name != "count"}
    return hashlib.sha256(json.dumps(fixed, sort_keys=True).encode()).hexdigest()[:16]


def record_file(path: Path, number: int) -> Path:
    """Return the file whose presence says that a block of the store at `path` is complete."""
    return path / MAKING / "finished" / f"{number:08d}.json"


def recorded_blocks(path: Path) -> list[int]:
    """Return the numbers of the blocks that have a record, whole or not."""
    records = record_file(path, 0).parent.glob("*.json")
    return sorted(int(file.stem) for file in records if file.stem.isdecimal())


def read_record(path: Path, number: int) -> dict[str, Any] | None:
    """Read the record of a block; None where it is missing or damaged."""
    try:
        record = dict(json.loads(record_file(path, number).read_text("utf-8")))
        if isinstance(record["of"], str) and isinstance(record["samples"], int):
            return record if isinstance(record["crc32c"], dict) else None
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return None


def record_of(path: Path, digest: str, block: Block) -> dict[str, Any]:
    """Return the record of a block that was written.

    Zarr writes no file of values that are all the fill value: its checksum is None.
    """
    files = {name: path / file for name, file in sorted(block.files.items())}
    checksums = {name: checksum(f) if f.exists() else None for name, f in files.items()}
    return {"of": digest, "samples": block.size, "crc32c": checksums}


def is_recorded(path: Path, digest: str, block: Block) -> bool:
    """Return whether a block's record is of this store, and of a block as large."""
    record = read_record(path, block.number)
    return record is not None and (
        (record["of"], record["samples"]) == (digest, block.size)
        and record["crc32c"].keys() == block.files.keys()
    )


def is_complete(path: Path, digest: str, block: Block) -> bool:
    """Return whether a block is recorded, and each of its files is what its record says."""
    try:
        recorded = is_recorded(path, digest, block)  # or else no checksum is worth its while
        return recorded and read_record(path, block.number) == record_of(path, digest, block)
    except OSError:
        return False


def checksum(file: Path) -> str:
    """Return the CRC-32C of a file in hexadecimal."""
    import google_crc32c

    return f"{google_crc32c.value(file.read_bytes()):08x}"
