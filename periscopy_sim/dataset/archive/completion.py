"""Marks of finished blocks: which samples a data set has, and what each of their files must be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from periscopy_sim.dataset.archive.layout import MAKING, Layout


def read_mark(path: Path, block: int) -> dict[str, Any] | None:
    """Read the mark of a block; None where it is missing or damaged."""
    try:
        mark = dict(json.loads(mark_of(path, block).read_text("utf-8")))
        if isinstance(mark["of"], str) and isinstance(mark["samples"], int):
            return mark if isinstance(mark["crc32c"], dict) else None
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return None


def is_marked(path: Path, layout: Layout, digest: str, block: int) -> bool:
    """Tell whether a block's mark is of this data set and of as many samples; see `is_finished`."""
    mark, place = read_mark(path, block), layout.samples_in(block)
    return (
        mark is not None
        and mark["of"] == digest
        and mark["samples"] == place.stop - place.start
        and set(mark["crc32c"]) == set(layout.variables)
    )


def is_finished(path: Path, layout: Layout, digest: str, block: int) -> bool:
    """Tell whether a block's files are there, whole and of as many samples as they should be.

    Parameters
    ----------
    path, layout
        The data set.
    digest
        Of its attributes, from `digest_of`.
    block
        Number of the block.
    """
    mark = read_mark(path, block)
    if mark is None or not is_marked(path, layout, digest, block):
        return False
    try:
        return all(checksum(path, name, block) == value for name, value in mark["crc32c"].items())
    except OSError:
        return False


def mark_of(path: Path, block: int) -> Path:
    """Name the file that tells that a block is finished."""
    return path / MAKING / "finished" / f"{block:08d}.json"


def file_of(path: Path, name: str, dimensions: int, block: int) -> Path:
    """Name the file of a block's values of one variable."""
    return path.joinpath(name, "c", str(block), *["0"] * (dimensions - 1))


def checksum(path: Path, name: str, block: int) -> str:
    """CRC-32C of the file of a block's values of one variable, in hexadecimal."""
    import google_crc32c

    dimensions = 4 if name in ("photograph", "hidden", "background") else 1
    content = file_of(path, name, dimensions, block).read_bytes()
    return f"{google_crc32c.value(content):08x}"
