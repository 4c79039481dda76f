"""Raw files of cameras, read by LibRaw: the sensor's counts, linear, colours as measured.

Of each 2 x 2 cell of the Bayer mosaic one pixel is made, of its red, its blue and the mean of its
two greens. Nothing is interpolated, as demosaicing would, so noise stays white; there is no white
balance, no colour matrix and no gamma.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.storage.formats.decoding import Picture, check_count, decoding

RAW_SUFFIXES = (
    ".dng", ".nef", ".nrw", ".arw", ".srf", ".sr2", ".cr2", ".cr3", ".pef", ".raf", ".orf", ".rw2",
    ".srw", ".3fr", ".erf", ".iiq", ".mef", ".mos", ".kdc", ".dcr", ".rwl",
)  # fmt: skip
"""Of files that mostly have the signature of TIFF."""

RAW_SIGNATURES = (
    (4, b"ftypcrx "), (0, b"FUJIFILMCCD-RAW"), (0, b"IIRO"), (0, b"IIRS"), (0, b"MMOR"),
    (0, b"IIU\x00"),
)  # fmt: skip
"""Of the others: Canon's CR3, Fujifilm, Olympus, Panasonic."""

_TURNS = {0: 0, 3: 2, 5: 1, 6: 3}  # LibRaw's flip: quarter turns counterclockwise
_CELL = {"R": 1, "G": 2, "B": 1}


def read_camera_raw(path: Path, *_: object) -> Picture:
    """Read a camera's raw file as counts above its black level, half the mosaic's size."""
    import rawpy  # where it is missing, that is told, not that the file is damaged

    _check_whole(path)
    with decoding(path, "camera raw"), rawpy.imread(str(path)) as raw:
        if raw.raw_type != rawpy.RawType.Flat:
            raise PhotographError(f"{path}: is no Bayer mosaic; export it as 16-bit linear TIFF")
        check_count(raw.raw_image_visible.shape, path)
        counts = raw.raw_image_visible.astype(np.float32)
        colours = raw.raw_colors_visible
        black, white = np.array(raw.black_level_per_channel, np.float32), raw.white_level
        full = counts >= white
        counts -= black[colours]
        turns = _TURNS.get(raw.sizes.flip)
        if turns is None:
            raise PhotographError(f"{path}: is stored mirrored; export it as 16-bit linear TIFF")
        letters = raw.color_desc.decode("latin-1")
        if raw.num_colors == 1:
            light, saturated, cell = counts[..., np.newaxis], full, 1
        else:
            light, saturated = _cells(counts, full, colours, letters, path)
            cell = 2
    return Picture(np.rot90(light, turns), saturated=np.rot90(saturated, turns), cell=cell)


def _cells(
    counts: NDArray[np.float32],
    full: NDArray[np.bool_],
    colours: NDArray[np.uint8],
    letters: str,
    path: Path,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return (rows, columns, 3) colours of the mosaic's cells, and where one has a full pixel."""
    rows, columns = counts.shape[0] // 2 * 2, counts.shape[1] // 2 * 2
    cell = colours[:2, :2]
    named = [letters[index] for index in cell.ravel()]
    even = (colours[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2)
            == cell[:, np.newaxis]).all()  # fmt: skip
    if not even or {letter: named.count(letter) for letter in set(named)} != _CELL:
        raise PhotographError(
            f"{path}: its mosaic is no Bayer pattern of red, green and blue; export it as 16-bit "
            "linear TIFF"
        )
    planes: dict[str, Any] = {}
    saturated = np.zeros((rows // 2, columns // 2), bool)
    for k, letter in enumerate(named):
        down, across = divmod(k, 2)
        part = counts[down:rows:2, across:columns:2]
        planes[letter] = planes.get(letter, 0) + part / np.float32(_CELL[letter])
        saturated |= full[down:rows:2, across:columns:2]
    return np.stack([planes[letter] for letter in "RGB"], axis=-1), saturated


def _check_whole(path: Path) -> None:
    """Refuse a file of TIFF's layout that ends before its pixels do: LibRaw lets some pass."""
    import tifffile

    with path.open("rb") as stream:
        if stream.read(2) not in (b"II", b"MM"):
            return
    try:
        with tifffile.TiffFile(path) as file:
            pages = list(file.pages)[:8]
            parts = [part for page in pages for part in (page, *(page.pages or ()))]
            ends = [np.add(part.dataoffsets, part.databytecounts) for part in parts]
    except Exception:  # a layout of its own, which LibRaw knows
        return
    if max((each.max() for each in ends if each.size), default=0) > path.stat().st_size:
        raise PhotographError(f"{path}: is cut short; copy it again")
