"""The results of a sweep on disk: a Zarr v3 store that knows which of its trials are complete.

Each trial, that is one photograph reconstructed by every method, has chunks of its own. A chunk
appears whole, by a rename, and the trial's mark in ``complete`` appears last, so that a sweep
killed at any moment leaves nothing that is believed but not true. Nothing measured, such as times,
lies in the store: the same sweep gives the same bytes, however often it was stopped.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import OutputError
from periscopy_sim.storage.outputs.resume import check_settings
from periscopy_sim.storage.outputs.staging import staged_file, staged_folder

if TYPE_CHECKING:
    import xarray as xr

LABELS = ("method", "background", "sbr", "seed")
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
    """What one method made of one photograph.

    Attributes
    ----------
    image
        (R, C, 3) float32; NaN where the method failed.
    metrics
        Values of `METRICS`, in their order; NaN where the method failed.
    failure
        Why it failed; empty where it did not.
    """

    image: NDArray[np.float32]
    metrics: tuple[float, ...]
    failure: str


class SweepStore:
    """A sweep's results, in the making or complete.

    Parameters
    ----------
    path
        A Zarr folder; made if missing, complete with its labels or not at all.
    labels
        The values of each of `LABELS`.
    hidden_shape
        (R, C) of the images.
    configuration
        All that the results depend on, of JSON's types; kept as the store's attributes.

    Raises
    ------
    OutputError
        If the path holds anything else, or a sweep of another configuration.
    """

    def __init__(
        self,
        path: Path,
        labels: Mapping[str, Sequence[Any]],
        hidden_shape: tuple[int, int],
        configuration: Mapping[str, Any],
    ) -> None:
        import zarr

        self.path = path
        if path.exists():
            try:
                held = zarr.open_group(path, mode="r", zarr_format=3).attrs.asdict()
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise OutputError(f"{path}: is no sweep's store; remove it") from error
            check_settings(held, configuration, str(path), "sweep")
            for torn in path.rglob("*.partial"):  # of a write that was killed
                torn.unlink()
        else:
            with staged_folder(path) as staged:
                _create(staged, labels, hidden_shape, configuration)
        self._group: Any = zarr.open_group(path, mode="r+", zarr_format=3)
        self._position = {
            name: {label: i for i, label in enumerate(labels[name])} for name in LABELS
        }

    def missing(self) -> list[Trial]:
        """List the trials that are not complete yet."""
        places = product(*(self._position[name] for name in LABELS[1:]))
        complete = np.asarray(self._group["complete"][:]).ravel()
        return [Trial(*place) for place, done in zip(places, complete, strict=True) if not done]

    def write(self, trial: Trial, outcomes: Sequence[Outcome]) -> None:
        """Keep what every method, in order, made of a trial, and mark the trial complete."""
        labels = zip(LABELS[1:], trial, strict=True)
        place = tuple(self._position[name][label] for name, label in labels)
        cell = (slice(None), *place)
        self._group["reconstruction"][cell] = np.stack([outcome.image for outcome in outcomes])
        for i, metric in enumerate(METRICS):
            self._group[metric][cell] = np.array([outcome.metrics[i] for outcome in outcomes])
        failures = [outcome.failure for outcome in outcomes]
        self._group["failure"][cell] = np.array(failures, np.dtypes.StringDType())
        self._group["complete"][place] = True  # last: all of the above is there

    def load(self) -> xr.Dataset:
        """Read the results into memory, without the marks."""
        import xarray as xr

        with xr.open_dataset(self.path, engine="zarr", consolidated=False) as dataset:
            results = dataset[[*METRICS, "reconstruction", "failure"]].load()
        # Strings of fixed width, which more of xarray and pandas take than NumPy's newer ones.
        texts = [results[name] for name in results.variables if results[name].dtype.kind == "T"]
        return results.assign(
            {t.name: (t.dims, np.array(t.values.tolist(), np.str_), t.attrs) for t in texts}
        )


def write_table(path: Path, results: xr.Dataset) -> None:
    """Write a sweep's results as a long table, one row for each method and photograph.

    Parameters
    ----------
    path
        A CSV file; appears once complete.
    results
        From `SweepStore.load`.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    columns = (*METRICS, "failure")
    values = [results[name].transpose(*LABELS).values.ravel().tolist() for name in columns]
    places = product(*(results[name].values.tolist() for name in LABELS))
    with staged_file(path) as staged, staged.open("w", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow((*LABELS, *columns))
        table.writerows((*place, *row) for place, *row in zip(places, *values, strict=True))


def _create(
    path: Path,
    labels: Mapping[str, Sequence[Any]],
    hidden_shape: tuple[int, int],
    configuration: Mapping[str, Any],
) -> None:
    """Lay out an empty store; xarray reads it."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    group = zarr.create_group(path, zarr_format=3, attributes=dict(configuration))
    coordinates = {**labels, "row": range(hidden_shape[0]), "column": range(hidden_shape[1])}
    for name, values in {**coordinates, "channel": ["red", "green", "blue"]}.items():
        is_text = isinstance(values[0], str)
        array = np.array(values, np.dtypes.StringDType() if is_text else None)
        group.create_array(name, data=array, dimension_names=(name,))
    shape = tuple(len(labels[name]) for name in LABELS)
    one_trial = (shape[0], 1, 1, 1)
    # A checksum, so that a damaged chunk is an error, not a result.
    checked: dict[str, Any] = {"compressors": [ZstdCodec(), Crc32cCodec()]}
    for name, attributes in METRICS.items():
        group.create_array(
            name, shape=shape, chunks=one_trial, dtype=np.float64, fill_value=np.nan,
            dimension_names=LABELS, attributes=attributes, **checked,
        )  # fmt: skip
    group.create_array(
        "reconstruction", shape=(*shape, *hidden_shape, 3), chunks=(*one_trial, *hidden_shape, 3),
        dtype=np.float32, fill_value=np.nan, dimension_names=(*LABELS, *PIXELS),
        attributes={"long_name": "hidden image, linear light", "units": "photograph's over A's"},
        **checked,
    )  # fmt: skip
    group.create_array(
        "failure", shape=shape, chunks=one_trial, dtype=str, fill_value="", dimension_names=LABELS,
        attributes={"long_name": "why the method failed, or nothing"}, **checked,
    )  # fmt: skip
    group.create_array(
        "complete", shape=shape[1:], chunks=(1, 1, 1), dtype=bool, fill_value=False,
        dimension_names=LABELS[1:], compressors=[Crc32cCodec()],
    )  # fmt: skip
