"""A data set's archive: its layout; open one, check, describe and export it, hand it to PyTorch."""

import json
import operator
import os
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from periscopy_sim.errors import SWEEP, DatasetError, OutputError, require, require_all
from periscopy_sim.figures.panels import draw_panels
from periscopy_sim.hidden import named
from periscopy_sim.numerics.validation import RANGES
from periscopy_sim.storage import outputs, rasters
from periscopy_sim.storage.places import address, place
from periscopy_sim.storage.store import MAKING, Records, StoreLayout, attributes_of

if TYPE_CHECKING:
    import xarray as xr

KIND = "periscopy data set"

CHANNELS = ("red", "green", "blue")
"""Channels of hidden images, and of a camera without a colour matrix."""

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

Size = Annotated[int, Field(strict=True, ge=1, le=RANGES["samples"].most)]


@dataclass(frozen=True)
class Layout:
    """The sizes of a data set."""

    count: Size  # samples
    block: Size  # samples in a block
    photograph_shape: tuple[Size, Size]  # (rows, columns)
    hidden_shape: tuple[Size, Size] | dict[str, tuple[Size, Size]]  # (R, C), of several by id
    photograph_type: str
    keep_background: bool
    bounced_error: bool = False  # whether there is that label
    channels: Size = len(CHANNELS)  # of photographs

    @property
    def hidden(self) -> dict[str, tuple[int, int]]:
        """(R, C) of the hidden images by the names of their variables: of several ``hidden_ID``."""
        return named("hidden", self.hidden_shape)

    @property
    def attributes(self) -> dict[str, Any]:
        """The sizes without the count, of JSON's types, as `read_head` reads them."""
        sizes = {name: size for name, size in asdict(self).items() if name != "count"}
        for name, default in ((BOUNCED_ERROR, False), ("channels", len(CHANNELS))):
            if sizes[name] == default:
                del sizes[name]  # older data sets have none
        return dict(json.loads(json.dumps(sizes)))

    @property
    def sample_bytes(self) -> int:
        """Bytes of a sample's images before compression."""
        values = self.channels * np.prod(self.photograph_shape) * (1 + self.keep_background)
        patches = sum(np.prod(shape) for shape in self.hidden.values())
        size = np.dtype(self.photograph_type).itemsize
        return int(size * values + 4 * len(CHANNELS) * patches)

    def of_store(self) -> StoreLayout:
        """Return the layout of the archive: the variables that every sample has, in blocks."""
        from zarr.codecs import BloscCodec, Crc32cCodec

        # Labelled as the hidden images' channels where they are as many.
        channel = "channel" if self.channels == len(CHANNELS) else "camera_channel"
        shape, axes = (*self.photograph_shape, self.channels), ("row", "column", channel)
        pixels = (shape, axes, self.photograph_type)
        stacks = {"photograph": pixels}
        for name, patches in self.hidden.items():
            of = name.removeprefix("hidden")
            dimensions = f"hidden_row{of}", f"hidden_column{of}", "channel"
            stacks[name] = (*patches, len(CHANNELS)), dimensions, "float32"
        stacks |= {"background": pixels} if self.keep_background else {}
        laid_out: dict[str, dict[str, Any]] = {}
        for name, (shape, dimensions, dtype) in stacks.items():
            # Noise leaves signs and exponents alike: shuffled bits compress them.
            settings = {"shuffle": "bitshuffle", "typesize": np.dtype(dtype).itemsize}
            pictured = PICTURES["hidden" if name in self.hidden else name]
            blosc = BloscCodec(cname="zstd", clevel=1, blocksize=0, **settings)
            laid_out[name] = {
                "shape": (self.count, *shape), "chunks": (1, *shape),
                "shards": (self.block, *shape), "dtype": dtype, "fill_value": np.nan,
                "dimension_names": ("sample", *dimensions), "compressors": [blosc, Crc32cCodec()],
                "attributes": dict(zip(("long_name", "units"), pictured, strict=True)),
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
        return StoreLayout("data set", laid_out, cuts, growing=["count"])


def read_head(path: Path) -> tuple[dict[str, Any], Layout, Records]:
    """Return the attributes of a data set, its layout and the records of its blocks.

    A path without a data set, or one whose head is damaged or another's, is a `DatasetError`.
    """
    attributes = attributes_of(path)
    if attributes.get("kind") != KIND:
        raise DatasetError(f"{path}: is no data set; name the folder of one")
    try:
        layout = Layout(attributes["count"], **attributes["layout"])
        records = Records(path, layout.of_store(), attributes)
        first = records.read(next(iter(records.blocks()), (0,))).get("of", records.of)
        if first != records.of or not (path / MAKING).is_dir():
            raise ValueError
    except OutputError:
        raise
    except (KeyError, TypeError, ValueError):
        raise DatasetError(
            f"{path}: its attributes or marks are not those of a data set; open what another "
            "program saved, such as xarray, with that program, or make the data set again"
        ) from None
    return attributes, layout, records


@contextmanager
def _damage_reported(path: Path) -> Iterator[None]:
    """Raise whatever Zarr or xarray cannot read as a `DatasetError`."""
    try:
        with outputs.out_of_space_reported(path):
            yield
    except OutputError:
        raise
    except (OSError, ValueError, LookupError, TypeError, ArithmeticError) as error:
        raise DatasetError(f"{path}: is damaged: {error}; make it again") from error


def open_dataset(path: str | Path, *, incomplete: bool = False) -> "xr.Dataset":
    """Open a data set; its arrays are read when they are needed.

    Parameters
    ----------
    path
        The archive that `periscopy dataset` wrote.
    incomplete
        Whether to open one in the making: the samples up to the first that is missing.

    Returns
    -------
    xarray.Dataset
        Variables with labelled dimensions, units and, as attributes, all that they depend on, as
        text of JSON where it is nested. The variables of one text or number for each sample are
        coordinates: ``data.sel(sample=data.split == "train")``.

    Raises
    ------
    DatasetError
        If the path holds no data set, or one in the making unless `incomplete`.
    """
    require_all(*SWEEP)
    import xarray as xr

    path = place(path)
    _, layout, records = read_head(path)
    with warnings.catch_warnings(), _damage_reported(path):
        # Text of any length is not in Zarr's standard yet; the archive records what reads it.
        warnings.filterwarnings("ignore", message=".*does not have a Zarr V3 specification.*")
        data = xr.open_zarr(**address(path), consolidated=False, chunks=None)
    for name, settings in records.layout.variables.items():
        length, *shape = settings["shape"]  # it may be longer where a run that grows it was stopped
        held = data[name].shape if name in data.variables else (0,)
        if held[:1] < (length,) or [*held[1:]] != shape:
            raise DatasetError(f"{path}: its variable '{name}' is lost or too small; make it again")
    whole = takewhile({*records.held()}.__contains__, records.layout.blocks)
    ready = sum(map(records.layout.size, whole))
    if ready < layout.count and not incomplete:
        raise DatasetError(
            f"{path}: is not finished, {ready} of {layout.count} samples stand from the start on; "
            "make the rest, by the same configuration, or give incomplete=True"
        )
    of_one_value = (("sample",), ("geometries",))
    labels = [name for name, values in data.data_vars.items() if values.dims in of_one_value]
    # netCDF has no nested attributes.
    data.attrs = {n: json.dumps(v) if isinstance(v, dict) else v for n, v in data.attrs.items()}
    return data.isel(sample=slice(ready)).set_coords(labels)


def verify_dataset(
    path: str | Path, progress: Callable[[int, int], None] = lambda *_: None
) -> list[tuple[int, int]]:
    """Compare every file of a data set with its checksum.

    Return the samples that are missing or damaged, as ranges (first, one after the last).
    `progress` is called with the blocks checked and their number.
    """
    path = place(path)
    _, _, records = read_head(path)
    open_dataset(path, incomplete=True)  # where all variables have a head
    damaged: list[tuple[int, int]] = []
    blocks = [*records.layout.blocks]
    for block, is_whole in records.verified(blocks):
        samples = records.layout.place(block)["sample"]
        if not is_whole:
            joins = damaged and damaged[-1][1] == samples.start
            damaged.append((damaged.pop()[0] if joins else samples.start, samples.stop))
        progress(block[0] + 1, len(blocks))
    return damaged


def describe(path: str | Path) -> dict[str, Any]:
    """Return a data set's sizes, its progress, and a summary of its samples, of JSON's types."""
    path = place(path)
    attributes, layout, records = read_head(path)
    data = open_dataset(path, incomplete=True)
    with _damage_reported(path):
        description: dict[str, Any] = {
            "samples": layout.count,
            "finished": sum(map(records.layout.size, records.held())),
            "photograph": list(layout.photograph_shape),
            "hidden": layout.attributes["hidden_shape"],
            "seed": attributes["configuration"]["seed"],
            "versions": attributes["versions"],
        }
        for name in ("split", "hidden_kind", "ambient"):
            description[name] = dict(Counter(map(str, data[name].values)).most_common())
        for name in ("sbr", "snr", "exposure", BOUNCED_ERROR):
            if name in data and data.sizes["sample"]:
                description[name] = [float(data[name].min()), float(data[name].max())]
    return {**description, "geometries": data.sizes["geometries"]}


def export_samples(
    path: str | Path,
    folder: Path,
    indices: Sequence[int],
    progress: Callable[[int, int], None] = lambda *_: None,
) -> list[str]:
    """Write samples as EXR files, and the first 24 on a contact sheet; return the files' names.

    The folder receives ``NNNNNNNN_photograph.exr`` and ``NNNNNNNN_hidden.exr`` for each sample, of
    several surfaces ``NNNNNNNN_hidden_ID.exr``, and ``sheet.png``, where a photograph is scaled to
    its brightest value. Photographs of more channels than three are NPY files; the sheet shows
    three. `progress` is called with the samples written and their number.
    """
    path = place(path)
    _, layout, _ = read_head(path)
    data = open_dataset(path, incomplete=True)
    last = data.sizes["sample"] - 1
    if beyond := [index for index in indices if not 0 <= index <= last]:
        raise DatasetError(f"{path}: has no sample {beyond[0]}; it has 0 to {last}")
    labels = [name for name, values in data.variables.items() if values.dims == ("sample",)]
    written, titles = [], []
    sheet: dict[str, list[Any]] = {name: [] for name in ("photograph", *layout.hidden)}
    for done, index in enumerate(indices, 1):
        with _damage_reported(path):
            sample = data.isel(sample=index).load()
        notes = {str(name): str(sample[name].item()) for name in labels}
        for name, pictures in sheet.items():
            image = sample[name].values.astype(np.float32)
            is_colour = image.shape[2] == len(CHANNELS)
            written.append(f"{index:08d}_{name}.{'exr' if is_colour else 'npy'}")
            if is_colour:
                rasters.write_exr(folder / written[-1], image, notes)
            else:
                np.save(folder / written[-1], image)
            white = 1.0 if name in layout.hidden else max(image.max(), 1e-12)
            pictures.append(np.clip(image[..., :3] / white, 0, 1).astype(np.float64))
        light, sbr = notes["ambient"][:30], float(notes["sbr"])
        kind, split = notes["hidden_kind"], notes["split"]
        titles.append(f"{index}: {kind}\n{light}\nSBR {sbr:.2g}, {split}")
        progress(done, len(indices))
    rows = {}
    for start in range(0, min(len(titles), 24), 6):
        for name, pictures in sheet.items():
            above = titles if name == next(iter(sheet)) else [""] * len(titles)
            row = zip(above, pictures, strict=True)
            rows[f"{name}\nfrom {start}"] = list(row)[start : start + 6]
    draw_panels(folder / "sheet.png", rows)
    return [*written, "sheet.png"]


class TorchDataset:
    """Samples of a data set as tensors, channels first: a map-style data set for PyTorch.

    Safe to hand to a `DataLoader` with any number of workers: each opens the archive for itself.
    A batch reads its own samples alone, in any order: of each variable and block an index, and for
    each sample a range of bytes, which adds less than 2 % to what is stored. The name can be looked
    up without PyTorch; making one needs it.

    Parameters
    ----------
    path
        The archive that `periscopy dataset` wrote.
    split
        ``train``, ``validation`` or ``test``; None for all.
    variables
        Names of the variables that a sample holds, or one name.
    transform
        Applied to each sample, a dict of tensors.

    Raises
    ------
    DatasetError
        If the path holds no finished data set, the split no samples, or a variable is not known.
    """

    def __init__(
        self,
        path: str | Path,
        split: str | None = None,
        variables: Sequence[str] | str = ("photograph", "hidden"),
        transform: Callable[[dict[str, Any]], Any] | None = None,
    ) -> None:
        require("torch")
        variables = (variables,) if isinstance(variables, str) else tuple(variables)
        data = open_dataset(path)
        for name in variables:
            if name not in data.variables or data[name].dims[0] != "sample":
                known = ", ".join(sorted(map(str, data.variables)))
                raise DatasetError(f"{path}: has no variable '{name}' of samples; it has {known}")
        splits = data["split"].values
        self.samples = np.arange(len(splits)) if split is None else np.flatnonzero(splits == split)
        if not len(self.samples):
            known = ", ".join(sorted({*splits.tolist()}))
            raise DatasetError(f"{path}: has no samples of split '{split}'; it has {known}")
        self.path, self.variables, self.transform = place(path), variables, transform
        self._opened: tuple[int, Any] | None = None

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    def __getitem__(self, number: int) -> Any:
        """Return a sample: its variables' tensors by name.

        A `DataLoader` makes batches, and ``torch.utils.data.Subset`` is a part of the samples.
        """
        return self.__getitems__([number])[0]

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Return the samples of a batch, read at once, as PyTorch's loaders ask for them."""
        import zarr

        # An archive opened before a fork waits for threads that the fork has left behind.
        if self._opened is None or self._opened[0] != os.getpid():
            self._opened = os.getpid(), zarr.open_group(**address(self.path), mode="r")
        group = self._opened[1]
        chosen = self.samples[np.array([*map(operator.index, indices)], int)]
        wanted, places = np.unique(chosen, return_inverse=True)
        columns = {name: group[name].oindex[wanted][places] for name in self.variables}
        samples = [{n: _tensor(v[k]) for n, v in columns.items()} for k in range(len(places))]
        return samples if self.transform is None else [self.transform(each) for each in samples]

    def __getstate__(self) -> dict[str, Any]:
        """Leave the opened archive behind."""
        return {**self.__dict__, "_opened": None}


def _tensor(value: Any) -> Any:
    """Return a picture as a tensor, channels first, a number as one, text as it is."""
    import torch

    if isinstance(value, str):
        return value
    return torch.as_tensor(np.ascontiguousarray(np.moveaxis(value, -1, 0)) if value.ndim else value)
