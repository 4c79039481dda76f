"""What a data set's archive is made of: its variables and their sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from periscopy_sim.errors import DatasetError
from periscopy_sim.storage.outputs.completion import Block, digest_of
from periscopy_sim.storage.outputs.store import attributes_of

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
    """The sizes of a data set, a `StoreLayout`."""

    what: ClassVar[str] = "data set"

    count: int  # samples
    block_size: int  # samples in a block
    photograph_shape: tuple[int, int]  # (rows, columns)
    hidden_shape: tuple[int, int]  # (R, C)
    photograph_type: str
    keep_background: bool

    @property
    def blocks(self) -> int:
        """Return the number of blocks; the last may be cut short."""
        return -(-self.count // self.block_size)

    def block(self, number: int) -> Block:
        """Return a block: a file of each variable."""
        first = number * self.block_size
        samples = slice(first, min(first + self.block_size, self.count))
        files = {name: f"{name}/c/{number}" for name in LABELS}
        files |= {name: f"{name}/c/{number}/0/0/0" for name in self._stacks()}
        return Block(number, {"sample": samples}, files)

    def variables(self) -> dict[str, dict[str, Any]]:
        """Return how each variable that every sample has is laid out."""
        from zarr.codecs import BloscCodec, Crc32cCodec

        laid_out: dict[str, dict[str, Any]] = {}
        for name, (shape, dimensions, dtype) in self._stacks().items():
            # Shuffled bits compress what noise leaves alike: signs and exponents.
            blosc = BloscCodec(
                cname="zstd", clevel=1, shuffle="bitshuffle",
                typesize=np.dtype(dtype).itemsize, blocksize=0,
            )  # fmt: skip
            laid_out[name] = {
                "shape": (self.count, *shape), "chunks": (1, *shape),
                "shards": (self.block_size, *shape), "dtype": dtype, "fill_value": np.nan,
                "dimension_names": ("sample", *dimensions), "compressors": [blosc, Crc32cCodec()],
            }  # fmt: skip
        for name, dtype in LABELS.items():
            fill = "" if dtype is str else (np.nan if dtype == "float64" else -1)
            laid_out[name] = {
                "shape": (self.count,), "chunks": (self.block_size,), "dtype": dtype,
                "fill_value": fill, "dimension_names": ("sample",),
                "compressors": [Crc32cCodec()],
            }  # fmt: skip
        return {name: {**each, "attributes": VARIABLES[name]} for name, each in laid_out.items()}

    @staticmethod
    def recognizes(attributes: Mapping[str, Any]) -> bool:
        """Return whether attributes are those of a data set."""
        return attributes.get("kind") == KIND and isinstance(attributes.get("count"), int)

    def _stacks(self) -> dict[str, tuple[tuple[int, ...], tuple[str, ...], str]]:
        """Return shape, dimensions and type of a sample's pictures."""
        pixels = ((*self.photograph_shape, 3), PIXELS, self.photograph_type)
        stacks = {"photograph": pixels, "hidden": ((*self.hidden_shape, 3), PATCHES, "float32")}
        return {**stacks, **({"background": pixels} if self.keep_background else {})}


def read_head(path: Path) -> tuple[dict[str, Any], Layout, str]:
    """Return what a data set was made of, its layout, and the digest that its records bear.

    A `DatasetError` tells that there is none or that its head is damaged.
    """
    file = path / "zarr.json"
    if not file.is_file():
        what = "is no data set" if path.exists() else "no such data set"
        raise DatasetError(f"{path}: {what}; name a folder that 'periscopy dataset' has written")
    attributes = attributes_of(path)
    if not Layout.recognizes(attributes):
        raise DatasetError(
            f"{file}: is damaged, or of no data set; run 'periscopy dataset' into another folder"
        )
    sizes = attributes["layout"]
    layout = Layout(
        attributes["count"], sizes["block"], tuple(sizes["photograph_shape"]),
        tuple(sizes["hidden_shape"]), sizes["photograph_type"], sizes["keep_background"],
    )  # fmt: skip
    return attributes, layout, digest_of(attributes)
