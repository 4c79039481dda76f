"""Sweeps: methods over images, ambient light, noise, and whatever else varies (Fig. 4).

A cell is one method's reconstruction of one photograph, at a value of each axis. An interrupted
sweep resumes where it stopped, and ends in the same bytes as one without interruption. A sweep of
more values computes only their cells.
"""

import math
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from periscopy_sim.errors import PeriscopyError, SceneError
from periscopy_sim.evaluation.metrics import METRICS, measured
from periscopy_sim.evaluation.sweep_store import MADE, SweepStore, Values
from periscopy_sim.evaluation.workers import compute, connect
from periscopy_sim.evaluation.world import World
from periscopy_sim.extras import SWEEP, require_all
from periscopy_sim.hidden import named
from periscopy_sim.methods import estimates_by, without_addresses
from periscopy_sim.numerics import Array
from periscopy_sim.numerics.limits import checked
from periscopy_sim.numerics.machine import timed
from periscopy_sim.numerics.validation import InputError
from periscopy_sim.own_code import OwnError
from periscopy_sim.storage.outputs.places import place
from periscopy_sim.storage.outputs.staging import staged_file

if TYPE_CHECKING:
    import xarray as xr

LIGHT = ("image", "background", "sbr", "snr", "seed")
"""Axes of a world's photographs. The axis of methods is `algorithm`, not `method`: xarray's `sel`
would read `method` as a keyword of its own, and select nothing."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep varies.

    Attributes
    ----------
    world
        A `World`, or what makes one of an SNR and values of `vary`, and has its `axes`, `hidden`,
        `channels`, `measures`, `conditions` and `conditions_of`.
    sbrs, snrs
        Signal-to-background ratios, infinite without ambient light, and signal-to-noise ratios in
        dB.
    seeds
        Labels of the noise draws for each image, background and SBR.
    seed
        Changes every noise draw.
    vary
        Names of further axes to their values, numbers or texts. An axis ``hidden`` has the sizes of
        the only hidden surface, as ``29x36``.
    units
        Units of the values of these axes.
    conditions
        Other settings of the results, of JSON's types, such as the scene that the methods fit.
        A store with other conditions is not resumed, so name everything that may change.

    Raises
    ------
    PeriscopyError
        If something to vary is missing or doubled, or a number is out of range.
    """

    world: Any
    sbrs: Sequence[float]
    snrs: Sequence[float] = (60.0,)
    seeds: Sequence[int] = (0,)
    seed: int = 0
    vary: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Reject settings that no sweep can have."""
        if not hasattr(self.world, "conditions_of"):
            raise InputError(f"the world is of type {type(self.world).__name__}: give a ps.World")
        kinds = {"sbrs": "sbr", "snrs": "decibels", "seeds": "seed", "seed": "seed"}
        for name, kind in kinds.items():
            checked(name, values := getattr(self, name), kind)
            if (name == "seed") != (np.ndim(values) == 0):
                raise InputError(f"{name} {values!r}: give a list of numbers; of seed, one")
        if not isinstance(self.vary, Mapping):
            raise InputError(f"vary is {self.vary!r}: give a dictionary of axes and their values")
        for name, values in self.vary.items():
            if isinstance(values, str) or np.ndim(values) != 1:
                raise InputError(f"vary: {name} is {values!r}: give a list of its values")
        for name, values in self.axes.items():
            if not values or len({*values}) < len(values):
                raise PeriscopyError(f"{name} of the sweep: give at least one, and each once")
        if taken := {"algorithm", *LIGHT} & {*self.vary}:
            raise PeriscopyError(f"vary: {', '.join(taken)} is an axis of its own")

    @property
    def axes(self) -> dict[str, list[Any]]:
        """The values of each axis, the methods' first, by its name in the singular."""
        names = self.world.axes
        return {
            "algorithm": list(names["algorithm"]),
            **{name: np.asarray(values).tolist() for name, values in self.vary.items()},
            "image": list(names["image"]),
            "background": list(names["background"]),
            "sbr": [float(sbr) for sbr in self.sbrs],
            "snr": [float(snr) for snr in self.snrs],
            "seed": [int(seed) for seed in self.seeds],
        }

    def photograph(self, cell: Values) -> Array:
        """Return the measurement of a cell; see `World.photograph`."""
        values = {name: cell[name] for name in LIGHT}
        world: World = self.world(cell["snr"], **{n: cell[n] for n in self.vary})
        return world.photograph(**values, base=self.seed)


