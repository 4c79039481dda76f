"""Whether arrays fit in this machine's memory."""

from __future__ import annotations

import os


def fits_in_memory(size: int) -> bool:
    """Return whether so many bytes are less than half of this machine's memory."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # not told here
        return True
    return 2 * size < memory
