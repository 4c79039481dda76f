"""The store of a sweep: a Zarr archive over all axes, whose cells many runs fill."""

import json
from collections.abc import Mapping, Sequence
from itertools import product
from math import prod
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from periscopy_sim.errors import OutputError, PeriscopyError
from periscopy_sim.evaluation.metrics import METRICS
from periscopy_sim.numerics import machine, validation
from periscopy_sim.storage.outputs import out_of_space_reported
from periscopy_sim.storage.places import address, answers, names_in
from periscopy_sim.storage.store import MAKING, Block, BlockStore, Label, StoreLayout, attributes_of

if TYPE_CHECKING:
    import xarray as xr

COLOURS = {1: ["grey"], 3: ["red", "green", "blue"]}
"""Names of an image's channels, where they have some."""

MADE = {
    "transport_model": (str, "", "how the method's A was made"),
    "transport_samples": (np.float64, np.nan, "its rays from each wall point to each patch"),
    "transport_error": (np.float64, np.nan, "its error of a white image's light, over the mean"),
    "photograph_error": (np.float64, np.nan, "the photograph's own, over its root mean square"),
}
"""Variables on how A and photograph were made: type, what stands for none, and meaning."""

Values = Mapping[str, Any]
"""Values of some axes, by their names."""


class SweepStore:
    """A sweep's results, in the making or complete, a cell a block.

    A store keeps the values that earlier sweeps gave its axes; a sweep adds its own, and its
    attribute ``asked`` has those of the last sweep. Of several
    surfaces each variable is there for each, as ``psnr_ID``; of several sizes each has its images,
    as ``reconstruction_29x36``.

    Parameters
    ----------
    path
        The archive.
    axes
        The values of each axis of the sweep.
    images
        Shape of each surface's images, (R, C, channels), by what the names of its variables end in.
    conditions, conditions_of
        All that every cell depends on, and of what those of single values of an axis depend on
        besides, by axis and value.
    units
        Units of axes.
    measures
        Further variables, a number for each cell: their attributes.
    """

    def __init__(
        self,
        path: Path,
        axes: Mapping[str, Sequence[Any]],
        images: Mapping[str, tuple[int, ...]],
        conditions: Mapping[str, Any],
        conditions_of: Mapping[str, Mapping[str, Any]],
        units: Mapping[str, str],
        measures: Mapping[str, Mapping[str, Any]],
    ) -> None:
        self.path, self._wanted, self._measures = path, axes, measures
        self._surfaces = [*images]
        with out_of_space_reported(path):
            names = names_in(path / MAKING / "finished")
            named = [PurePath(name).stem.split("-") for name in names]
            cells = [cell for cell in named if all(map(str.isdecimal, cell))]
        held = attributes_of(path) if cells else {}
        if cells and "axes" not in held:
            raise OutputError(f"{path} is damaged, or of an older version; name another folder")
        self.axes = _joined(path, held.get("axes", axes), axes)
        self._images = {of: tuple(shape) for of, shape in images.items()}
        if "hidden" in axes:
            if len(images) > 1:
                raise PeriscopyError("an axis 'hidden' is of one hidden surface; there are several")
            channels = next(iter(images.values()))[2]
            self._images = {
                f"_{n}": (*validation.size_of(n), channels) for n in self.axes["hidden"]
            }
        needed = 4e-9 * prod(map(len, axes.values())) * sum(map(prod, self._images.values()))
        available = machine.available_memory()
        if available is not None and needed > available / 1e9:
            raise OutputError(
                f"the images of the sweep need {needed:.1f} GB of memory, of "
                f"{available / 1e9:.1f} GB; give its axes fewer values"
            )
        known = {axis: dict(each) for axis, each in held.get("conditions_of", {}).items()}
        used = {
            axis: {values[int(cell[k])] for cell in cells}
            for k, (axis, values) in enumerate(held.get("axes", {}).items())
        }
        for axis, each in conditions_of.items():
            before = known.setdefault(axis, {})
            for name in each.keys() & before.keys() & used.get(axis, set()):
                own = json.loads(json.dumps(each[name]))
                if own != before[name]:
                    parts = own if isinstance(own, dict) else {}
                    changed = [part for part in parts if parts[part] != before[name].get(part)]
                    raise OutputError(
                        f"{path}: {axis} '{name}'{f' ({changed[0]})' if changed else ''} has "
                        "changed since its results were computed; rename it, or name another folder"
                    )
            before |= each
        growing = {"axes": self.axes, "conditions_of": known, "asked": axes}
        cuts = {axis: (len(values), 1) for axis, values in self.axes.items()}
        layout = StoreLayout("sweep", self._variables(), cuts, [*growing])
        units = {"sbr": "1", "snr": "dB", **units}
        labels = {
            axis: Label(axis, values, {"units": units[axis]} if axis in units else {})
            for axis, values in self.axes.items()
        }
        for of, shape in self._images.items():
            numbers = *map(range, shape[:2]), COLOURS.get(shape[2], range(shape[2]))
            places = dict(zip(_pixels(of), numbers, strict=True))
            labels |= {name: Label(name, values) for name, values in places.items()}
        self._store = BlockStore(path, layout, {**conditions, **growing}, labels)

    def _variables(self) -> dict[str, dict[str, Any]]:
        """Return how each variable is laid out."""
        from zarr.codecs import Crc32cCodec, ZstdCodec

        whole, cell = tuple(map(len, self.axes.values())), (1,) * len(self.axes)
        # A checksum, so that a damaged chunk is an error, not a result.
        common: dict[str, Any] = {
            "shape": whole, "chunks": cell, "dimension_names": [*self.axes],
            "compressors": [ZstdCodec(), Crc32cCodec()],
        }  # fmt: skip
        metric = {**common, "dtype": np.float64, "fill_value": np.nan}
        image = {
            **common, "dtype": np.float32, "fill_value": np.nan,
            "attributes": {
                "long_name": "hidden image, linear light", "units": "photograph's over A's"
            },
        }  # fmt: skip
        why = {"long_name": "why the method failed, or nothing"}
        return {
            **{
                f"{name}{of}": {**metric, "attributes": notes}
                for of in self._surfaces for name, notes in METRICS.items()
            },
            **{name: {**metric, "attributes": notes} for name, notes in self._measures.items()},
            **{
                f"reconstruction{of}": {
                    **image, "shape": (*whole, *shape), "chunks": (*cell, *shape),
                    "dimension_names": [*self.axes, *_pixels(of)],
                }
                for of, shape in self._images.items()
            },
            "failure": {**common, "dtype": str, "fill_value": "", "attributes": why},
            **{
                name: {**common, "dtype": kind, "fill_value": none, "attributes": {"long_name": of}}
                for name, (kind, none, of) in MADE.items()
            },
        }  # fmt: skip

    def missing(self) -> list[dict[str, Any]]:
        """Return the cells of the sweep that are not complete yet, or failed."""
        wanted = product(*self._wanted.values())
        cells = [dict(zip(self._wanted, values, strict=True)) for values in wanted]
        blocks, records = [*map(self._block, cells)], self._store.records
        read = answers(self.path, records.read, blocks)
        return [  # an empty reason has no file
            cell
            for cell, (_, is_whole), record in zip(
                cells, records.verified(blocks), read, strict=True
            )
            if not is_whole or "failure" in record.get("crc32c", ())
        ]

    def write(self, cell: Values, outcome: Values) -> None:
        """Write a method's variables in a cell, and record that it is complete."""
        block = self._block(cell)
        placed = {n: np.asarray(each)[(None,) * len(block)] for n, each in outcome.items()}
        self._store.write(block, placed)

    def _block(self, cell: Values) -> Block:
        return tuple(values.index(cell[name]) for name, values in self.axes.items())

    def load(self) -> "xr.Dataset":
        """Read the sweep's results into memory."""
        results = read_sweep(self.path, self._wanted)
        others = {*self.axes.get("hidden", ())} - {*self._wanted.get("hidden", ())}
        results = results.drop_dims([f"{n}_{size}" for size in others for n in ("row", "column")])
        results.attrs["conditions_of"] = {
            axis: {value: of[value] for value in of if value in self._wanted.get(axis, of)}
            for axis, of in results.attrs["conditions_of"].items()
        }
        return results