def run_sweep(
    sweep: Sweep,
    folder: str | Path,
    *,
    scheduler: str | None = None,
    planned: Callable[[Sequence[Values]], None] | None = None,
    progress: Callable[[float], None] | None = None,
    timed: Callable[[str, float], None] | None = None,
) -> "xr.Dataset":
    """Reconstruct every measurement by every method; resume where an earlier run stopped.

    A method that raises, or returns another shape or values that are not finite, fails alone; so do
    values of `Sweep.vary` of which there is no scene, or to which a method cannot be fitted, unless
    all fail.

    Parameters
    ----------
    sweep
        Methods, photographs and what varies.
    folder
        Gets ``sweep.zarr`` and ``sweep.csv``, a row for each cell; or a URL that fsspec opens.
    scheduler
        Address of a Dask scheduler; None uses this machine's cores.
    planned
        Called with the cells that are missing, before the first world is made.
    progress
        Called with the fraction done.
    timed
        Called with the name of a method and a thread's seconds that it took for a photograph.

    Returns
    -------
    xarray.Dataset
        Over `Sweep.axes`: `METRICS`, NaN where the method failed; ``failure``, why it did;
        ``reconstruction``, float32, with (row, column, channel) besides. Of several surfaces there
        is each for each, as ``psnr_ID`` and ``row_ID``; of several sizes ``reconstruction_29x36``.

    Raises
    ------
    OutputError
        If the folder holds a sweep of another configuration, or cannot be written.
    PeriscopyError
        If the scheduler does not answer, its workers die, or the extra ``sweep`` is not installed.
    """
    require_all(*SWEEP)
    if not isinstance(sweep, Sweep):
        raise InputError(f"the sweep is of type {type(sweep).__name__}: give a ps.Sweep of it")
    folder, worlds, axes = place(folder), sweep.world, sweep.axes
    store = _store(sweep, folder)
    missing, count = store.missing(), math.prod(map(len, axes.values()))
    done, failed = count - len(missing), list[tuple[Values, str]]()
    if planned is not None:
        planned(missing)
    for (*values, snr), cells in _by([*sweep.vary, "snr"], missing).items():
        at = dict(zip(sweep.vary, values, strict=True))
        try:
            world = worlds(snr, **at)
        except PeriscopyError as error:
            is_of_values = isinstance(error, SceneError) or isinstance(error.__cause__, InputError)
            failed += [(cell, str(error)) for cell in cells]
            if not (at and is_of_values) or len(failed) == count:
                raise
            done += len(cells)
            continue
        with closing(_outcomes(sweep, world, at, cells, scheduler)) as found:
            for cell, outcome in found:
                seconds = outcome.pop("seconds", None)
                if timed is not None and seconds is not None:
                    timed(cell["algorithm"], seconds)
                store.write(cell, outcome)
                done += 1
                if progress is not None:
                    progress(done / count)
    for cell, why in failed:
        store.write(cell, {"failure": why})
    results = store.load()
    surfaces = named("", worlds.hidden)
    metrics = [*(f"{name}{of}" for of in surfaces for name in METRICS), *worlds.measures]
    table = results[[*metrics, "failure", *MADE]].to_dataframe([*axes])
    table["transport_samples"] = table["transport_samples"].astype("Int64")
    columns = {f"transport_{name}": name for name in ("model", "samples") if name not in axes}
    with staged_file(folder / "sweep.csv") as staged:
        table.rename(columns=columns).to_csv(staged, na_rep="nan", lineterminator="\n")
    return results


