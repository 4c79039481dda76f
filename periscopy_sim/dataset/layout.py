"""The layout of a data set's archive: its variables and their sizes."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from periscopy_sim.errors import DatasetError
from periscopy_sim.storage.outputs.store import Records, StoreLayout, attributes_of

KIND = "periscopy data set"

PIXELS = ("row", "column", "channel")
PATCHES = ("hidden_row", "hidden_column", "channel")

_EXPOSED = "mean of a photograph of exposure 1"
PICTURES = {  # long name and units
    "photograph": ("photograph of the wall, linear light", _EXPOSED),
    "hidden": ("hidden image, linear light", "white of the monitor"),
    "background": ("ambient light of the photograph, without noise", _EXPOSED),
}
BOUNCED_ERROR = "bounced_error"
_OF_WHITE = "error of a white image's photograph by light that bounces over it; 0 if none bounces"
_SCALE = "photograph's unit over that of A f: photograph = scale A f + background"
LABELS: dict[str, tuple[Any, str, str | None]] = {
    "signal_scale": ("float64", _SCALE, "1"),
    "sbr": ("float64", "signal-to-background ratio", "1"),
    "snr": ("float64", "signal-to-noise ratio", "dB"),
    "exposure": ("float64", "mean of the photograph without noise", "1"),
    BOUNCED_ERROR: ("float64", _OF_WHITE, "1"),
    "clip_number": ("int64", "number of the video that the photograph is of", None),
    "frame": ("int32", "number of the frame within its video", None),
    "geometry": ("int32", "number of the scene and its parameters", None),
    "split": (str, "train, validation or test", None),
    "hidden_kind": (str, "source of the hidden image", None),
    "ambient": (str, "source of the ambient light", None),
}
"""Variables of one value for each sample: type, long name and units.

`BOUNCED_ERROR` is there only if A has light that bounces.
"""


@dataclass(frozen=True)
class Layout:
    """The sizes of a data set."""

    count: int  # samples
    block: int  # samples in a block
    photograph_shape: tuple[int, int]  # (rows, columns)
    hidden_shape: tuple[int, int]  # (R, C)
    photograph_type: str
    keep_background: bool
    bounced_error: bool = False  # whether there is that label

    @property
    def attributes(self) -> dict[str, Any]:
        """The sizes without the count, of JSON's types, as `read_head` reads them."""
        left_out = {"count"} if self.bounced_error else {"count", BOUNCED_ERROR}
        sizes = {name: size for name, size in asdict(self).items() if name not in left_out}
        return dict(json.loads(json.dumps(sizes)))

    def of_store(self) -> StoreLayout:
        """Return the layout of the archive: the variables that every sample has, in blocks."""
        from zarr.codecs import BloscCodec, Crc32cCodec

        laid_out: dict[str, dict[str, Any]] = {}
        for name, (shape, dimensions, dtype) in self._stacks().items():
            # Noise leaves signs and exponents alike: shuffled bits compress them.
            settings = {"shuffle": "bitshuffle", "typesize": np.dtype(dtype).itemsize}
            blosc = BloscCodec(cname="zstd", clevel=1, blocksize=0, **settings)
            laid_out[name] = {
                "shape": (self.count, *shape), "chunks": (1, *shape),
                "shards": (self.block, *shape), "dtype": dtype, "fill_value": np.nan,
                "dimension_names": ("sample", *dimensions), "compressors": [blosc, Crc32cCodec()],
                "attributes": dict(zip(("long_name", "units"), PICTURES[name], strict=True)),
            }  # fmt: skip
        for name, (dtype, long_name, units) in LABELS.items():
            if name == BOUNCED_ERROR and not self.bounced_error:
                continue
            fill = "" if dtype is str else (np.nan if dtype == "float64" else -1)
            laid_out[name] = {
                "shape": (self.count,), "chunks": (self.block,), "dtype": dtype,
                "fill_value": fill, "dimension_names": ("sample",), "compressors": [Crc32cCodec()],
                "attributes": {"long_name": long_name} | ({"units": units} if units else {}),
            }  # fmt: skip
        cuts = {"sample": (self.count, self.block)}
        return StoreLayout("data set", laid_out, cuts, self.count)

    def _stacks(self) -> dict[str, tuple[tuple[int, ...], tuple[str, ...], str]]:
        """Return shape, dimensions and type of a sample's pictures."""
        pixels = ((*self.photograph_shape, 3), PIXELS, self.photograph_type)
        stacks = {"photograph": pixels, "hidden": ((*self.hidden_shape, 3), PATCHES, "float32")}
        return {**stacks, **({"background": pixels} if self.keep_background else {})}


def read_head(path: Path) -> tuple[dict[str, Any], Layout, Records]:
    """Return the attributes of a data set, its layout and the records of its blocks.

    A path without a data set, or one whose head is damaged, is a `DatasetError`.
    """
    attributes = attributes_of(path)
    if attributes.get("kind") != KIND or not isinstance(attributes.get("count"), int):
        raise DatasetError(f"{path}: is no data set; name one that 'periscopy dataset' wrote")
    sizes: dict[str, Any] = dict(attributes["layout"])
    sizes |= {name: tuple(sizes[name]) for name in ("photograph_shape", "hidden_shape")}
    layout = Layout(attributes["count"], **sizes)
    return attributes, layout, Records(path, layout.of_store(), attributes)
