"""What a scenario made, kept by all that it depends on, up to so many bytes of memory."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import RLock
from typing import Any, Self, TypeVar

from periscopy_sim.numerics.machine import available_memory

Made = TypeVar("Made")

MOST_BYTES, SHARE = 1 << 31, 0.25
"""Bytes that a memo keeps by default, and the fraction of the machine's memory that they are at
most: A of 30 scenes of 126 x 126 pixels and 29 x 36 patches."""


class Memo:
    """Makes a thing once, and returns it whenever the same key comes again.

    The least recently used things make room before another is made, so that both need not fit into
    memory; the latest one stays, whatever its size. Two threads make things in turn: Dr.Jit's
    arrays belong to one thread at a time. A copy, and what pickle restores, begins empty.
    """

    def __init__(self, most_bytes: int | None = None) -> None:
        if most_bytes is None:
            available = available_memory() or MOST_BYTES / SHARE
            most_bytes = min(MOST_BYTES, int(SHARE * available))
        self.most_bytes = most_bytes
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._lock = RLock()

    def __call__(self, key: Hashable, make: Callable[[], Made], size: int = 0) -> Made:
        """Return what `make` makes, of about `size` bytes; that of before if the key is the same.

        What `make` raises is not kept.
        """
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            else:
                held = sum(each for _, each in self._kept.values())
                for other, (_, bytes_of) in [*self._kept.items()]:
                    if held + size <= self.most_bytes:
                        break
                    if bytes_of:
                        del self._kept[other]
                        held -= bytes_of
                self._kept[key] = make(), size
            made: Made = self._kept[key][0]
            return made

    def __reduce__(self) -> tuple[type[Self], tuple[int]]:
        """Leave out what is kept: a worker makes its own."""
        return type(self), (self.most_bytes,)