def cell_seconds(
    sweep: Sweep, world: World, cells: Mapping[str, Values]
) -> tuple[dict[str, float], float]:
    """Measure how long a thread takes for each method's cell, by its name, and for writing one."""
    seconds, writing = dict[str, float](), 0.0
    with TemporaryDirectory() as folder, threadpool_limits(1):
        store = _store(sweep, Path(folder))
        for name, cell in cells.items():
            size = f"_{cell['hidden']}" if "hidden" in cell else ""
            asked = tuple(cell[axis] for axis in LIGHT), (name,)
            seconds[name], (found,) = timed(partial(_evaluate, (world, 0, size), asked))
            found.pop("seconds", None)
            writing = timed(partial(store.write, cell, found))[0]
    return seconds, writing


def _store(sweep: Sweep, folder: Path) -> SweepStore:
    """Return the store of a sweep's results in a folder."""
    worlds, shapes = sweep.world, named("", sweep.world.hidden.shapes)
    images = {of: (*shape, worlds.channels) for of, shape in shapes.items()}
    conditions = {**sweep.conditions, **worlds.conditions, "base_seed": int(sweep.seed)}
    conditions["metrics"] = [*METRICS]
    return SweepStore(
        folder / "sweep.zarr", sweep.axes, images, conditions, worlds.conditions_of, sweep.units,
        worlds.measures,
    )  # fmt: skip


def _outcomes(
    sweep: Sweep, world: World, at: Values, cells: Iterable[Values], scheduler: str | None
) -> Generator[tuple[Values, dict[str, Any]], None, None]:
    """Yield cells of a world with the variables of each as they come, photograph by photograph."""
    shared = world, sweep.seed, f"_{at['hidden']}" if "hidden" in at else ""
    trials = {trial: _by(["algorithm"], of) for trial, of in _by(LIGHT, cells).items()}
    asked = [(trial, tuple(name for (name,) in each)) for trial, each in trials.items()]
    with connect(scheduler) as client:
        for (trial, names), outcomes in compute(client, _evaluate, shared, asked):
            for name, outcome in zip(names, outcomes, strict=True):
                (cell,) = trials[trial][(name,)]
                yield cell, outcome


def _by(names: Collection[str], cells: Iterable[Values]) -> dict[tuple[Any, ...], list[Values]]:
    """Return cells by their values of some axes."""
    groups: dict[tuple[Any, ...], list[Values]] = {}
    for cell in cells:
        groups.setdefault(tuple(cell[name] for name in names), []).append(cell)
    return groups


def _evaluate(
    shared: tuple[World, int, str], asked: tuple[tuple[Any, ...], tuple[str, ...]]
) -> list[dict[str, Any]]:
    """Reconstruct one photograph by some methods; return the variables of each one's cell."""
    (world, base, size), (trial, methods) = shared, asked
    of_trial = dict(zip(LIGHT, trial, strict=True))
    y, truth = world.photograph(**of_trial, base=base), world.truth(of_trial["image"])
    scale, surfaces = world.scale(of_trial["image"], of_trial["sbr"]), world.hidden.shapes
    outcomes = []
    own_error = world.own_error(*(of_trial[each] for each in ("image", "background", "sbr")))
    for name in methods:
        made = {**world.transport.get(name, {}), "photograph_error": own_error}
        of_A = {variable: made.get(variable, made.get(variable[10:])) for variable in MADE}
        values: dict[str, Any] = {n: v for n, v in of_A.items() if v is not None}
        try:
            found = estimates_by(world.methods[name], y.copy(), world.hidden, world.channels)
            measures = getattr(world.methods[name], "measures", None)
            if world.measures and measures:
                values |= {n: each for n, each in measures(y).items() if n in world.measures}
        except MemoryError:  # says more about the worker than about the method
            raise
        except OwnError as error:  # whatever a user's own method raises
            failure = without_addresses(f"{type(error).__name__}: {error}")
            outcomes.append({**values, "failure": failure})
            continue
        for of, surface in named("", {surface: surface for surface in surfaces}).items():
            image, errors = found.images[surface], found.errors.get(surface)
            metrics = measured(image, truth[surface], errors, scale)
            values |= {f"{metric}{of}": each for metric, each in metrics.items()}
            values[f"reconstruction{of}{size}"] = image
        outcomes.append({**values, "failure": "", "seconds": found.seconds})
    return outcomes
