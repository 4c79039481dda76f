"""A sequence of photographs, each decoded when its turn comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from periscopy_sim.storage.photographs import Photograph


@dataclass(frozen=True, eq=False)
class Frames:
    """Photographs in time's order, decoded one at a time as they are iterated over.

    Attributes
    ----------
    names : tuple of str
        The file, the part or the number of each.
    warnings : tuple of str
        What was left out of the whole, one line each.
    decode : callable
        Starts an iterator over all of them.
    """

    names: tuple[str, ...]
    warnings: tuple[str, ...]
    decode: Callable[[], Iterator[Photograph]]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Photograph]:
        return self.decode()


def listed(names: Sequence[str]) -> str:
    """Join the first four names for a message, and tell how many follow."""
    rest = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return ", ".join(names[:4]) + rest


def place_of(path: Path, frame: int | str) -> Path:
    """Name a frame of a file, or several, for a message."""
    return Path(f"{path}, frame {frame}")
