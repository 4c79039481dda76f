"""Frames in the parts of an OpenEXR file."""

from __future__ import annotations

from pathlib import Path

from periscopy_sim.errors import PhotographError
from periscopy_sim.photographs.checking import check_size
from periscopy_sim.storage.formats.decoding import listed, place_of
from periscopy_sim.storage.formats.exr import exr_parts, exr_pixels
from periscopy_sim.storage.sequences.frames import Stack


def exr_stack(path: Path, shape: tuple[int, int]) -> Stack:
    """Open an EXR file, one frame a part; see `open_frames`."""
    parts = exr_parts(path)
    if not parts:
        raise PhotographError(f"{path}: holds no frames; give one at least")
    for k, part in enumerate(parts):
        check_size(part.size, shape, str(place_of(path, k)))
    left_out = sorted({name for part in parts for name in part.left_out})
    warnings = (f"{path}: left out the channels {listed(left_out)}",) if left_out else ()
    names = tuple(part.name for part in parts)
    return Stack(names, warnings, lambda: exr_pixels(path, parts))