def read_sweep(path: Path, at: Mapping[str, Sequence[Any]] | None = None) -> "xr.Dataset":
    """Read a sweep's results into memory, all or those at values of axes."""
    import xarray as xr

    with (
        out_of_space_reported(path),
        xr.open_zarr(**address(path), consolidated=False, chunks=None) as dataset,
    ):
        results = dataset.sel(at).load()
    numbers = [name for name in results.sizes if results[name].dtype.kind in "if"]
    # Those of a later run come last in the store. To sort copies all.
    if later := [name for name in numbers if (np.diff(results[name]) < 0).any()]:
        results = results.sortby(later)
    # Strings of fixed width, which more of xarray and pandas take than NumPy's newer ones.
    texts = [results[name] for name in results.variables if results[name].dtype.kind == "T"]
    results = results.assign(
        {t.name: (t.dims, np.array(t.values.tolist(), np.str_), t.attrs) for t in texts}
    )
    for of_store in ("axes", "asked"):
        results.attrs.pop(of_store, None)
    return results[sorted(map(str, results.data_vars))]


def _pixels(of: str) -> tuple[str, str, str]:
    """Return the names of an image's dimensions, of a surface's or a size's variable."""
    return f"row{of}", f"column{of}", "channel"


def _joined(
    path: Path, held: Mapping[str, Sequence[Any]], wanted: Mapping[str, Sequence[Any]]
) -> dict[str, list[Any]]:
    """Return the values of axes that a store holds, then new ones; the axes must be the same."""
    if {*held} != {*wanted}:
        raise OutputError(
            f"{path} is a sweep over {', '.join(held)}, this one over {', '.join(wanted)}; name "
            "another folder"
        )
    return {
        axis: [*held[axis], *(each for each in values if each not in held[axis])]
        for axis, values in ((axis, wanted[axis]) for axis in held)
    }
