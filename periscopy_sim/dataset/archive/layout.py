"""What a data set's archive is made of: its variables, its sizes, and what tells it from others."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from periscopy_sim.errors import DatasetError

MAKING = "making"
"""Folder (and empty Zarr group) of what belongs to the making alone."""

KIND = "periscopy data set"

PIXELS = ("row", "column", "channel")
PATCHES = ("hidden_row", "hidden_column", "channel")

VARIABLES: dict[str, dict[str, str]] = {
    "photograph": {
        "long_name": "photograph of the wall, linear light",
        "units": "mean of a photograph of exposure 1",
    },
    "hidden": {"long_name": "hidden image, linear light", "units": "white of the monitor"},
    "background": {
        "long_name": "ambient light of the photograph, without noise",
        "units": "mean of a photograph of exposure 1",
    },
    "signal_scale": {
        "long_name": "photograph's unit over that of A f: photograph = scale A f + background",
        "units": "1",
    },
    "sbr": {"long_name": "signal-to-background ratio", "units": "1"},
    "snr": {"long_name": "signal-to-noise ratio", "units": "dB"},
    "exposure": {"long_name": "mean of the photograph without noise", "units": "1"},
    "clip_number": {"long_name": "number of the video that the photograph is of"},
    "frame": {"long_name": "number of the frame within its video"},
    "geometry": {"long_name": "number of the scene and its parameters"},
    "split": {"long_name": "train, validation or test"},
    "hidden_kind": {"long_name": "source of the hidden image"},
    "ambient": {"long_name": "source of the ambient light"},
}

LABELS: dict[str, Any] = {
    "signal_scale": "float64",
    "sbr": "float64",
    "snr": "float64",
    "exposure": "float64",
    "clip_number": "int64",
    "frame": "int32",
    "geometry": "int32",
    "split": str,
    "hidden_kind": str,
    "ambient": str,
}
"""Variables of one value for each sample, and their types."""


@dataclass(frozen=True)
class Layout:
    """The sizes of a data set.

    Attributes
    ----------
    count
        Samples.
    block
        Samples in a block.
    photograph_shape, hidden_shape
        (rows, columns) and (R, C).
    photograph_type
        Of the photographs' numbers.
    keep_background
        Whether there is a variable `background`.
    """

    count: int
    block: int
    photograph_shape: tuple[int, int]
    hidden_shape: tuple[int, int]
    photograph_type: str
    keep_background: bool

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the variables that every sample has."""
        stacks = ("photograph", "hidden", *(("background",) if self.keep_background else ()))
        return (*stacks, *LABELS)

    @property
    def blocks(self) -> int:
        """Number of blocks; the last may be cut short."""
        return -(-self.count // self.block)

    def samples_in(self, block: int) -> slice:
        """Give the indices of a block's samples."""
        return slice(block * self.block, min((block + 1) * self.block, self.count))


def read_attributes(path: Path) -> dict[str, Any]:
    """Read what a data set was made of.

    Raises
    ------
    DatasetError
        If the path holds no data set, or its head is damaged.
    """
    file = path / "zarr.json"
    if not file.is_file():
        what = "is no data set" if path.exists() else "no such data set"
        raise DatasetError(f"{path}: {what}; name a folder that 'periscopy dataset' has written")
    try:
        attributes = dict(json.loads(file.read_text("utf-8"))["attributes"])
        if attributes["kind"] == KIND and isinstance(attributes["count"], int):
            return attributes
    except (ValueError, KeyError, TypeError, OSError):
        pass
    raise DatasetError(
        f"{file}: is damaged, or of no data set; run 'periscopy dataset' into another folder"
    )


def digest_of(attributes: Mapping[str, Any]) -> str:
    """Tell data sets apart by all that their samples depend on; the count is not of it."""
    fixed = {name: value for name, value in attributes.items() if name != "count"}
    return hashlib.sha256(json.dumps(fixed, sort_keys=True).encode()).hexdigest()[:16]


def layout_of(attributes: Mapping[str, Any]) -> Layout:
    """Read the sizes from a data set's attributes."""
    sizes = attributes["layout"]
    return Layout(
        count=attributes["count"],
        block=sizes["block"],
        photograph_shape=tuple(sizes["photograph_shape"]),
        hidden_shape=tuple(sizes["hidden_shape"]),
        photograph_type=sizes["photograph_type"],
        keep_background=sizes["keep_background"],
    )
