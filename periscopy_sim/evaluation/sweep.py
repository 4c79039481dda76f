"""Sweeps: methods over ambient backgrounds, signal-to-background ratios and noise draws (Fig. 4).

Results are labelled by algorithm (the method's name), background, SBR and seed. An interrupted
sweep resumes where it stopped, and ends in the same bytes as one without interruption.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.methods import MethodError, images_by, without_addresses
from periscopy_sim.evaluation.metrics import mean_squared_error, psnr_gain_matched, registered
from periscopy_sim.evaluation.workers import compute, connect
from periscopy_sim.extras import require_all
from periscopy_sim.hidden import Hidden, named
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.numerics import Array, Image
from periscopy_sim.photograph import of_one_wall
from periscopy_sim.reconstruction.method import Method, StillMethod
from periscopy_sim.scene import MONITOR
from periscopy_sim.storage.outputs.staging import staged_file
from periscopy_sim.storage.outputs.store import BlockStore, StoreLayout

if TYPE_CHECKING:
    import xarray as xr

LABELS = ("algorithm", "background", "sbr", "seed")
"""Not `method`: xarray's `sel` takes that for a keyword of its own, and selects nothing."""
COLOURS = {1: ["grey"], 3: ["red", "green", "blue"]}
"""Names of an image's channels, where they have some."""
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

    values: dict[str, Any]  # images, (R, C, channels), and `METRICS`, by variables of the store
    failure: str  # why it failed; empty where it did not


