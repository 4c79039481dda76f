"""A sequence of photographs, each decoded when its turn comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, TypeVar

Frame = TypeVar("Frame")


@dataclass(frozen=True, eq=False)
class Frames(Generic[Frame]):
    """Frames in time's order, decoded one at a time as they are iterated over.

    Attributes
    ----------
    names : tuple of str
        The file, the part or the number of each.
    warnings : tuple of str
        What was left out of the whole, one line each.
    decode : callable
        Starts an iterator over all of them: photographs, or arrays not yet checked one by one.
    """

    names: tuple[str, ...]
    warnings: tuple[str, ...]
    decode: Callable[[], Iterator[Frame]]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Frame]:
        return self.decode()
