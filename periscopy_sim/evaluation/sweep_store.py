"""The results of a sweep on disk: a `BlockStore` whose blocks are trials.

A trial is one photograph reconstructed by every method.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs.staging import staged_file
from periscopy_sim.storage.outputs.store import Block, BlockStore

if TYPE_CHECKING:
    import xarray as xr

LABELS = ("algorithm", "background", "sbr", "seed")
"""Not `method`: xarray's `sel` takes that for a keyword of its own, and selects nothing."""
PIXELS = ("row", "column", "channel")
GAIN_MATCHED = "gain-matched: uses the truth"
METRICS = {
    "mean_squared_error": {
        "long_name": "mean squared error, white being 1",
        "units": "1",
        "note": GAIN_MATCHED,
    },
    "psnr": {"long_name": "peak signal-to-noise ratio", "units": "dB", "note": GAIN_MATCHED},
    "psnr_registered": {
        "long_name": "peak signal-to-noise ratio after the best shift of at most 2 patches",
        "units": "dB",
        "note": f"{GAIN_MATCHED}, to find the shift too",
    },
}


class Trial(NamedTuple):
    """Labels of one photograph."""

    background: str
    sbr: float
    seed: int


class Outcome(NamedTuple):
    """What one method made of one photograph; NaN where it failed."""

    image: NDArray[np.float32]  # (R, C, 3)
    metrics: tuple[float, ...]  # values of `METRICS`, in their order
    failure: str  # why it failed; empty where it did not


class SweepLayout:
    """How a sweep's results are laid out, a `StoreLayout`; each trial is a block.

    `labels` are the values of each of `LABELS`, `hidden_shape` is (R, C) of the images.
    """

    what = "sweep"
    count = None

    def __init__(self, labels: Mapping[str, Sequence[Any]], hidden_shape: tuple[int, int]) -> None:
        self.labels, self.hidden_shape = labels, hidden_shape
        self.trials = [Trial(*place) for place in product(*(labels[n] for n in LABELS[1:]))]
        self._shape = tuple(len(labels[name]) for name in LABELS)

    @property
    def blocks(self) -> int:
        """Return the number of trials."""
        return len(self.trials)

    def block(self, number: int) -> Block:
        """Return the block of a trial: a file of each variable."""
        place = [int(i) for i in np.unravel_index(number, self._shape[1:])]
        chunk = "/".join(map(str, (0, *place)))
        files = {name: f"{name}/c/{chunk}" for name in (*METRICS, "failure")}
        files["reconstruction"] = f"reconstruction/c/{chunk}/0/0/0"
        slices = [slice(i, i + 1) for i in place]
        return Block(number, dict(zip(LABELS[1:], slices, strict=True)), files)

    def variables(self) -> dict[str, dict[str, Any]]:
        """Return how each variable is laid out."""
        from zarr.codecs import Crc32cCodec, ZstdCodec

        one_trial = (len(self.labels["algorithm"]), 1, 1, 1)
        pixels = (*self.hidden_shape, 3)
        # A checksum, so that a damaged chunk is an error, not a result.
        common: dict[str, Any] = {
            "shape": self._shape, "chunks": one_trial, "dimension_names": LABELS,
            "compressors": [ZstdCodec(), Crc32cCodec()],
        }  # fmt: skip
        metric = {**common, "dtype": np.float64, "fill_value": np.nan}
        return {
            **{name: {**metric, "attributes": notes} for name, notes in METRICS.items()},
            "reconstruction": {
                **common, "shape": (*self._shape, *pixels), "chunks": (*one_trial, *pixels),
                "dimension_names": (*LABELS, *PIXELS), "dtype": np.float32, "fill_value": np.nan,
                "attributes": {
                    "long_name": "hidden image, linear light", "units": "photograph's over A's"
                },
            },
            "failure": {
                **common, "dtype": str, "fill_value": "",
                "attributes": {"long_name": "why the method failed, or nothing"},
            },
        }  # fmt: skip

    def recognizes(self, attributes: Mapping[str, Any]) -> bool:
        """Return whether a store's attributes are those of a sweep."""
        return "base_seed" in attributes