class SweepStore:
    """A sweep's results, in the making or complete, a trial a block.

    `labels` are the values of each of `LABELS`, the images are those of hidden surfaces with so
    many channels, and `configuration` is all that the results depend on, of JSON's types: the
    store's attributes. Of several surfaces each variable is there for each, as ``psnr_ID``.
    """

    def __init__(
        self,
        path: Path,
        labels: Mapping[str, Sequence[Any]],
        hidden: Hidden,
        channels: int,
        configuration: Mapping[str, Any],
    ) -> None:
        self.path, self._shape = path, tuple(len(labels[name]) for name in LABELS)
        self._images = {of: (*shape, channels) for of, shape in named("", hidden.shapes).items()}
        self.trials = [Trial(*place) for place in product(*(labels[n] for n in LABELS[1:]))]
        coordinates: dict[str, Any] = dict(labels)
        for of, shape in self._images.items():
            coordinates |= dict(zip(_pixels(of)[:2], map(range, shape[:2]), strict=True))
        coordinates["channel"] = COLOURS.get(channels, range(channels))
        placed = {name: (name, values) for name, values in coordinates.items()}
        cuts = {name: (len(labels[name]), 1) for name in LABELS[1:]}
        layout = StoreLayout("sweep", self._variables(), cuts)
        self._store = BlockStore(path, layout, configuration, placed)

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
            **{
                f"{name}{of}": {**metric, "attributes": notes}
                for of in self._images for name, notes in METRICS.items()
            },
            **{
                f"reconstruction{of}": {
                    **common, "shape": (*self._shape, *image),
                    "chunks": (*one_trial, *image), "dimension_names": (*LABELS, *_pixels(of)),
                    "dtype": np.float32, "fill_value": np.nan,
                    "attributes": {
                        "long_name": "hidden image, linear light", "units": "photograph's over A's"
                    },
                }
                for of, image in self._images.items()
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
        of_methods: dict[str, NDArray[Any]] = {
            name: np.stack([outcome.values[name] for outcome in outcomes])
            for name in outcomes[0].values
        }
        failures = [outcome.failure for outcome in outcomes]
        of_methods["failure"] = np.array(failures, np.dtypes.StringDType())
        cell = {name: values[:, None, None, None] for name, values in of_methods.items()}
        self._store.write(self.trials.index(trial), cell)

    def load(self) -> "xr.Dataset":
        """Read the results into memory."""
        import xarray as xr

        with xr.open_dataset(self.path, engine="zarr", consolidated=False) as dataset:
            results = dataset[[*self._variables()]].load()
        # Strings of fixed width, which more of xarray and pandas take than NumPy's newer ones.
        texts = [results[name] for name in results.variables if results[name].dtype.kind == "T"]
        return results.assign(
            {t.name: (t.dims, np.array(t.values.tolist(), np.str_), t.attrs) for t in texts}
        )


@dataclass(frozen=True, eq=False)
class Sweep:
    """The varied and the fixed settings of a sweep.

    Attributes
    ----------
    signal
        A `Photograph` without ambient light, or such an array, (rows, columns, channels), in any
        unit. Its mask says where the wall is used: only there must the photographs be finite, and
        only there count the SBR, the exposure and the noise; elsewhere a measurement is zero.
    truth
        (R, C, channels) hidden image in [0, 1]; of several surfaces a mapping of such by id.
    backgrounds
        Name to `Photograph` or array of ambient light, like the signal, in any unit. Their masks
        exclude more pixels.
    methods
        Name to method; anything with ``reconstruct(photograph) -> (R, C, channels)`` that pickle
        takes. The package's methods are fitted to the photographs' conditions; a method of your own
        must have been fitted with the mask.
    sbrs
        Signal-to-background ratios.
    snr
        Signal-to-noise ratio in dB.
    seeds
        Labels of the noise draws for each background and SBR.
    seed
        Changes every noise draw.
    conditions
        Other settings of the results, of JSON's types, such as the scene that the methods fit.
        A store with other conditions is not resumed, so name everything that may change.
    transport
        How each method's A was made, by its name: `TransportPlan.origin`, columns of the table.

    Raises
    ------
    PeriscopyError
        If something to vary is missing or doubled, shapes differ, or a number is out of range.
    """

    signal: Any
    truth: Image | Mapping[str, Image]
    backgrounds: Mapping[str, Any]
    methods: Mapping[str, Method]
    sbrs: Sequence[float]
    snr: float = 60.0
    seeds: Sequence[int] = (0,)
    seed: int = 0
    conditions: Mapping[str, Any] = field(default_factory=dict)
    transport: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fit the methods to all of the photographs; reject settings that no sweep can have."""
        given = {"signal": self.signal, **self.backgrounds}
        signal, *ambient = of_one_wall([*given.values()], names=given)
        own = [each for each in self.methods.values() if not isinstance(each, StillMethod)]
        if own and (signal.monitor_off or signal.colour_matrix is not None):
            raise PeriscopyError(
                "the sweep's photographs have some with the monitor off, or a colour matrix; leave "
                "these out, and fit your own methods with them"
            )
        digests = {name: array_sha256(each) for name, each in signal.monitor_off.items()}
        vars(self).update(  # the fields are frozen
            signal=signal,
            backgrounds=dict(zip(self.backgrounds, ambient, strict=True)),
            methods={
                name: each.fitted_to(signal) if isinstance(each, StillMethod) else each
                for name, each in self.methods.items()
            },
            conditions={**self.conditions, **({"monitor_off_sha256": digests} if digests else {})},
        )
        for name, values in self.labels().items():
            if not values or len(set(values)) < len(values):
                raise PeriscopyError(f"{name} of the sweep: give at least one, and each once")
        for name, each in {"signal": signal, **self.backgrounds}.items():
            if each.values.shape != signal.values.shape or not each.used.sum() > 0:
                raise PeriscopyError(
                    f"'{name}': give finite values of shape {signal.values.shape} and positive mean"
                )
        if not (np.isfinite([*self.sbrs, self.snr]).all() and min(self.sbrs) > 0):
            raise PeriscopyError(
                f"SBR {list(self.sbrs)}, SNR {self.snr}: give positive SBRs and an SNR in dB"
            )

    def labels(self) -> dict[str, list[Any]]:
        """Return the algorithms, backgrounds, SBRs and seeds, under those names in the singular."""
        return {
            "algorithm": list(self.methods),
            "background": list(self.backgrounds),
            "sbr": [float(sbr) for sbr in self.sbrs],
            "seed": [int(seed) for seed in self.seeds],
        }

    @property
    def truths(self) -> Mapping[str, Image]:
        """(R, C, channels) hidden image of each surface, by its id."""
        return self.truth if isinstance(self.truth, Mapping) else {MONITOR: self.truth}

    @property
    def hidden(self) -> Hidden:
        """The hidden surfaces, by their sizes alone."""
        return Hidden.of({name: truth.shape[:2] for name, truth in self.truths.items()})

    @property
    def channels(self) -> int:
        """Channels of the images, in the monitor's primaries."""
        matrix = self.signal.colour_matrix
        return self.signal.channels if matrix is None else int(matrix.matrix.shape[1])

    def photograph(self, background: str, sbr: float, seed: int) -> Array:
        """Return the measurement of these labels (Sec. 4.1).

        It is (rows, columns, channels) of mean 1, plus noise; zero where the wall is not used. Its
        noise follows from its own labels and the sweep's seed: the same whatever else is swept.
        """
        signal, ambient = self.signal.used, self.backgrounds[background].used
        exposed = composite(signal, ambient, sbr)
        identity = json.dumps([self.seed, background, float(sbr), int(seed)]).encode()
        entropy = int.from_bytes(hashlib.sha256(identity).digest()[:16])  # 128 bits
        photograph = np.zeros(self.signal.values.shape)
        photograph[self.signal.pixels] = add_noise(exposed, self.snr, entropy)
        return photograph

    def configuration(self) -> dict[str, Any]:
        """Return all that the results depend on; arrays by their digests."""
        mask, matrix = self.signal.mask, self.signal.colour_matrix
        return {
            **self.conditions,
            **{f"{name}s": values for name, values in self.labels().items()},
            "snr": float(self.snr),
            "base_seed": int(self.seed),
            "signal_sha256": array_sha256(self.signal.values),
            "truth_sha256": image_sha256(self.truth),
            "background_sha256": {n: array_sha256(b.values) for n, b in self.backgrounds.items()},
            **({} if mask is None else {"mask_sha256": array_sha256(mask)}),
            **({} if matrix is None else {"colour_matrix": matrix.matrix.tolist()}),
        }


def array_sha256(array: NDArray[Any]) -> str:
    """Return the digest of an array's shape, type and values."""
    state = hashlib.sha256(f"{array.shape} {array.dtype.str}".encode())
    state.update(np.ascontiguousarray(array).data)
    return state.hexdigest()


def image_sha256(image: Image | Mapping[str, Image]) -> Any:
    """Return the digest of a hidden image to single precision; of several images each by its id.

    Its last bits follow how many threads resampled it.
    """
    if isinstance(image, Mapping):
        return {name: image_sha256(each) for name, each in image.items()}
    return array_sha256(image.astype(np.float32))


def flips(backgrounds: Mapping[str, Image]) -> dict[str, Image]:
    """Flip each background about each axis and about both: four times as many (Sec. 4.1).

    They are (rows, columns, channels) each, by name. Return each under its own name, then with
    `` up-down``, `` left-right`` and `` both`` added to it.
    """
    turns = {"": (1, 1), " up-down": (-1, 1), " left-right": (1, -1), " both": (-1, -1)}
    return {
        f"{name}{turn}": image[::down, ::right]
        for name, image in backgrounds.items()
        for turn, (down, right) in turns.items()
    }


def run_sweep(
    sweep: Sweep,
    folder: Path,
    *,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> "xr.Dataset":
    """Reconstruct every measurement by every method; resume where an earlier run stopped.

    A method that raises, or returns another shape or values that are not finite, fails alone.

    Parameters
    ----------
    sweep
        Methods, photographs and what varies.
    folder
        Gets ``sweep.zarr`` and ``sweep.csv``, a row for each method and measurement.
    scheduler
        Address of a Dask scheduler; None uses this machine's cores.
    progress
        Called with the fraction done.

    Returns
    -------
    xarray.Dataset
        Over (algorithm, background, sbr, seed): ``mean_squared_error``, ``psnr``,
        ``psnr_registered``, gain-matched and thus using the truth, NaN where the method failed;
        ``failure``, why it did; ``reconstruction``, float32, with (row, column, channel) besides.
        Of several surfaces there is each for each, as ``psnr_ID`` and ``row_ID``.

    Raises
    ------
    OutputError
        If the folder holds a sweep of another configuration, or cannot be written.
    PeriscopyError
        If the scheduler does not answer, its workers die, or the extra ``sweep`` is not installed.
    """
    require_all()
    place, surfaces = folder / "sweep.zarr", (sweep.hidden, sweep.channels)
    store = SweepStore(place, sweep.labels(), *surfaces, sweep.configuration())
    if missing := store.missing():
        with connect(scheduler) as client:
            evaluated = compute(client, _evaluate, sweep, missing)
            for finished, (trial, outcomes) in enumerate(evaluated, 1):
                store.write(trial, outcomes)
                if progress is not None:
                    progress(1 - (len(missing) - finished) / len(store.trials))
    results = store.load()
    metrics = [f"{name}{of}" for of in named("", sweep.truths) for name in METRICS]
    table = results[[*metrics, "failure"]].to_dataframe(LABELS)
    for column in ("model", "samples", "transport_error"):
        made = {name: plan.get(column) for name, plan in sweep.transport.items()}
        table[column] = table.index.get_level_values("algorithm").map(made.get)
    with staged_file(folder / "sweep.csv") as staged:
        table.to_csv(staged, na_rep="nan", lineterminator="\n")
    return results


def _evaluate(sweep: Sweep, trial: Trial) -> list[Outcome]:
    """Reconstruct one photograph by every method."""
    y, hidden, channels = sweep.photograph(*trial), sweep.hidden, sweep.channels
    outcomes = []
    for method in sweep.methods.values():
        try:
            images, failure = images_by(method, y.copy(), hidden, channels), ""
        except MemoryError:  # says more about the worker than about the method
            raise
        except MethodError as error:  # whatever a user's own method raises
            shapes = hidden.shapes.items()
            images = {n: np.full((*shape, channels), np.nan, np.float32) for n, shape in shapes}
            failure = without_addresses(f"{type(error).__name__}: {error}")
        values: dict[str, Any] = {}
        for of, name in named("", {name: name for name in hidden}).items():
            image, truth = images[name], np.ascontiguousarray(sweep.truths[name])
            metrics = (np.nan,) * len(METRICS)
            if not failure:
                best = registered(image, truth).psnr
                metrics = mean_squared_error(image, truth), psnr_gain_matched(image, truth), best
            values[f"reconstruction{of}"] = image
            values |= {f"{n}{of}": each for n, each in zip(METRICS, metrics, strict=True)}
        outcomes.append(Outcome(values, failure))
    return outcomes


def _pixels(of: str) -> tuple[str, str, str]:
    """Return the names of an image's dimensions, of a surface's variables."""
    return f"row{of}", f"column{of}", "channel"
