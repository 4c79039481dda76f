"""How much memory a light transport matrix needs, and whether this machine has it."""

from __future__ import annotations

import os
from pathlib import Path

FIXED = 0.6e9
"""Bytes of the renderer and of a block of rows, beside A."""

BYTES_PER_ENTRY = 25
"""Of A, while the default method is fitted to it: A and B themselves, and copies (measured)."""


def fits_in_memory(size: int) -> bool:
    """Return whether so many bytes are less than half of this machine's memory."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # not told here
        return True
    return 2 * size < memory


def transport_memory(pixels: int, patches: int, bytes_per_entry: float = BYTES_PER_ENTRY) -> float:
    """Return the bytes that A, (pixels, patches), and what is made of it need."""
    return FIXED + bytes_per_entry * pixels * patches


def has_memory(size: float) -> bool:
    """Return whether so many bytes can be had now; True where that is not known."""
    available = available_memory()
    return available is None or size <= available


def available_memory() -> int | None:
    """Return how many bytes can be had now, no more than a container may have; None if unknown."""
    known = [_of_machine(), _of_container()]
    return min((size for size in known if size is not None), default=None)


def _of_machine() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text("ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return 1024 * int(line.split()[1])
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def _of_container(folder: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Return what cgroups (version 2) leave, without what their cache could give back."""
    try:
        limit, used = (
            (folder / f"memory.{name}").read_text("ascii") for name in ("max", "current")
        )
        cached = dict(map(str.split, (folder / "memory.stat").read_text("ascii").splitlines()))
        return int(limit) - int(used) + int(cached.get("inactive_file", 0))
    except (ValueError, OSError):  # no container, or no limit
        return None