class SweepStore:
    """A sweep's results, in the making or complete, in a `BlockStore` of a `SweepLayout`.

    `configuration` is all that the results depend on, of JSON's types: the store's attributes.
    """

    def __init__(
        self,
        path: Path,
        labels: Mapping[str, Sequence[Any]],
        hidden_shape: tuple[int, int],
        configuration: Mapping[str, Any],
    ) -> None:
        if (path / "method").is_dir():
            raise OutputError(
                f"{path}: was written by an older version, which called the dimension "
                "'algorithm' 'method'; remove it, or name another folder"
            )
        self.path, self._layout = path, SweepLayout(labels, hidden_shape)
        pixels = (*map(range, hidden_shape), ["red", "green", "blue"])
        coordinates = {**labels, **dict(zip(PIXELS, pixels, strict=True))}
        named = {name: (name, values) for name, values in coordinates.items()}
        self._store = BlockStore(path, self._layout, configuration, named)

    def missing(self) -> list[Trial]:
        """Return the trials that are not complete yet."""
        return [self._layout.trials[number] for number in self._store.missing()]

    def write(self, trial: Trial, outcomes: Sequence[Outcome]) -> None:
        """Keep what every method, in order, made of a trial, and record that it is complete."""
        images, metrics, failures = zip(*outcomes, strict=True)
        of_methods: dict[str, NDArray[Any]] = {
            "reconstruction": np.stack(images),
            "failure": np.array(failures, np.dtypes.StringDType()),
            **dict(zip(METRICS, np.transpose(metrics), strict=True)),
        }
        cell = {name: values[:, None, None, None] for name, values in of_methods.items()}
        self._store.write(self._layout.trials.index(trial), cell)

    def load(self) -> xr.Dataset:
        """Read the results into memory."""
        import xarray as xr

        with xr.open_dataset(self.path, engine="zarr", consolidated=False) as dataset:
            results = dataset[[*METRICS, "reconstruction", "failure"]].load()
        # Strings of fixed width, which more of xarray and pandas take than NumPy's newer ones.
        texts = [results[name] for name in results.variables if results[name].dtype.kind == "T"]
        return results.assign(
            {t.name: (t.dims, np.array(t.values.tolist(), np.str_), t.attrs) for t in texts}
        )


def write_table(path: Path, results: xr.Dataset) -> None:
    """Write a sweep's results as a long CSV table, one row for each method and photograph."""
    table = results[[*METRICS, "failure"]].to_dataframe(LABELS)
    with staged_file(path) as staged:
        table.to_csv(staged, na_rep="nan", lineterminator="\n")


def mean_errors(results: xr.Dataset) -> Iterator[str]:
    """Yield lines of the mean error of each method at each SBR, and of what failed."""
    errors = results["mean_squared_error"].mean(("background", "seed"))  # of what did not fail
    names = [str(name) for name in results["algorithm"].values]
    heading = "mean squared error at SBR"
    width = max(map(len, [heading, *names]))
    ratios = "".join(f"{sbr:9g}" for sbr in results["sbr"].values)
    yield f"{heading:{width}}{ratios}"
    for name, of_method in zip(names, errors.transpose("algorithm", "sbr").values, strict=True):
        cells = (f"{'failed':>9}" if np.isnan(error) else f"{error:9.5f}" for error in of_method)
        yield f"{name:{width}}{''.join(cells)}"
    failures = results["failure"].transpose("algorithm", ...).values.reshape(len(names), -1)
    for name, messages in zip(names, failures, strict=True):
        failed = messages[messages != ""]
        if failed.size:
            yield f"{name} failed on {failed.size} of {messages.size}, first: {failed[0]}"
