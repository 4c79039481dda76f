"""Sweeps: methods over ambient backgrounds, signal-to-background ratios and noise draws (Fig. 4).

Results are labelled by algorithm (the method's name), background, SBR and seed. An interrupted
sweep goes on where it stopped, and ends in the same bytes as one without interruption.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from periscopy_sim.errors import PeriscopyError
from periscopy_sim.evaluation.methods import MethodError, image_by, without_addresses
from periscopy_sim.evaluation.metrics import mean_squared_error, psnr, registered
from periscopy_sim.evaluation.sweep_store import (
    METRICS,
    Outcome,
    SweepStore,
    Trial,
    write_table,
)
from periscopy_sim.extras import require_all
from periscopy_sim.measurement import add_noise, composite
from periscopy_sim.photograph import used_pixels
from periscopy_sim.reconstruction.method import Method

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]
Image = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep varies, and what stays.

    Attributes
    ----------
    signal
        (rows, columns, 3) photograph without ambient light, in any unit.
    truth
        (R, C, 3) hidden image in [0, 1].
    backgrounds
        Name to (rows, columns, 3) photograph of ambient light, in any unit.
    methods
        Name to method; anything with ``reconstruct(photograph) -> (R, C, 3)`` that pickle takes.
    sbrs
        Signal-to-background ratios.
    snr
        Signal-to-noise ratio in dB.
    seeds
        Labels of the noise draws for each background and SBR.
    seed
        Changes every noise draw.
    conditions
        What else the results depend on, of JSON's types: what the methods were fitted to and how.
        A store whose conditions differ is not taken up, so name all that may change.
    mask
        (rows, columns), True where the wall is used: only there must the photographs be finite, and
        only there count the SBR, the exposure and the noise; elsewhere a measurement is zero. The
        methods must have been fitted with it. None: everywhere.

    Raises
    ------
    PeriscopyError
        If something to vary is missing or doubled, shapes differ, or a number is out of range.
    """

    signal: Image
    truth: Image
    backgrounds: Mapping[str, Image]
    methods: Mapping[str, Method]
    sbrs: Sequence[float]
    snr: float = 60.0
    seeds: Sequence[int] = (0,)
    seed: int = 0
    conditions: Mapping[str, Any] = field(default_factory=dict)
    mask: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        """Reject what cannot be swept."""
        for name, values in self.labels().items():
            if not values or len(set(values)) < len(values):
                raise PeriscopyError(f"{name} of the sweep: give at least one, and each once")
        for name, image in {"signal": self.signal, **self.backgrounds}.items():
            used = (
                used_pixels(image, self.mask) if image.shape == self.signal.shape else np.zeros(1)
            )
            if not (np.isfinite(used).all() and used.sum() > 0):
                raise PeriscopyError(
                    f"'{name}': give finite values of shape {self.signal.shape} and positive mean"
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

    def photograph(self, background: str, sbr: float, seed: int) -> Array:
        """Return the measurement of these labels (Sec. 4.1).

        It is (rows, columns, 3) of mean 1, plus noise; zero where the wall is not used. Its noise
        follows from its own labels and the sweep's seed: the same whatever else is swept.
        """
        # In one memory order, which sums follow, whether the arrays have travelled or not.
        images = self.signal, self.backgrounds[background]
        signal, ambient = (np.ascontiguousarray(used_pixels(y, self.mask)) for y in images)
        exposed = composite(signal, ambient, sbr)
        identity = json.dumps([self.seed, background, float(sbr), int(seed)]).encode()
        entropy = int.from_bytes(hashlib.sha256(identity).digest()[:16])  # 128 bits
        photograph = np.zeros(self.signal.shape)
        photograph[... if self.mask is None else self.mask] = add_noise(exposed, self.snr, entropy)
        return photograph

    def configuration(self) -> dict[str, Any]:
        """Return all that the results depend on; arrays by their digests."""
        return {
            **self.conditions,
            **{f"{name}s": values for name, values in self.labels().items()},
            "snr": float(self.snr),
            "base_seed": int(self.seed),
            "signal_sha256": array_sha256(self.signal),
            "truth_sha256": image_sha256(self.truth),
            "background_sha256": {n: array_sha256(b) for n, b in self.backgrounds.items()},
            **({} if self.mask is None else {"mask_sha256": array_sha256(self.mask)}),
        }


def array_sha256(array: NDArray[Any]) -> str:
    """Return the digest of an array's shape, type and values."""
    state = hashlib.sha256(f"{array.shape} {array.dtype.str}".encode())
    state.update(np.ascontiguousarray(array).data)
    return state.hexdigest()


def image_sha256(image: Image) -> str:
    """Return the digest of a hidden image to single precision.

    Its last bits follow how many threads resampled it.
    """
    return array_sha256(image.astype(np.float32))


def flips(backgrounds: Mapping[str, Image]) -> dict[str, Image]:
    """Flip each background about each axis and about both: four times as many (Sec. 4.1).

    They are (rows, columns, 3) each, by name. Return each under its own name, then with
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
    """Reconstruct every measurement by every method; go on where an earlier run stopped.

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

    Raises
    ------
    OutputError
        If the folder holds a sweep of another configuration, or cannot be written.
    PeriscopyError
        If the scheduler does not answer, its workers die, or the extra ``sweep`` is not installed.
    """
    require_all()
    from periscopy_sim.evaluation.workers import compute, connect

    store = SweepStore(
        folder / "sweep.zarr", sweep.labels(), sweep.truth.shape[:2], sweep.configuration()
    )
    if missing := store.missing():
        with connect(scheduler) as client:
            evaluated = compute(client, _evaluate, sweep, missing)
            for finished, (trial, outcomes) in enumerate(evaluated, 1):
                store.write(trial, outcomes)
                if progress is not None:
                    progress(1 - (len(missing) - finished) / len(store.trials))
    results = store.load()
    write_table(folder / "sweep.csv", results)
    return results


def _evaluate(sweep: Sweep, trial: Trial) -> list[Outcome]:
    """Reconstruct one photograph by every method."""
    y, truth = sweep.photograph(*trial), np.ascontiguousarray(sweep.truth)
    outcomes = []
    for method in sweep.methods.values():
        try:
            image, failure = image_by(method, y.copy(), truth.shape[:2]), ""
        except MemoryError:  # says more about the worker than about the method
            raise
        except MethodError as error:  # whatever a user's own method raises
            image = np.full(truth.shape, np.nan, np.float32)
            failure = without_addresses(f"{type(error).__name__}: {error}")
        values = (np.nan,) * len(METRICS)
        if not failure:
            best = registered(image, truth).psnr
            values = mean_squared_error(image, truth), psnr(image, truth), best
        outcomes.append(Outcome(image, values, failure))
    return outcomes
