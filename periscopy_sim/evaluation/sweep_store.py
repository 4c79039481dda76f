"""The results of a sweep on disk: a `BlockStore` whose blocks are trials."""

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.storage.outputs.staging import staged_file
from periscopy_sim.storage.outputs.store import BlockStore, StoreLayout

if TYPE_CHECKING:
    import xarray as xr

LABELS = ("algorithm", "background", "sbr", "seed")
"""Not `method`: xarray's `sel` takes that for a keyword of its own, and selects nothing."""
PIXELS = ("row", "column", "channel")
_NOTE = "gain-matched: uses the truth"
METRICS = {
    "mean_squared_error": {
        "long_name": "mean squared error, white being 1", "units": "1", "note": _NOTE
    },
    "psnr": {"long_name": "peak signal-to-noise ratio", "units": "dB", "note": _NOTE},
    "psnr_registered": {
        "long_name": "peak signal-to-noise ratio after the best shift of at most 2 patches",
        "units": "dB",
        "note": f"{_NOTE}, to find the shift too",
    },
}  # fmt: skip


class Trial(NamedTuple):
    """Labels of one photograph, which every method reconstructs."""

    background: str
    sbr: float
    seed: int


class Outcome(NamedTuple):
    """One method's reconstruction of one photograph; NaN where it failed."""

    image: NDArray[np.float32]  # (R, C, 3)
    metrics: tuple[float, ...]  # values of `METRICS`, in their order
    failure: str  # why it failed; empty where it did not


class SweepStore:
    """A sweep's results, in the making or complete, a trial a block.

    `labels` are the values of each of `LABELS`, `hidden_shape` is (R, C) of the images, and
    `configuration` all that the results depend on, of JSON's types: the store's attributes.
    """

    def __init__(
        self,
        path: Path,
        labels: Mapping[str, Sequence[Any]],
        hidden_shape: tuple[int, int],
        configuration: Mapping[str, Any],
    ) -> None:
        self.path, self._shape = path, tuple(len(labels[name]) for name in LABELS)
        self._image = (*hidden_shape, 3)
        self.trials = [Trial(*place) for place in product(*(labels[n] for n in LABELS[1:]))]
        pixels = (*map(range, hidden_shape), ["red", "green", "blue"])
        coordinates = {**labels, **dict(zip(PIXELS, pixels, strict=True))}
        named = {name: (name, values) for name, values in coordinates.items()}
        cuts = {name: (len(labels[name]), 1) for name in LABELS[1:]}
        layout = StoreLayout("sweep", self._variables(), cuts)
        self._store = BlockStore(path, layout, configuration, named)

    def _variables(self) -> dict[str, dict[str, Any]]:
        """Return how each variable is laid out."""
        from zarr.codecs import Crc32cCodec, ZstdCodec

        one_trial = (self._shape[0], 1, 1, 1)
        # A checksum, so that a damaged chunk is an error, not a result.
        common: dict[str, Any] = {
            "shape": self._shape, "chunks": one_trial, "dimension_names": LABELS,
            "compressors": [ZstdCodec(), Crc32cCodec()],
        }  # fmt: skip
        metric = {**common, "dtype": np.float64, "fill_value": np.nan}
        return {
            **{name: {**metric, "attributes": notes} for name, notes in METRICS.items()},
            "reconstruction": {
                **common, "shape": (*self._shape, *self._image),
                "chunks": (*one_trial, *self._image), "dimension_names": (*LABELS, *PIXELS),
                "dtype": np.float32, "fill_value": np.nan,
                "attributes": {
                    "long_name": "hidden image, linear light", "units": "photograph's over A's"
                },
            },
            "failure": {
                **common, "dtype": str, "fill_value": "",
                "attributes": {"long_name": "why the method failed, or nothing"},
            },
        }  # fmt: skip

    def missing(self) -> list[Trial]:
        """Return the trials that are not complete yet."""
        return [self.trials[number] for number in self._store.missing()]

    def write(self, trial: Trial, outcomes: Sequence[Outcome]) -> None:
        """Write every method's outcome of a trial, in order, and record that it is complete."""
        images, metrics, failures = zip(*outcomes, strict=True)
        of_methods: dict[str, NDArray[Any]] = {
            "reconstruction": np.stack(images),
            "failure": np.array(failures, np.dtypes.StringDType()),
            **dict(zip(METRICS, np.transpose(metrics), strict=True)),
        }
        cell = {name: values[:, None, None, None] for name, values in of_methods.items()}
        self._store.write(self.trials.index(trial), cell)

    def load(self) -> "xr.Dataset":
        """Read the results into memory."""
        import xarray as xr

        with xr.open_dataset(self.path, engine="zarr", consolidated=False) as dataset:
            results = dataset[[*METRICS, "reconstruction", "failure"]].load()
        # Strings of fixed width, which more of xarray and pandas take than NumPy's newer ones.
        texts = [results[name] for name in results.variables if results[name].dtype.kind == "T"]
        return results.assign(
            {t.name: (t.dims, np.array(t.values.tolist(), np.str_), t.attrs) for t in texts}
        )


def write_table(path: Path, results: "xr.Dataset") -> None:
    """Write a sweep's results as a long CSV table, one row for each method and photograph."""
    table = results[[*METRICS, "failure"]].to_dataframe(LABELS)
    with staged_file(path) as staged:
        table.to_csv(staged, na_rep="nan", lineterminator="\n")
