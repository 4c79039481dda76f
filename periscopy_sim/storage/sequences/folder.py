"""Frames as the files of a folder, in the natural order of their names."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PhotographError
from periscopy_sim.photograph import Photograph
from periscopy_sim.storage.formats.decoding import listed
from periscopy_sim.storage.formats.table import suffixes
from periscopy_sim.storage.photographs import read_photograph
from periscopy_sim.storage.sequences.frames import Frames


def folder_frames(
    path: Path, shape: tuple[int, int], mask: NDArray[np.bool_] | None
) -> Frames[Photograph]:
    """Open a folder, one photograph a file; see `open_frames`."""
    files, others = files_of_one_kind(path)
    warnings = (f"{path}: left out {listed(others)}",) if others else ()
    return Frames(
        tuple(file.name for file in files),
        warnings,
        lambda: (read_photograph(file, shape, mask) for file in files),
    )


def files_of_one_kind(folder: Path) -> tuple[list[Path], list[str]]:
    """Return the pictures in a folder in natural order, and the names of its other files.

    A picture is known by its suffix; hidden files and subfolders do not count. Having none, or
    those of several formats, is a `PhotographError`.
    """
    try:
        files = [each for each in folder.iterdir() if each.name[0] != "." and not each.is_dir()]
    except OSError as error:
        raise PhotographError(f"{folder}: cannot be opened: {error.strerror}") from error
    known = suffixes()
    of_kind: dict[str, list[Path]] = {}
    for file in sorted(files, key=lambda file: _natural(file.name)):
        of_kind.setdefault(known.get(file.suffix.lower(), ""), []).append(file)
    others = [file.name for file in of_kind.pop("", [])]
    if not of_kind:
        raise PhotographError(
            f"{folder}: holds no file named *{', *'.join(known)}; name a folder that does"
        )
    if len(of_kind) > 1:
        examples = listed([f"{kind} ({files[0].name})" for kind, files in of_kind.items()])
        raise PhotographError(f"{folder}: holds {examples}; keep frames of one format alone there")
    return next(iter(of_kind.values())), others


def _natural(name: str) -> tuple[list[str | int], str]:
    """Return a sort key by which frame2 comes before frame10: text and numbers in turn."""
    pieces = re.split("([0-9]+)", name.lower())
    return [int(piece) if i % 2 else piece for i, piece in enumerate(pieces)], name
