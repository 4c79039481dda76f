"""A sequence of photographs, each decoded when its turn comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from periscopy_sim.photographs.checking import Photograph


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


@dataclass(frozen=True, eq=False)
class Stack:
    """Frames that one file or archive holds, not yet checked one by one.

    Attributes
    ----------
    names, warnings
        As in `Frames`.
    values : callable
        Starts an iterator over the array of each frame.
    """

    names: tuple[str, ...]
    warnings: tuple[str, ...]
    values: Callable[[], Iterator[NDArray[Any]]]
