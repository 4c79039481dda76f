"""Open a data set, check it, describe it."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.dataset.archive.layout import BOUNCED_ERROR, Layout, read_head
from periscopy_sim.errors import DatasetError
from periscopy_sim.extras import require_all
from periscopy_sim.storage.outputs.store import (
    Block,
    checksum,
    is_recorded,
    read_record,
    record_file,
)

if TYPE_CHECKING:
    import xarray as xr


def open_dataset(path: str | Path, *, incomplete: bool = False) -> xr.Dataset:
    """Open a data set; its arrays are read when they are needed.

    Parameters
    ----------
    path
        What `periscopy dataset` wrote.
    incomplete
        Whether to open one in the making: the samples up to the first that is missing.

    Returns
    -------
    xarray.Dataset
        Variables with labelled dimensions, units and, as attributes, all they were made of. The
        variables of one text or number for each sample are coordinates:
        ``data.sel(sample=data.split == "train")``.

    Raises
    ------
    DatasetError
        If the path holds no data set, or one in the making unless `incomplete`.
    PeriscopyError
        If what the extra ``dataset`` brings is not installed.
    """
    require_all()
    import xarray as xr

    path = Path(path)
    _, layout, digest = read_head(path)
    blocks = map(layout.block, range(layout.blocks))
    ready = sum(b.size for b in takewhile(lambda b: is_recorded(path, digest, b), blocks))
    if ready < layout.count and not incomplete:
        raise DatasetError(
            f"{path}: is not finished, {ready} of {layout.count} samples stand from the start on; "
            "run 'periscopy dataset' again, or give incomplete=True"
        )
    with warnings.catch_warnings():
        # Text of any length is not in Zarr's standard yet; the archive records what reads it.
        warnings.filterwarnings("ignore", message=".*does not have a Zarr V3 specification.*")
        try:
            data = xr.open_dataset(path, engine="zarr", consolidated=False, chunks=None)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DatasetError(f"{path}: is damaged: {error}; make it again") from error
    labels = [
        str(name) for name, values in data.data_vars.items()
        if values.dims in (("sample",), ("geometries",))
    ]  # fmt: skip
    return data.isel(sample=slice(ready)).set_coords(labels)


@dataclass(frozen=True)
class Damage:
    """Neighbouring blocks that are not what was written."""

    samples: tuple[int, int]  # their first, and the one after their last
    reason: str


def verify_dataset(
    path: str | Path, progress: Callable[[int, int], None] | None = None
) -> tuple[int, list[Damage]]:
    """Check every file of a data set against its checksum, and decode every chunk.

    Return the number of whole samples, and what is damaged or missing. `progress` is called with
    the blocks checked and their number.
    """
    path = Path(path)
    _, layout, digest = read_head(path)
    group, reason = _opened(path, layout)
    if reason:
        return 0, [Damage((0, layout.count), reason)]

    def fault(block: Block) -> str:
        if not record_file(path, block.number).is_file():
            found = "missing"
        elif not is_recorded(path, digest, block):
            found = "its record is damaged, or of another count or configuration"
        else:
            found = _fault(path, group, block)
        if progress is not None:
            progress(block.number + 1, layout.blocks)
        return found

    damaged, whole = [], 0
    for reason, neighbours in groupby(map(layout.block, range(layout.blocks)), fault):
        samples = [block.place["sample"] for block in neighbours]
        first, after = samples[0].start, samples[-1].stop
        if reason:
            damaged.append(Damage((first, after), reason))
        else:
            whole += after - first
    return whole, damaged


def _fault(path: Path, group: Any, block: Block) -> str:
    """Return what is wrong with a block; empty where nothing is."""
    record = read_record(path, block.number)
    for name, expected in record["crc32c"].items():
        try:
            if checksum(path / block.files[name]) != expected:
                return f"{name}: another checksum"
        except OSError as error:
            return f"{name}: {error.strerror}"
        try:
            values = np.asarray(group[name][block.place["sample"]])
        except Exception as error:  # whatever a codec says of bytes it cannot decode
            return f"{name}: {type(error).__name__}: {error}"
        if values.dtype.kind == "f" and name != "sbr" and not np.isfinite(values).all():
            return f"{name}: holds NaN or infinity"
    return ""


def _opened(path: Path, layout: Layout) -> tuple[Any, str]:
    """Open the archive and read what is not of samples; say what is wrong, if anything is."""
    import zarr

    name = "zarr.json"
    try:
        group: Any = zarr.open_group(path, mode="r", zarr_format=3)
        for name, array in group.arrays():
            if array.metadata.dimension_names[0] != "sample":
                if not (path / name / "c" / "0").is_file():
                    return None, f"{name}: its file is missing"
                np.asarray(array[:])
            elif array.shape[0] != layout.count:
                return None, f"{name}: has {array.shape[0]} samples, not {layout.count}"
        missing = [each for each in layout.variables() if each not in group]
    except Exception as error:  # whatever a codec says of bytes it cannot decode
        return None, f"{name}: {type(error).__name__}: {error}"
    return group, f"{missing[0]}: is missing" if missing else ""


def describe(path: str | Path) -> dict[str, Any]:
    """Return a data set's sizes, what is done of it, and what its samples are, of JSON's types."""
    path = Path(path)
    attributes, layout, digest = read_head(path)
    blocks = map(layout.block, range(layout.blocks))
    finished = sum(block.size for block in blocks if is_recorded(path, digest, block))
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    description: dict[str, Any] = {
        "samples": layout.count,
        "finished": finished,
        "photograph": list(layout.photograph_shape),
        "hidden": list(layout.hidden_shape),
        "bytes": size,
        "seed": attributes["configuration"]["seed"],
        "versions": attributes["versions"],
    }
    data = open_dataset(path, incomplete=True)
    missing = [name for name in layout.variables() if name not in data.variables]
    if missing:
        raise DatasetError(f"{path}: its variable '{missing[0]}' is lost; make it again")
    for name in ("split", "hidden_kind", "ambient"):
        description[name] = dict(Counter(str(text) for text in data[name].values).most_common())
    bounced = (BOUNCED_ERROR,) if layout.bounced_error else ()
    for name in ("sbr", "snr", "exposure", *bounced):
        values = data[name].values
        if len(values):
            description[name] = [float(values.min()), float(values.max())]
    description["geometries"] = data.sizes["geometries"]
    return description
