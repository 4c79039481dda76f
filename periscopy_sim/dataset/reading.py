"""Open a data set, check it, describe it."""

from __future__ import annotations

import json
import warnings
from collections import Counter
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from periscopy_sim.dataset.layout import BOUNCED_ERROR, read_head
from periscopy_sim.errors import DatasetError
from periscopy_sim.extras import require_all

if TYPE_CHECKING:
    import xarray as xr


def open_dataset(path: str | Path, *, incomplete: bool = False) -> xr.Dataset:
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
    PeriscopyError
        If a package of the extra ``dataset`` is not installed.
    """
    require_all()
    import xarray as xr

    path = Path(path)
    _, layout, records = read_head(path)
    blocks = records.layout.blocks
    ready = sum(records.layout.size(n) for n in takewhile(records.has, blocks))
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
    if lost := {*records.layout.variables} - {*data.variables}:
        raise DatasetError(f"{path}: has lost its variable '{min(lost)}'; make it again")
    of_one_value = (("sample",), ("geometries",))
    labels = [name for name, values in data.data_vars.items() if values.dims in of_one_value]
    # netCDF has no nested attributes.
    data.attrs = {n: json.dumps(v) if isinstance(v, dict) else v for n, v in data.attrs.items()}
    return data.isel(sample=slice(ready)).set_coords(labels)


def verify_dataset(
    path: str | Path, progress: Callable[[int, int], None] | None = None
) -> list[tuple[int, int]]:
    """Compare every file of a data set with its checksum.

    Return the samples that are missing or damaged, as ranges (first, one after the last).
    `progress` is called with the blocks checked and their number.
    """
    path = Path(path)
    _, _, records = read_head(path)
    open_dataset(path, incomplete=True)  # where all variables have a head
    damaged: list[tuple[int, int]] = []
    blocks = records.layout.blocks
    for number in blocks:
        samples = records.layout.place(number)["sample"]
        if not records.verify(number):
            joins = damaged and damaged[-1][1] == samples.start
            damaged.append((damaged.pop()[0] if joins else samples.start, samples.stop))
        if progress is not None:
            progress(number + 1, len(blocks))
    return damaged


def describe(path: str | Path) -> dict[str, Any]:
    """Return a data set's sizes, its progress, and a summary of its samples, of JSON's types."""
    path = Path(path)
    attributes, layout, records = read_head(path)
    data = open_dataset(path, incomplete=True)
    sizes = {n: records.layout.size(n) for n in records.layout.blocks if records.has(n)}
    description: dict[str, Any] = {
        "samples": layout.count,
        "finished": sum(sizes.values()),
        "photograph": list(layout.photograph_shape),
        "hidden": list(layout.hidden_shape),
        "bytes": sum(file.stat().st_size for file in path.rglob("*") if file.is_file()),
        "seed": attributes["configuration"]["seed"],
        "versions": attributes["versions"],
    }
    for name in ("split", "hidden_kind", "ambient"):
        description[name] = dict(Counter(map(str, data[name].values)).most_common())
    for name in ("sbr", "snr", "exposure", BOUNCED_ERROR):
        if name in data and data.sizes["sample"]:
            description[name] = [float(data[name].min()), float(data[name].max())]
    return {**description, "geometries": data.sizes["geometries"]}
