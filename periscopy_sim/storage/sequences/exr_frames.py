"""Frames in the parts of an OpenEXR file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import check_count, decoding
from periscopy_sim.storage.photographs import Photograph, check_photograph, check_size
from periscopy_sim.storage.sequences.frames import Frames, listed, place_of


def exr_frames(path: Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None = None) -> Frames:
    """Open an EXR file, one frame a part; see `open_frames`."""
    import OpenEXR

    with decoding(path, "EXR"), OpenEXR.File(str(path), header_only=True) as file:
        headers = [dict(part.header) for part in file.parts]  # closing the file empties its own
        channels = [[channel.name for channel in header["channels"]] for header in headers]
        names_of_parts = [str(header.get("name", "")) for header in headers]
    if not headers:
        raise PhotographError(f"{path}: holds no frames; give one at least")
    left_out: set[str] = set()
    chosen: list[tuple[str, ...]] = []
    for k, header in enumerate(headers):
        place = place_of(path, k)
        if header["type"].name not in ("scanlineimage", "tiledimage"):
            raise PhotographError(f"{place}: is a deep image; save it flattened")
        (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
        check_size((bottom - top + 1, right - left + 1), shape, str(place))
        names = channels[k]
        if "tiles" in header:
            check_count((header["tiles"].ySize, header["tiles"].xSize, len(names)), place)
        if any((c.xSampling, c.ySampling) != (1, 1) for c in header["channels"]):
            raise PhotographError(f"{place}: has subsampled channels; save it as full RGB")
        chosen.append(_colour(names, place))
        left_out |= set(names) - set(chosen[-1])
    check_count((sum(len(header["channels"]) for header in headers), *shape), path)
    warnings = (f"{path}: left out the channels {listed(sorted(left_out))}",) if left_out else ()

    def decode() -> Iterator[Photograph]:
        with decoding(path, "EXR"), OpenEXR.File(str(path), separate_channels=True) as file:
            pixels = {
                str(part.header.get("name", "")): {
                    c: part.channels[c].pixels for c in part.channels
                }
                for part in file.parts
            }
        for k, (name, colour) in enumerate(zip(names_of_parts, chosen, strict=True)):
            place = place_of(path, k)
            if name not in pixels:  # how OpenEXR reports pixels it could not read
                raise PhotographError(f"{place}: truncated or damaged EXR; save or copy it again")
            channels = pixels.pop(name)
            values = np.stack([channels[c] for c in colour], axis=-1)
            yield Photograph(check_photograph(values, shape, str(place), mask))

    return Frames(tuple(names_of_parts), warnings, decode)


def _colour(names: Sequence[str], place: Path) -> tuple[str, ...]:
    """Names of the red, green and blue channels of a part, or of its lone grey one."""
    if {"R", "G", "B"} <= set(names):
        return ("R", "G", "B")
    if set(names) - {"A"} == {"Y"}:
        return ("Y",)
    raise PhotographError(f"{place}: has channels {listed(names)}; a frame needs R, G, B or Y")
